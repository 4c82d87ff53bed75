"""`Collector`: how an episode ends in a collection, and what its failure is called."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

import embodichain
import embodichain.recording as recording
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.observers import StepObserver
from embodichain.lab.gym.policies import resolve_policy
from embodichain.recording import McapRecorder, RecordOptions
from embodichain.recording.check.verification import verify
from embodichain.recording.demos.attempts import Attempts
from embodichain.recording.demos.collecting import Collected, Collector, EndRules, failed_in
from embodichain.recording.demos.collection import (
    CollectedEpisode,
    CollectionWriter,
    read_collection,
)
from embodichain.utils.errors import ConfigError

pytestmark = pytest.mark.slow

Policy = Any


class Steps:
    """Each environment gets actions of 0; `value` from control step `since` on; has an end."""

    def __init__(
        self,
        value: float = 0.0,
        since: int = 0,
        done: int | None = None,
        failure: str | None = None,
    ) -> None:
        self.value, self.since, self.end, self.failure = value, since, done, failure
        self.count: NDArray[np.int64] = np.zeros(0, np.int64)
        self.resets: list[list[int] | None] = []

    def reset(self, env_ids: Any) -> None:
        self.resets.append(None if env_ids is None else list(env_ids))
        if env_ids is None:
            self.count = np.zeros(0, np.int64)
        else:
            self.count[env_ids] = 0

    def __call__(self, obs: Any, env: BaseEnv) -> torch.Tensor:
        if not len(self.count):
            self.count = np.zeros(env.num_envs, np.int64)
        action = np.zeros(env.action_space.shape or (), np.float32)
        action[self.count >= self.since] = self.value
        self.count += 1
        return torch.from_numpy(action)

    @property
    def done(self) -> NDArray[np.bool_]:
        return self.count >= (10**9 if self.end is None else self.end)

    @property
    def failures(self) -> Sequence[str | None]:
        return [self.failure if done else None for done in self.done]


Collect = Callable[..., list[CollectedEpisode]]


@pytest.fixture
def collect(tmp_path: Path) -> Collect:
    """Plays a policy in a task until so many episodes ended; returns what the lists say."""

    def run(
        task: str,
        policy: Policy,
        *overrides: str,
        episodes: int = 3,
        num_envs: int = 2,
        success_steps: int = 5,
        wait_steps: int = 2,
        observer: StepObserver | None = None,
        options: RecordOptions | None = None,
    ) -> list[CollectedEpisode]:
        env = embodichain.make(
            task, num_envs=num_envs, overrides=["seed=1", *overrides], autoreset_mode="DISABLED"
        )
        recorder = McapRecorder(tmp_path / "rollout.mcap", env, options=options)
        env.add_observer(recorder)
        if observer is not None:
            env.add_observer(observer)
        collected = Collected()
        rules = EndRules(success_steps, wait_steps)
        try:
            with CollectionWriter(tmp_path) as writer:
                attempts = Attempts(episodes)
                parts = env, policy, recorder, writer, attempts, rules, collected
                collector = Collector(*parts)
                for _ in collector.play():
                    if collected.successes + collected.failures >= episodes:
                        break
                collector.write()
        finally:
            env.close()
        listed = read_collection(tmp_path, failures=True)
        assert len(listed) == collected.successes + collected.failures
        assert sum(e.steps for e in listed) == collected.steps
        return listed

    return run


def test_success_that_holds_ends_an_episode(collect: Collect) -> None:
    policy = Steps()
    found = collect("hold_still", policy, success_steps=5)
    assert [(e.success, e.failure, e.steps) for e in found] == [(True, None, 6)] * 3
    assert policy.resets[0] is None and [0, 1] in policy.resets


def test_an_end_without_success_is_a_failure_after_the_wait(collect: Collect) -> None:
    found = collect("hold_still", Steps(value=1.0, done=4), wait_steps=3)
    assert {(e.failure, e.steps) for e in found} == {("done, but no success", 8)}


def test_success_within_the_wait_counts(collect: Collect) -> None:
    found = collect("hold_still", Steps(done=2), success_steps=100, wait_steps=3)
    assert {(e.success, e.steps) for e in found} == {(True, 6)}


def test_a_step_that_failed_ends_an_episode_at_once(collect: Collect) -> None:
    why = "step 1, grasp cube:\n the fingers closed on nothing"
    found = collect("hold_still", Steps(value=1.0, done=4, failure=why), wait_steps=50)
    line = "step 1, grasp cube: the fingers closed on nothing"
    assert {(e.failure, e.steps) for e in found} == {(line, 5)}


def test_success_is_judged_by_the_task_not_by_the_policy(collect: Collect) -> None:
    policy = Steps(done=4, failure="step 1: it thinks so")
    assert {e.success for e in collect("hold_still", policy, success_steps=100)} == {True}


def test_success_must_hold_in_the_last_step(collect: Collect) -> None:
    # After five steps of success the episode is cut; the arm moves in the very last one.
    found = collect("hold_still", Steps(value=1.0, since=5), success_steps=5)
    assert {e.failure for e in found} == {"success did not last"}


def test_a_termination_is_named(collect: Collect) -> None:
    found = collect("cart_pole", Steps(value=1.0), success_steps=1000)
    assert all((e.failure or "").startswith("terminated: ") for e in found)
    assert {failed_in(e.failure or "") for e in found} == {e.failure for e in found}


def test_the_time_limit_is_named(collect: Collect) -> None:
    found = collect("hold_still", Steps(value=1.0), "task.max_episode_steps=7")
    assert {(e.failure, e.steps) for e in found} == {("ran out of time", 7)}


def test_an_episode_that_is_ended_by_hand_is_named(collect: Collect) -> None:
    class Viewer(StepObserver):
        def on_step(self, env: Any, step: Any) -> None:
            if step.control_step % 4 == 3:
                env.truncate(np.arange(env.num_envs))

    found = collect("hold_still", Steps(value=1.0), observer=Viewer())
    assert {(e.failure, e.steps) for e in found} == {("ended by hand", 4)}


def test_a_divergence_is_named(collect: Collect) -> None:
    class Blow(StepObserver):
        def on_step(self, env: Any, step: Any) -> None:
            rows = env.sim.engine.rows.copy()
            start = env.sim.engine.component("qvel").start
            rows[:, start] = 1e12
            env.sim.engine.write("row", rows, None)

    found = collect("hold_still", Steps(), episodes=2, observer=Blow())
    assert {e.failure for e in found} == {"diverged"}


def test_episodes_begin_where_their_numbers_say(collect: Collect, tmp_path: Path) -> None:
    found = collect("reach", Steps(), "task.max_episode_steps=3", episodes=6)
    starts = {}
    with recording.open(tmp_path) as log:
        for one in found:
            snapshot = log.snapshot(one.env, one.episode, 0)
            starts[one.attempt] = snapshot.row
    env = embodichain.make("reach", num_envs=8, overrides=["seed=1"])
    try:
        env.reset()
        places = env.sim.engine.rows.copy()
        mocap = env.sim.engine.component("mocap_pos")
    finally:
        env.close()
    assert sorted(starts) == list(range(len(found)))
    for number, row in starts.items():
        np.testing.assert_array_equal(row[mocap], places[number][mocap])


@pytest.mark.parametrize("state", ["all", "keyframes"])
def test_the_log_replays_and_has_the_episodes(collect: Collect, tmp_path: Path, state: str) -> None:
    options = RecordOptions(state=state)
    policy, many = resolve_policy("random"), {"num_envs": 16, "episodes": 50}
    found = collect("cart_pole", policy, success_steps=60, options=options, **many)
    assert verify(tmp_path / "rollout.mcap").ok
    with recording.open(tmp_path) as log:
        assert {(e.env, e.episode) for e in log.episodes} >= {(e.env, e.episode) for e in found}
        for one in found:
            actions = log.read("actions", one.env, episode=one.episode)["actions"]
            assert len(actions) == one.steps


def test_a_task_without_success_cannot_be_collected(collect: Collect) -> None:
    with pytest.raises(ConfigError, match="says what success is: the metric `success`"):
        collect("hold_still", resolve_policy("hold"), "~task.metrics.success")


@pytest.mark.parametrize(
    ("failure", "step"),
    [
        ("step 2, grasp cube: the fingers closed on nothing", "step 2, grasp cube"),
        ("terminated: dropped", "terminated: dropped"),
        ("ran out of time", "ran out of time"),
        ("", ""),
    ],
)
def test_failures_are_counted_by_step(failure: str, step: str) -> None:
    collected = Collected()
    for steps in (3, 5):
        episode = CollectedEpisode(0, "rollout.mcap", 0, 0, 0, steps, 0.0, False, failure)
        collected.add(episode)
    assert dict(collected.failed_in) == {step: 2}
    assert (collected.share, collected.mean_length) == (0.0, 4.0)
    assert collected.failures_in_a_row == 2
    collected.add(CollectedEpisode(1, "rollout.mcap", 0, 1, 3, 4, 1.0, True))
    assert (collected.share, collected.failures_in_a_row) == (1 / 3, 0)
