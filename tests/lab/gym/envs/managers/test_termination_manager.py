"""Success and fail terminate, time_out truncates; terms of a kind are joined by or."""

import pytest
import torch

from embodichain.lab.gym.envs.cfg import TerminationCfg


def rows(*values: bool, **fields) -> TerminationCfg:
    return TerminationCfg(func=lambda e, o, a, i: torch.tensor(values), **fields)


def still(env) -> torch.Tensor:
    return env.robot.get_qpos(target=True)


def test_kinds(make) -> None:
    env = make(
        terminations={
            "won": rows(True, False, False, kind="success"),
            "lost": rows(False, True, False),
            "late": rows(False, False, True, kind="time_out"),
        }
    )
    env.reset()
    _, _, terminated, truncated, info = env.step(still(env))
    assert terminated.tolist() == [True, True, False]
    assert truncated.tolist() == [False, False, True]
    assert info["success"].tolist() == [True, False, False]
    assert info["fail"].tolist() == [False, True, False]
    assert env.termination_manager.values["late"].tolist() == [False, False, True]


def test_terms_of_one_kind_are_joined(make) -> None:
    env = make(terminations={"a": rows(True, False, False), "b": rows(False, False, True)})
    env.reset()
    assert env.step(still(env))[2].tolist() == [True, False, True]


def test_numbers_count_as_truth(make) -> None:
    env = make(terminations={"a": TerminationCfg(func=lambda e, o, a, i: torch.arange(3.0))})
    env.reset()
    assert env.step(still(env))[2].tolist() == [False, True, True]


def test_wrong_shape_names_the_term(make) -> None:
    with pytest.raises(ValueError, match="termination term 'a' must return shape"):
        env = make(terminations={"a": TerminationCfg(func=lambda e, o, a, i: torch.zeros(3, 1))})
        env.reset()
        env.step(still(env))
