"""A step as arrays: the same numbers as `step`, for who reads arrays; nothing returned changes."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import (
    MetricCfg,
    ObservationCfg,
    RewardCfg,
    TerminationCfg,
)
from embodichain.lab.gym.envs.step.step_result import StepResult
from embodichain.lab.gym.vector import NumpyVectorEnv
from embodichain.learning import SB3VecEnv
from tests.helpers.ur10_task import HOME, builder, task

TOOL = {"uid": "ur10", "link_names": ["ee_link"]}
PAIR = {"from": TOOL, "to": {"uid": "cube"}}
SECTIONS: dict[str, Any] = {
    "max_episode_steps": 3,
    "observations": {
        "qpos": ObservationCfg("joint_position", {"of": {"uid": "ur10"}}),
        "is_near": ObservationCfg("distance", PAIR, shape={"below": 0.5}),
        "distance": ObservationCfg("distance", PAIR),
    },
    "rewards": {
        "near": RewardCfg("distance", PAIR, weight=-1.0),
        "done_well": RewardCfg("distance", PAIR, shape={"below": 5.0}, weight=0.5),
    },
    "terminations": {
        "high": TerminationCfg("height", {"of": TOOL}, shape={"above": 9.0}, kind="fail")
    },
    "metrics": {
        "success": MetricCfg("distance", PAIR, shape={"below": 5.0}),
        "mean": MetricCfg("distance", PAIR, reduce="mean"),
        "worst": MetricCfg("distance", PAIR, reduce="max"),
    },
}


@pytest.fixture
def make() -> Iterator[Any]:
    with builder() as build:
        yield lambda **sections: build(**{**SECTIONS, **sections})


def actions(count: int, seed: int = 0) -> list[np.ndarray]:
    drawn = np.random.default_rng(seed).uniform(-0.3, 0.3, (count, 3, 6))
    return list((drawn + HOME).astype(np.float32))


FINALS = ("final_obs", "final_info", "_final_obs", "_final_info", "final_observation")


def same(entry: Any, other: Any) -> None:
    """Compare an entry of ``info`` with one of another, or of `StepResult.entries`."""
    if isinstance(entry, dict) or hasattr(entry, "names"):
        assert set(entry) == set(other)
        for name in entry:
            same(entry[name], other[name])
    else:
        np.testing.assert_array_equal(entry, other, strict=True)


def test_arrays_are_the_numbers_of_the_torch_step(make: Any) -> None:
    torch_env, array_env = make(), make()
    torch_env.reset(seed=1), array_env.reset(seed=1)
    for action in actions(8):
        obs, reward, terminated, truncated, info = torch_env.step(torch.from_numpy(action))
        result = array_env.step_arrays(action)
        np.testing.assert_array_equal(obs.rows, result.obs.rows)
        for tensor, array in (
            (reward, result.reward),
            (terminated, result.terminated),
            (truncated, result.truncated),
        ):
            np.testing.assert_array_equal(tensor, array, strict=True)
        entries = result.entries()
        for name, entry in entries.items():
            same(info[name], entry)
        assert set(info) - set(entries) == ({*FINALS} if result.final_obs is not None else set())
        if result.final_obs is not None:
            np.testing.assert_array_equal(info["final_obs"].rows, result.final_obs.rows)
            np.testing.assert_array_equal(info["_final_obs"], result.done)
    assert result.metrics["mean"][0] < result.metrics["worst"][0]


def test_what_a_caller_writes_to_info_changes_no_later_step(make: Any) -> None:
    env, untouched = make(), make()
    env.reset(seed=1), untouched.reset(seed=1)
    for action in actions(8):
        info = env.step(torch.from_numpy(action))[-1]
        other = untouched.step(torch.from_numpy(action))[-1]
        for name in ("metrics", "rewards", "episode_sums"):
            for key, value in info[name].items():
                same(value, other[name][key])
                value.fill_(1)
        for name in ("success", "fail", "success_terminated", "elapsed_steps", "diverged"):
            same(info[name], other[name])
            info[name].fill_(1)
        assert torch.equal(env.is_task_success(), untouched.is_task_success())
        assert torch.equal(env.elapsed_steps, untouched.elapsed_steps)


def test_learners_step_without_info(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    env = make()
    learner = SB3VecEnv(env)

    class Wrapped(BaseEnv):
        """Takes the way of a class with hooks, which read ``info``."""

        def _hook_after_sim_step(self, *args: Any, **kwargs: Any) -> None:
            assert "success" in args[4]

    hooked = SB3VecEnv(Wrapped(task(**SECTIONS)))
    assert not hooked.base.steps_in_arrays and env.steps_in_arrays
    learner.seed(2), hooked.seed(2)
    np.testing.assert_array_equal(learner.reset(), hooked.reset())
    for action in actions(7):
        scaled = np.clip(action / 7, -1, 1)
        expected = hooked.step(scaled)
        with monkeypatch.context() as patch:
            # `info` is expensive: the learner's door must not ask for it.
            patch.setattr(StepResult, "info", None)
            found = learner.step(scaled)
        for array, array_of_hooked in zip(found[:3], expected[:3], strict=True):
            np.testing.assert_array_equal(array, array_of_hooked, strict=True)
        for info, info_of_hooked in zip(found[3], expected[3], strict=True):
            assert info.keys() == info_of_hooked.keys()
            for key in info.keys() - {"episode", "terminal_observation"}:
                assert info[key] == info_of_hooked[key]
    hooked.close()


def test_a_hook_may_change_what_a_learner_is_told() -> None:
    class Generous(BaseEnv):
        def _hook_after_sim_step(self, *args: Any, **kwargs: Any) -> None:
            args[4]["success"].fill_(True)

    sections = {
        **SECTIONS,
        "metrics": {"success": MetricCfg("distance", PAIR, shape={"below": 0.0})},
    }
    learner = SB3VecEnv(Generous(task(**sections)))
    learner.reset()
    for _ in range(3):
        infos = learner.step(np.zeros((3, 6), np.float32))[-1]
    assert [info["is_success"] for info in infos] == [True] * 3
    learner.close()


def test_a_vector_has_entries_that_are_not_floating_point(make: Any) -> None:
    learner = SB3VecEnv(make())
    observed = learner.reset()
    obs = learner.env.reset(seed=0)[0]
    expected = torch.cat([obs["qpos"], obs["is_near"].float(), obs["distance"]], dim=1)
    # SB3's door has no public way to flatten an observation that was not stepped to.
    np.testing.assert_array_equal(learner._observed(obs), expected, strict=True)
    assert observed.shape == (3, 8) and obs["is_near"].dtype == torch.bool


@pytest.mark.parametrize("mode", ["same_step", "next_step"])
def test_arrays_of_a_vector_environment_do_not_change(make: Any, mode: str) -> None:
    env = NumpyVectorEnv(make(), autoreset_mode=mode)
    env.reset(seed=3)
    steps: list[tuple[Any, Any]] = []
    for action in actions(7):
        result = env.step(action)
        result[1][...] = 9.0  # the caller's own
        result[4]["metrics"]["mean"][...] = 9.0
        steps.append((result, snapshot(result)))
    for result, before in steps:
        assert snapshot(result) == before


def test_without_rewards_info_has_empty_maps(make: Any) -> None:
    env = make(rewards={})
    env.reset()
    info = env.step(torch.from_numpy(actions(1)[0]))[-1]
    assert (info["rewards"], info["episode_sums"]) == ({}, {})
    assert type(info["rewards"]) is type(info["episode_sums"]) is dict


def snapshot(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: snapshot(entry) for key, entry in value.items()}
    if isinstance(value, (tuple, list)):
        return [snapshot(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return [snapshot(entry) for entry in value] if value.dtype == object else value.tobytes()
    return value
