"""Metrics are reduced over an episode; `success` is the task's success and ends nothing."""

import pytest
import torch

from embodichain.lab.gym.envs.cfg import MetricCfg, TerminationCfg


def elapsed(env, obs, action, info):
    """1, 2, 3... within an episode, negative in environment 0."""
    count = env.elapsed_steps.to(torch.float32)
    count[0] = -count[0]
    return count


def still(env) -> torch.Tensor:
    return env.robot.get_qpos(target=True)


@pytest.mark.parametrize(
    ("reduce", "expected"),
    [
        ("last", [-3.0, 3.0]),
        ("sum", [-6.0, 6.0]),
        ("mean", [-2.0, 2.0]),
        ("max", [-1.0, 3.0]),
        ("min", [-3.0, 1.0]),
    ],
)
def test_numbers(make, reduce, expected) -> None:
    env = make(metrics={"m": MetricCfg(func=elapsed, reduce=reduce)})
    env.reset()
    infos = [env.step(still(env))[4] for _ in range(3)]
    assert infos[2]["metrics"]["m"][:2].tolist() == expected
    env.reset(options={"reset_ids": [1]})
    info = env.step(still(env))[4]
    assert info["metrics"]["m"][1].item() == 1.0
    assert infos[2]["metrics"]["m"][:2].tolist() == expected, "what was returned has changed"


@pytest.mark.parametrize(("reduce", "expected"), [("any", [0, 1, 1, 1]), ("all", [0, 0, 0, 0])])
def test_truths(make, reduce, expected) -> None:
    def second(env, obs, action, info):
        return env.elapsed_steps == 2

    env = make(metrics={"m": MetricCfg(func=second, reduce=reduce)})
    env.reset()
    found = [env.step(still(env))[4]["metrics"]["m"] for _ in range(4)]
    assert [v[0].item() for v in found] == expected
    assert found[0].dtype == torch.bool


def test_success_ends_nothing(make) -> None:
    def always(env, obs, action, info):
        return torch.tensor([True, False, True])

    env = make(metrics={"success": MetricCfg(func=always)})
    env.reset()
    _, _, terminated, truncated, info = env.step(still(env))
    assert info["metrics"]["success"].tolist() == [1.0, 0.0, 1.0]
    assert env.is_task_success().tolist() == [True, False, True]
    assert not terminated.any() and not truncated.any()
    assert env.metric_manager.has_success


def test_success_wins_over_terminations_of_kind_success(make) -> None:
    env = make(
        metrics={"success": MetricCfg(func=lambda e, o, a, i: torch.tensor([False, True, False]))},
        terminations={
            "done": TerminationCfg(
                kind="success", func=lambda e, o, a, i: torch.tensor([True, False, False])
            )
        },
    )
    env.reset()
    _, _, terminated, _, info = env.step(still(env))
    assert terminated.tolist() == [True, False, False]
    assert info["metrics"]["success"].tolist() == [0.0, 1.0, 0.0]


def test_wrong_shape_names_the_metric(make) -> None:
    with pytest.raises(ValueError, match="metric term 'm' must return shape"):
        env = make(metrics={"m": MetricCfg(func=lambda e, o, a, i: torch.zeros(3, 1))})
        env.reset()
        env.step(still(env))
