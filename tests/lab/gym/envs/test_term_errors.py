"""A term that raises, or gives NaN or infinity, is named: file, line, environments, step."""

import logging
import textwrap
from pathlib import Path

import numpy as np
import pytest
import torch

import embodichain
from embodichain.lab.gym.envs.managers.terms.term_errors import TermError
from embodichain.utils.errors import ConfigError

MODULE = """
import torch
from embodichain.lab.gym.envs.managers.term import CommandTerm

AT = 2  # control steps before the fault


def due(env):
    return env.control_step > AT


def values(env, bad, *shape):
    found = torch.ones(env.num_envs, *shape)
    if due(env):
        found[2] = bad
    return found


def nan_value(env, obs, action, info):
    return values(env, float("nan"))


def inf_value(env, obs, action, info):
    return values(env, float("-inf"))


def nan_obs(env, obs):
    return values(env, float("nan"), 2)


def raising(env, obs, action, info):
    if due(env):
        {}["boom"]
    return torch.ones(env.num_envs)


def raising_obs(env, obs):
    return raising(env, obs, None, None)[:, None]


def raising_event(env, env_ids):
    raising(env, None, None, None)


def leaving(env, obs, action, info):
    if due(env):
        raise SystemExit(0)
    return torch.ones(env.num_envs)


def nan_curriculum(env, env_ids):
    return float("nan")


class Unbuilt:
    def __init__(self, env):
        raise ArithmeticError("no such thing")

    def __call__(self, env, obs, action, info):
        return torch.ones(env.num_envs)


class Command(CommandTerm):
    names = ("x",)

    def __init__(self, env, bad=False):
        self._env, self._bad = env, bad
        self.values = env.arrays.full((env.num_envs, 1), 0.0)

    def resample(self, env_ids):
        if due(self._env):
            if self._bad:
                self.values[2] = float("nan")
            else:
                raise OverflowError("too far")

"""


