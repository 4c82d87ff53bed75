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
    """What is in a collection so far.

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
        return self.steps / episodes if episodes else None

    @property
    def share(self) -> float | None:
        """The yield: successes of all episodes; None before the first."""
        episodes = self.successes + self.failures
        return self.successes / episodes if episodes else None

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
        ConfigError: The task does not define success.
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
        self._planned = policy if isinstance(policy, PlannedPolicy) else None
        self._recorder = recorder
        self._writer = writer
        self._attempts = attempts
        self._log = recorder.stats.path.name
        count = env.num_envs
        self._numbers = np.zeros(count, np.int64)
        self._held = np.zeros(count, np.int64)  # control steps in a row with success
        self._waited = np.zeros(count, np.int64)  # control steps since the policy was done
        self._returns = np.zeros(count)
        self._cut = np.zeros(count, np.bool_)  # the next step ends these episodes
        self._undecided: list[CollectedEpisode] = []
        self._unwritten: list[CollectedEpisode] = []
        self._written = time.monotonic()

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
            self._returns += reward.numpy(force=True)
            done: Mask = (terminated | truncated).numpy(force=True)
            success = _success(info)
            if done.any():
                ended = np.flatnonzero(done)
                self._end(ended, success, terminated.numpy(force=True), info)
                obs = self._begin(ended)
                policy.reset(ended)
            self._cut_short(success, done)
            if self._unwritten and time.monotonic() - self._written > WRITE_SECONDS:
                self.write()
            yield

    def write(self) -> None:
        """Write the log to its file, then the episodes that ended to the lists.

        Raises:
            OSError: The log or a list could not be written.
        """
        episodes = self._unwritten
        self._unwritten = []
        if self._recorder.lists_counted:
            self._recorder.count([e.env for e in episodes], [e.episode for e in episodes])
        self._recorder.flush()
        self._writer.add(episodes)
        self._written = time.monotonic()

    def _begin(self, ids: NDArray[np.int64]) -> Any:
        """Begin the next attempts in environments (n,); return the observation of all."""
        numbers = np.array([self._attempts.begin() for _ in ids], np.int64)
        self._numbers[ids] = numbers
        self._held[ids] = self._waited[ids] = 0
        self._returns[ids] = 0.0
        self._env.streams.renumber(ids, numbers)
        obs, _ = self._env.reset(options={"reset_ids": ids})
        return obs

    def _cut_short(self, success: Mask, done: Mask) -> None:
        """End the episodes with the next step that have succeeded, or in which nothing follows."""
        self._held = np.where(success & ~done, self._held + 1, 0)
        self._cut = self._held >= self._rules.success_steps
        if self._planned is not None:
            finished = self._planned.done & ~done
            self._waited = np.where(finished, self._waited + 1, 0)
            self._cut |= self._waited > self._rules.wait_steps
            if finished.any():
                failures = self._planned.failures
                failed = [i for i in np.flatnonzero(finished).tolist() if failures[i] is not None]
                self._cut[failed] = True
        if self._cut.any():
            self._env.truncate(np.flatnonzero(self._cut))

    def _end(
        self, ids: NDArray[np.int64], success: Mask, terminated: Mask, info: dict[str, Any]
    ) -> None:
        """Note episodes that ended in the last control step."""
        env = self._env
        elapsed = env.episodes.elapsed
        episodes = env.episodes.ids
        discarded = self._planned.failures if self._planned is not None else ()
        for i in ids.tolist():
            succeeded = bool(success[i]) and not (discarded and discarded[i] == DISCARDED)
            failure = None if succeeded else self._failure(i, bool(terminated[i]), info)
            steps = int(elapsed[i])
            episode = CollectedEpisode(
                attempt=int(self._numbers[i]),
                log=self._log,
                env=i,
                episode=int(episodes[i]),
                first_step=env.control_step - steps,
                steps=steps,
                total_reward=float(self._returns[i]),
                success=succeeded,
                failure=failure,
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

    def _failure(self, i: int, terminated: bool, info: dict[str, Any]) -> str:
        """Why the episode of an environment failed, in one line."""
        env = self._env
        known = known_failure(env, i, self._planned, terminated, bool(info["diverged"][i]))
        if known is not None:
            return known
        if self._held[i] >= self._rules.success_steps:
            return "success did not last"
        if self._cut[i]:
            return DONE
        at_limit = env.episodes.elapsed[i] >= env.max_episode_steps
        timed_out = [n for n, value in env.termination_manager.values.items() if value[i]]
        return LATE if at_limit or timed_out else "ended by hand"


def _success(info: dict[str, Any]) -> Mask:
    """(N,) whether this step is a success of the task."""
    mask: Mask = info["success"].numpy(force=True)
    return mask
