"""Of two keys that set one value, steps and seconds for example, the one given last counts."""

import dataclasses
import json
from pathlib import Path

import pytest

import embodichain
from embodichain.config import compose, resolve, validate, write_record
from embodichain.config.rerun import resolve_run
from embodichain.utils.errors import ConfigError
from tests.config.conftest import GOOD, WriteTask

# A control step is 0.02 s: 4 physics steps of 0.005 s.


def steps(*lines: str) -> int:
    """The length of an episode, in control steps."""
    with embodichain.make("mine", 1, list(lines), seed=0) as env:
        return env.max_episode_steps


def test_seconds_after_steps_and_steps_after_seconds(write_task: WriteTask) -> None:
    write_task()
    assert steps() == 50
    assert steps("task.episode_length_s=3") == 150
    assert steps("task.episode_length_s=3", "task.max_episode_steps=7") == 7
    assert steps("task.max_episode_steps=7", "task.episode_length_s=3") == 150
    assert steps("task.episode_length_s=3", "task.episode_length_s=null") == 50
    Path("conf/task/base.yaml").write_text(GOOD)
    write_task(text="defaults: [base, _self_]\nepisode_length_s: 2\n")
    assert steps() == 100
    assert steps("task.max_episode_steps=7") == 7
    Path("conf/task/base.yaml").write_text(
        GOOD.replace("max_episode_steps: 50", "episode_length_s: 5")
    )
    write_task(text="defaults: [base, _self_]\nmax_episode_steps: 9\n")
    assert steps() == 9


def test_decimation(write_task: WriteTask) -> None:
    write_task("max_episode_steps: 50", "sim_steps_per_control: 5")
    for lines, dt in (([], 0.025), (["task.decimation=2"], 0.01)):
        with embodichain.make("mine", 1, lines, seed=0) as env:
            assert env.step_dt == pytest.approx(dt)


def test_both_in_one_file(write_task: WriteTask) -> None:
    write_task("max_episode_steps: 50", "max_episode_steps: 50\nepisode_length_s: 1")
    assert [str(p) for p in validate(compose(["task=mine"]))] == [
        "conf/task/mine.yaml:3: task.max_episode_steps: task.episode_length_s sets it too; "
        "set one of them"
    ]


def test_of_a_run_that_was_made(write_task: WriteTask, tmp_path: Path) -> None:
    write_task("max_episode_steps: 50", "episode_length_s: 5")
    write_record(tmp_path, resolve(compose(["task=mine", "task.episode_length_s=4"])))
    (tmp_path / "summary.json").write_text(json.dumps({"task": "mine"}))
    task = resolve_run(tmp_path, ["task.max_episode_steps=6"]).root.task
    assert (task.episode_length_s, int(task.max_episode_steps)) == (None, 6)
    assert resolve_run(tmp_path).root.task.episode_length_s == 4
    assert dataclasses.is_dataclass(task)
    rewards = resolve_run(tmp_path, ["task.rewards.near=null"]).root.task.rewards
    assert rewards == {}


def test_a_policy_that_nobody_asked_for() -> None:
    """The task suggests `hold`, which reads the simulation; `make` has no policy."""
    with embodichain.make("quadruped_velocity", 2, seed=0) as env:
        assert env.num_envs == 2
    lines = ["sim.backend=ray", "sim.shards=2"]
    task = ["task=quadruped_velocity", *lines]
    (problem,) = validate(compose(task))
    assert problem.path == "policy"
    with pytest.raises(TypeError, match="render_mode has no form"):  # after the check
        embodichain.make("quadruped_velocity", 2, lines, render_mode="rgb_array")
    with pytest.raises(ConfigError, match="policy: hold reads the simulation"):
        embodichain.make("quadruped_velocity", 2, [*lines, "policy=hold"])