@pytest.fixture
def make(tmp_path: Path, monkeypatch):
    """Builds `reach` extended by sections of YAML, in a file of its own."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "faulty_terms.py").write_text(MODULE, encoding="utf-8")
    folder = tmp_path / "task"
    folder.mkdir()
    built = []

    def build(sections: str, **kwargs):
        text = "defaults: [reach, _self_]\n" + textwrap.dedent(sections)
        (folder / "mine.yaml").write_text(text, encoding="utf-8")
        env = embodichain.make("mine", num_envs=4, seed=1, config_dir=tmp_path, **kwargs)
        built.append(env)
        return env

    yield build
    for env in built:
        env.close()


def steps(env, count: int = 5):
    env.reset()
    action = torch.zeros(4, *env.single_action_space.shape)
    return [env.step(action) for _ in range(count)]


def test_a_reward_that_is_nan_is_named_and_ends_its_environment(make, caplog) -> None:
    env = make("rewards:\n  bad: {func: 'faulty_terms:nan_value', weight: 0.5}\n")
    with caplog.at_level(logging.WARNING):
        results = steps(env, 4)
    assert [r[4]["diverged"].tolist() for r in results[:2]] == [[False] * 4] * 2
    assert results[2][4]["diverged"].tolist() == [False, False, True, False]
    assert results[2][2].tolist() == [False, False, True, False]
    line = next(r.getMessage() for r in caplog.records if "bad" in r.getMessage())
    assert line.startswith("control step 2: ")
    assert "mine.yaml:3: task.rewards.bad is NaN in 1 of 4 environments (2)" in line
    assert "their physics is finite" in line
    assert "diverged" not in caplog.text


@pytest.mark.parametrize(
    ("section", "term", "path", "kind"),
    [
        ("rewards", "{func: 'faulty_terms:inf_value'}", "task.rewards.bad", "infinite"),
        ("observations", "{func: 'faulty_terms:nan_obs'}", "task.observations.bad", "NaN"),
        ("metrics", "{func: 'faulty_terms:nan_value'}", "task.metrics.bad", "NaN"),
        ("metrics", "{func: 'faulty_terms:inf_value', reduce: mean}", "task.metrics.bad", "infin"),
        ("terminations", "{func: 'faulty_terms:nan_value'}", "task.terminations.bad", "NaN"),
    ],
)
def test_every_section_is_named(make, caplog, section, term, path, kind) -> None:
    env = make(f"{section}:\n  bad: {term}\n")
    with caplog.at_level(logging.WARNING):
        steps(env, 3)
    line = next(r.getMessage() for r in caplog.records if "bad" in r.getMessage())
    assert f"mine.yaml:3: {path} is {kind}" in line
    assert line.startswith("control step 2: ") and "1 of 4 environments (2)" in line
    assert "environments diverged" not in caplog.text


def test_a_command_that_is_nan_is_named_before_what_observes_it(make, caplog) -> None:
    env = make(
        """
        commands:
          bad: {func: 'faulty_terms:Command', resampling_time_s: [0.01, 0.01], params: {bad: true}}
        observations:
          seen: {func: generated_command, params: {command_name: bad}}
        """
    )
    with caplog.at_level(logging.WARNING):
        steps(env, 4)
    lines = [r.getMessage() for r in caplog.records if "NaN" in r.getMessage()]
    assert "task.commands.bad is NaN in 1 of 4 environments (2)" in lines[0]
    assert "task.observations.seen is NaN" in lines[1]


def test_a_curriculum_that_gives_nan_is_named(make, caplog) -> None:
    env = make("curriculum:\n  bad: {func: 'faulty_terms:nan_curriculum'}\n")
    with caplog.at_level(logging.WARNING):
        env.reset()
    assert "mine.yaml:3: task.curriculum.bad is nan" in caplog.text


def test_physics_that_diverges_is_said_so_and_no_term_is_blamed(make, caplog) -> None:
    env = make(
        "rewards:\n  far: {func: position, params: {of: {uid: robot, link: tool}, axes: x}}\n"
    )
    env.reset()
    action = torch.zeros(4, *env.single_action_space.shape)
    with caplog.at_level(logging.WARNING):
        env.step(action)
        env.sim.engine.write("qpos", np.nan, np.array([1]))
        info = env.step(action)[4]
    assert info["diverged"].tolist() == [False, True, False, False]
    assert "control step 1: 1 of 4 environments diverged (1); they end and are reset" in caplog.text
    assert "task." not in caplog.text


@pytest.mark.parametrize(
    ("section", "term"),
    [
        ("rewards", "{func: 'faulty_terms:raising'}"),
        ("terminations", "{func: 'faulty_terms:raising'}"),
        ("metrics", "{func: 'faulty_terms:raising'}"),
        ("observations", "{func: 'faulty_terms:raising_obs'}"),
        ("events", "{func: 'faulty_terms:raising_event', mode: interval, interval_step: 1}"),
    ],
)
def test_a_term_that_raises_is_named_and_its_traceback_is_kept(make, section, term) -> None:
    env = make(f"{section}:\n  bad: {term}\n")
    with pytest.raises(TermError) as caught:
        steps(env)
    said = str(caught.value)
    assert f"mine.yaml:3: task.{section}.bad: faulty_terms:raising" in said
    assert "raised KeyError: 'boom' (control step 2, " in said
    cause = caught.value.__cause__
    assert isinstance(cause, KeyError)
    assert cause.__traceback__ is not None
    frames = []
    trace = cause.__traceback__
    while trace is not None:
        frames.append(trace.tb_frame.f_code.co_name)
        trace = trace.tb_next
    assert "raising" in frames


def test_a_command_and_a_curriculum_that_raise_are_named(make) -> None:
    env = make(
        "commands:\n  bad: {func: 'faulty_terms:Command', resampling_time_s: [0.01, 0.01]}\n"
    )
    with pytest.raises(
        TermError, match=r"mine.yaml:3: task.commands.bad: .*OverflowError: too far"
    ):
        steps(env)
    env = make("curriculum:\n  bad: {func: 'faulty_terms:raising_event'}\n")
    steps(env)
    with pytest.raises(TermError, match=r"mine.yaml:3: task.curriculum.bad: .*KeyError: 'boom'"):
        env.reset(options={"reset_ids": [0, 3]})


def test_a_term_that_leaves_the_program_is_an_error(make) -> None:
    env = make("rewards:\n  bad: {func: 'faulty_terms:leaving'}\n")
    with pytest.raises(TermError, match=r"task.rewards.bad: .* raised SystemExit: 0"):
        steps(env)


def test_a_config_error_of_a_term_keeps_its_type_and_gets_its_place(make) -> None:
    with pytest.raises(ConfigError) as caught:
        make("rewards:\n  bad: {func: position, params: {of: {uid: robot}}}\n")
    assert "mine.yaml:3: task.rewards.bad" in str(caught.value)


def test_a_class_that_cannot_be_built_is_named(make) -> None:
    said = r"mine.yaml:3: task.metrics.bad: .*:Unbuilt raised ArithmeticError: no such thing"
    with pytest.raises(TermError, match=said):
        make("metrics:\n  bad: {func: 'faulty_terms:Unbuilt'}\n")


def test_it_is_said_in_the_first_the_tenth_and_the_hundredth_step(make, caplog) -> None:
    env = make("rewards:\n  bad: {func: 'faulty_terms:nan_value'}\n")
    with caplog.at_level(logging.WARNING):
        steps(env, 25)
    lines = [r.getMessage() for r in caplog.records if "task.rewards.bad" in r.getMessage()]
    assert [line.split(":")[0] for line in lines] == ["control step 2", "control step 11"]
    assert lines[1].endswith("such steps so far: 10")
