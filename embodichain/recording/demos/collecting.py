"""`Collector`: plays a policy until enough episodes succeeded, and lists them as a collection.

Attempt g draws what environment g of a batch with the same seed draws in its first episode, in
whichever environment it runs (`RandomStreams.renumber`). So its start does not depend on the number
of environments, on the other episodes, or on interruptions; neither does the rest of the episode if
the policy's actions for an environment depend on nothing else.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.failures import DONE, LATE, failed_in, known_failure
from embodichain.lab.gym.policies import PlannedPolicy, Policy
from embodichain.lab.gym.teleop import DISCARDED
from embodichain.recording.demos.attempts import Attempts
from embodichain.recording.demos.collection import CollectedEpisode, CollectionWriter
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.recording.write.recorder import McapRecorder

__all__ = ["Collected", "Collector", "EndRules", "failed_in"]

WRITE_SECONDS = 0.5
"""Interval between two additions to the lists: a kill loses episodes of this time at most."""
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class EndRules:
    """When an episode ends before the task ends it.

    Attributes:
        success_steps: Control steps in a row with success.
        wait_steps: Control steps that a planned policy's episode goes on after it is done.
    """

    success_steps: int
    wait_steps: int


@dataclass(slots=True)
class Collected:
    """How many episodes a collection has so far.

    Attributes:
        successes: Episodes that succeeded.
        failures: Episodes that failed.
        failed_in: Number of failures by `failed_in`.
        steps: Control steps of all these episodes.
        failures_in_a_row: Episodes that failed since the last success.
    """

    successes: int = 0
    failures: int = 0
    failed_in: Counter[str] = field(default_factory=Counter)
    steps: int = 0
    failures_in_a_row: int = 0

    @property
    def mean_length(self) -> float | None:
        """Control steps of an episode; None before the first."""
        episodes = self.successes + self.failures
        if not episodes:
            return None
        return self.steps / episodes

    @property
    def share(self) -> float | None:
        """The yield: the share of episodes that succeeded; None before the first."""
        episodes = self.successes + self.failures
        if not episodes:
            return None
        return self.successes / episodes

    def add(self, episode: CollectedEpisode) -> None:
        """Count an episode."""
        self.steps += episode.steps
        if episode.success:
            self.successes += 1
            self.failures_in_a_row = 0
            return
        self.failures += 1
        self.failures_in_a_row += 1
        self.failed_in[failed_in(episode.failure or "")] += 1


class _Running:
    """The episodes that run in the environments; every array is (N,).

    Attributes:
        attempts: Number of the attempt.
        returns: Sum of rewards.
        success_steps: Control steps in a row with success.
        waited_steps: Control steps since the policy was done.
        are_cut: Whether the next step ends the episode.
    """

    def __init__(self, num_envs: int) -> None:
        self.attempts = np.zeros(num_envs, np.int64)
        self.returns = np.zeros(num_envs)
        self.success_steps = np.zeros(num_envs, np.int64)
        self.waited_steps = np.zeros(num_envs, np.int64)
        self.are_cut = np.zeros(num_envs, np.bool_)

    def begin(self, env_ids: NDArray[np.int64], attempts: NDArray[np.int64]) -> None:
        """Begin attempts in some environments."""
        self.attempts[env_ids] = attempts
        self.returns[env_ids] = 0.0
        self.success_steps[env_ids] = 0
        self.waited_steps[env_ids] = 0


class Collector:
    """Collects episodes of a batch of environments.

    Args:
        env: Just built, with autoreset mode DISABLED; nothing has been reset yet.
        policy: Acts in it; if it is a `PlannedPolicy`, its `done` and `failures` are used.
        recorder: Writes the log of `env`.
        writer: The lists of the collection.
        attempts: The attempts of the collection.
        rules: When episodes end.
        collected: What the collection contains already; updated in place.

    Raises:
        ConfigError: If the task does not define success.
    """

    def __init__(
        self,
        env: BaseEnv,
        policy: Policy,
        recorder: McapRecorder,
        writer: CollectionWriter,
        attempts: Attempts,
        rules: EndRules,
        collected: Collected,
    ) -> None:
        if not env.judges_success:
            message = "collect needs a task that says what success is: the metric `success`"
            raise ConfigError([Problem("task.metrics", message)])
        self.collected = collected
        self._env = env
        self._policy = policy
        self._rules = rules
        self._planned_policy = policy if isinstance(policy, PlannedPolicy) else None
        self._recorder = recorder
        self._writer = writer
        self._attempts = attempts
        self._running = _Running(env.num_envs)
        # Ended episodes: those that may yet be needed, and those that wait to be written.
        self._undecided: list[CollectedEpisode] = []
        self._unwritten: list[CollectedEpisode] = []
        self._written_at = time.monotonic()

    @property
    def complete(self) -> bool:
        """Whether enough episodes succeeded."""
        return self._attempts.complete

    def play(self) -> Iterator[None]:
        """Step the environments until the collection is complete; yields after each step.

        Call `write` when it ends, or is left.
        """
        env = self._env
        policy = self._policy
        obs = self._begin(np.arange(env.num_envs))
        policy.reset(None)
        while not self._attempts.complete:
            obs, reward, terminated, truncated, info = env.step(policy(obs, env))
            self._running.returns += reward.numpy(force=True)
            done: Mask = (terminated | truncated).numpy(force=True)
            success: Mask = info["success"].numpy(force=True)
            if done.any():
                env_ids = np.flatnonzero(done)
                self._end(env_ids, success, terminated.numpy(force=True), info)
                obs = self._begin(env_ids)
                policy.reset(env_ids)
            self._cut_short(success, done)
            if self._unwritten and time.monotonic() - self._written_at > WRITE_SECONDS:
                self.write()
            yield

    def write(self) -> None:
        """Write the log to its file, then the episodes that ended to the lists.

        Raises:
            OSError: If the log or a list could not be written.
        """
        episodes = self._unwritten
        self._unwritten = []
        if self._recorder.lists_counted:
            self._recorder.count([e.env for e in episodes], [e.episode for e in episodes])
        self._recorder.flush()
        self._writer.add(episodes)
        self._written_at = time.monotonic()

    def _begin(self, env_ids: NDArray[np.int64]) -> Any:
        """Begin the next attempts in environments (n,); return the observation of all."""
        attempts = np.array([self._attempts.begin() for _ in env_ids], np.int64)
        self._running.begin(env_ids, attempts)
        self._env.streams.renumber(env_ids, attempts)
        obs, _ = self._env.reset(options={"reset_ids": env_ids})
        return obs

    def _cut_short(self, success: Mask, done: Mask) -> None:
        """End episodes with the next step that have succeeded, or in which nothing more happens."""
        running = self._running
        running.success_steps = np.where(success & ~done, running.success_steps + 1, 0)
        running.are_cut = running.success_steps >= self._rules.success_steps
        if self._planned_policy is not None:
            finished = self._planned_policy.done & ~done
            running.waited_steps = np.where(finished, running.waited_steps + 1, 0)
            running.are_cut |= running.waited_steps > self._rules.wait_steps
            if finished.any():
                failures = self._planned_policy.failures
                for env_id in np.flatnonzero(finished).tolist():
                    # A plan that failed is not waited for: nothing can succeed any more.
                    if failures[env_id] is not None:
                        running.are_cut[env_id] = True
        if running.are_cut.any():
            self._env.truncate(np.flatnonzero(running.are_cut))

    def _end(
        self, env_ids: NDArray[np.int64], success: Mask, terminated: Mask, info: dict[str, Any]
    ) -> None:
        """Note episodes that ended in the last control step."""
        for env_id in env_ids.tolist():
            episode = self._ended_episode(
                env_id, bool(success[env_id]), bool(terminated[env_id]), info
            )
            self._attempts.end(episode.attempt, episode.success)
            self._undecided.append(episode)
        undecided = self._undecided
        self._undecided = []
        for episode in undecided:
            needed = self._attempts.is_needed(episode.attempt)
            if needed is None:
                self._undecided.append(episode)
            elif needed:
                self.collected.add(episode)
                self._unwritten.append(episode)

    def _ended_episode(
        self, env_id: int, success: bool, terminated: bool, info: dict[str, Any]
    ) -> CollectedEpisode:
        if self._planned_policy is not None:
            failures = self._planned_policy.failures
            if failures and failures[env_id] == DISCARDED:
                success = False
        steps = int(self._env.episodes.elapsed[env_id])
        return CollectedEpisode(
            attempt=int(self._running.attempts[env_id]),
            log=self._recorder.stats.path.name,
            env=env_id,
            episode=int(self._env.episodes.ids[env_id]),
            first_step=self._env.control_step - steps,
            steps=steps,
            total_reward=float(self._running.returns[env_id]),
            success=success,
            failure=None if success else self._failure(env_id, terminated, info),
        )

    def _failure(self, env_id: int, terminated: bool, info: dict[str, Any]) -> str:
        """Why the episode of an environment failed, in one line."""
        env = self._env
        failure = known_failure(
            env, env_id, self._planned_policy, terminated, bool(info["diverged"][env_id])
        )
        if failure is not None:
            return failure
        if self._running.success_steps[env_id] >= self._rules.success_steps:
            return "success did not last"
        if self._running.are_cut[env_id]:
            return DONE
        if env.episodes.elapsed[env_id] >= env.max_episode_steps:
            return LATE
        if any(fired[env_id] for fired in env.termination_manager.values.values()):
            return LATE
        return "ended by hand"
