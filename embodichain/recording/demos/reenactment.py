"""`Reenactment`: the task of a log, built again and stepped through the recorded actions.

Observations are not in a log. The environment that its config describes draws the same numbers from
the same seed, so the recorded actions give the same observations again: with noise, delays and
histories, and images as the task's cameras see them.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from dataclasses import replace
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, Self, cast

import mujoco
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from embodichain.config.composition.environment import as_reader, notes_of_today
from embodichain.config.environments.host_arrays import with_arrays
from embodichain.config.resolved import Resolved, resolve_tree
from embodichain.lab.gym.envs.observation import Observation
from embodichain.lab.gym.envs.observers import ObservedEnv, StepObserver
from embodichain.lab.sim.engine.api import F64, PhysicsEvent
from embodichain.lab.sim.engine.fields import row_layout
from embodichain.recording.format.log_error import LogError
from embodichain.recording.format.messages.block import CallKind
from embodichain.recording.read.recorded_log import RecordedLog
from embodichain.recording.read.simulation import Simulation
from embodichain.recording.read.trajectory import FollowedRows, Span, changes, follow, outcomes
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["Reenactment", "Step", "config_of"]

_SAME_TASK = 1e-4
"""Difference of positions (m or rad) at an episode's start above which the task is another one.
Another processor causes smaller differences."""
_log = logging.getLogger(__name__)


def config_of(log: RecordedLog) -> Resolved:
    """The log's config without recording and viewer; no module that it names is imported.

    Arrays are on the host, where states can be compared with the recorded ones.

    Raises:
        ConfigError: If the log contains no config, or the config has mistakes.
    """
    tree = log.written_config
    if "task" not in tree:
        raise ConfigError(f"{log.path} contains no config: it was not recorded by `run`")
    job_options = {
        "viewer": {"name": "none"},
        "quiet": True,
        "video": False,
        "resume": None,
        "trust": False,  # a log does not decide which code this machine runs
    }
    tree = dict(tree)
    tree["seed"] = log.seed
    tree["num_envs"] = log.num_envs
    tree["policy"] = None
    for name, value in job_options.items():
        if name in tree:
            tree[name] = value
    source = f"{log.path}: config.yaml"
    resolved = resolve_tree(as_reader(tree), source, "run", task_name=log.task)
    for note in notes_of_today(resolved.tree):
        _log.warning("%s", note)
    return with_arrays(replace(resolved, varied=log.varied), "host")


class Step(NamedTuple):
    """A control step of all N environments.

    Attributes:
        number: Control step of the log.
        row: (N, nstate) recorded full state before its physics.
        action: (N, A) recorded action, float64.
        reward: (N,) recorded reward.
        terminated: (N,) bool, recorded.
        truncated: (N,) bool, recorded.
        episodes: (N,) episode that the step belongs to.
        seen: Observation after the step.
        next: Observation after the reset of environments whose episode ended; `seen` if none did.
    """

    number: int
    row: F64
    action: F64
    reward: NDArray[np.float32]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    episodes: NDArray[np.int64]
    seen: Observation
    next: Observation


class Reenactment:
    """Steps the environment of a log through the recorded actions. Close it, or use `with`.

    Before the physics of each step, the simulation's states are compared with the recorded ones.
    With the software and the processor of the recording all are the same, bit for bit, and so are
    the observations. Where they differ, the simulation continues from the recorded states, so that
    errors do not grow; `corrected` counts these states, and a warning is logged at the end.

    Args:
        log: The log; it must begin with the first episodes of all environments, without gaps.
        numbers: (environment, episode) to the number of the random stream that it drew from
            (`RandomStreams.renumber`); other episodes are played with the wrong draws, and not
            compared. None: every environment drew from its own.

    Attributes:
        env: The environment.
        first: The observation after the first reset.
        corrected: Number of states, over environments and steps, that were not the recorded ones.

    Raises:
        ConfigError: If the log contains no config, or one with mistakes; if it does not begin with
            first episodes; if its task has other rows than the recorded scene.
        LogError: If the log has no states or no steps, or is damaged.
    """

    env: BaseEnv
    first: Observation

    def __init__(
        self, log: RecordedLog, numbers: Mapping[tuple[int, int], int] | None = None
    ) -> None:
        from embodichain.config.environments.factory import make_env

        self._log = log
        self._numbers = numbers
        self.corrected = 0
        log.header.require_states(log.path)
        _require_beginning(log)
        self.env = make_env(config_of(log), autoreset_mode=AutoresetMode.DISABLED)
        try:
            self._rows = self._follower()
            self._check_scene()
            self._comparison = _Comparison(log, self._rows)
            self.env.add_observer(self._comparison)
            self.first = self._reset(np.arange(self.env.num_envs))
        except BaseException:
            self.env.close()
            raise

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the environment."""
        self.close()

    def steps(self, last: int | None = None) -> Iterator[Step]:
        """Yield the control steps of the log. Can be called once.

        Args:
            last: The last one, included; None is the end of the log.

        Raises:
            ConfigError: If the environment begins or ends its episodes in another way than
                recorded: the code of the task or of its terms was changed.
            LogError: If the log is damaged.
        """
        number = self._log.header.first_step
        for run, t in follow(self._log.reader, self._rows, Span(0, last), _changes_or_outcomes):
            if run.first + t != number:
                raise LogError(f"{self._log.path} lacks control step {number}")
            yield self._step(number, {n: a[t] for n, a in run.calls[-1].arrays.items()})
            number += 1
        self.corrected = self._comparison.corrected
        if self.corrected:
            self._warn(number)

    def _step(self, number: int, recorded: dict[str, NDArray[Any]]) -> Step:
        env = self.env
        terminated = recorded["terminated"]
        truncated = recorded["truncated"]
        if truncated.any():
            env.truncate(np.flatnonzero(truncated))
        episodes = env.episodes.ids.copy()
        if not np.array_equal(episodes, recorded["episode_ids"]):
            raise ConfigError(f"{self._log.path}: step {number} is of other episodes: {_CHANGED}")
        is_comparable = self._is_comparable(episodes)
        self._comparison.expect(number, is_comparable, begins=env.episodes.elapsed == 0)
        row = self._rows.rows.copy()
        obs, _, terminated_here, truncated_here, _ = env.step(_action(recorded["action"]))
        self._check_ends(number, "terminated", terminated_here.numpy(), terminated, is_comparable)
        self._check_ends(number, "truncated", truncated_here.numpy(), truncated, is_comparable)
        seen = cast("Observation", obs)
        done = np.flatnonzero(terminated | truncated)
        return Step(
            number=number,
            row=row,
            action=recorded["action"],
            reward=recorded["reward"],
            terminated=terminated,
            truncated=truncated,
            episodes=episodes,
            seen=seen,
            next=self._reset(done) if len(done) else seen,
        )

    def _reset(self, ids: NDArray[np.int64]) -> Observation:
        """Begin the next episodes of environments (n,); return the observation of all."""
        env = self.env
        if self._numbers is not None:
            renumbered = []
            numbers = []
            for env_id in ids.tolist():
                next_episode = int(env.episodes.ids[env_id]) + 1
                if (env_id, next_episode) in self._numbers:
                    renumbered.append(env_id)
                    numbers.append(self._numbers[env_id, next_episode])
            env.streams.renumber(np.array(renumbered, np.int64), np.array(numbers, np.int64))
        obs, _ = env.reset(options={"reset_ids": ids})
        return cast("Observation", obs)

    def _is_comparable(self, episodes: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(N,) environments whose current episode draws as when it was recorded."""
        if self._numbers is None:
            return np.ones(len(episodes), np.bool_)
        return np.array([key in self._numbers for key in enumerate(episodes.tolist())])

    def _check_ends(
        self,
        number: int,
        name: str,
        here: NDArray[np.bool_],
        recorded: NDArray[np.bool_],
        is_comparable: NDArray[np.bool_],
    ) -> None:
        differs = np.flatnonzero((here != recorded) & is_comparable)
        if len(differs):
            env = int(differs[0])
            when = "when recorded, not here" if recorded[env] else "here, not when recorded"
            raise ConfigError(
                f"{self._log.path}: step {number}: the episode of environment {env} is {name} "
                f"{when}: {_CHANGED}"
            )

    def _follower(self) -> FollowedRows:
        log = self._log
        if log.header.keyframe_every:
            return Simulation(log.reader, log.model_to_simulate)
        return FollowedRows(log.reader)

    def _check_scene(self) -> None:
        log = self._log
        model = self.env.sim.engine.model
        layout = {
            name: (columns.start, columns.stop) for name, columns in row_layout(model).items()
        }
        if layout != dict(log.header.layout):
            raise ConfigError(f"{log.path}: its scene has other joints or bodies: {_CHANGED}")

    def _warn(self, steps: int) -> None:
        header = self._log.header
        if header.mujoco_version != mujoco.__version__:
            reason = (
                f"it was recorded with MuJoCo {header.mujoco_version}, not {mujoco.__version__}"
            )
        elif not header.has_writes:
            reason = "it has states of a device, in float32; these were computed on the host"
        else:
            reason = "it was recorded on another kind of processor, or terms were changed"
        _log.warning(
            "%s: %d of %d states differ from the recorded ones, by %.3g in positions (m, rad) at "
            "most; the recorded ones were used, and observations are as exact as that: %s",
            self._log.path,
            self.corrected,
            steps * header.num_envs,
            self._comparison.largest,
            reason,
        )


_CHANGED = "the code of the task or of its terms was changed since"


def _changes_or_outcomes(kind: CallKind) -> bool:
    return changes(kind) or outcomes(kind)


def _require_beginning(log: RecordedLog) -> None:
    """Raise if the draws of a log's environment cannot be repeated."""
    if log.header.every > 1:
        raise ConfigError(
            f"{log.path} was recorded with record.every={log.header.every}: observations can only "
            "be computed again from a log of all episodes"
        )
    first_episodes = [e for e in log.episodes if e.first_step == log.header.first_step]
    if not first_episodes:
        raise LogError(f"{log.path} has no complete control step")
    if log.header.first_step or any(episode.episode > 0 for episode in first_episodes):
        raise ConfigError(
            f"{log.path} does not begin with first episodes: observations can only be computed "
            "again from the run's start (of a log in several files, name the first)"
        )


def _action(recorded: F64) -> torch.Tensor:
    """The action as the policy gave it: float32 unless that would lose digits."""
    single = recorded.astype(np.float32)
    if (single == recorded).all():
        return torch.from_numpy(single)
    return torch.from_numpy(recorded.copy())


class _Expectation(NamedTuple):
    """The control step whose physics comes next.

    Attributes:
        number: The control step.
        is_comparable: (N,) environments whose states should be the recorded ones.
        begins: (N,) environments whose episode begins with it.
    """

    number: int
    is_comparable: NDArray[np.bool_]
    begins: NDArray[np.bool_]


class _Comparison(StepObserver):
    """Compares the states before physics with the recorded ones, and replaces those that differ.

    Args:
        log: The log.
        rows: The recorded rows, which follow the log to the same step.

    Attributes:
        corrected: Number of states that differed.
        largest: Largest difference of a position.
    """

    def __init__(self, log: RecordedLog, rows: FollowedRows) -> None:
        self._path = log.path
        self._rows = rows
        layout = log.header.layout
        components = [name for name in ("qpos", "mocap_pos", "mocap_quat") if name in layout]
        self._positions = np.concatenate([np.arange(*layout[name]) for name in components])
        self._is_same_mujoco = log.header.mujoco_version == mujoco.__version__
        self._expectation: _Expectation | None = None
        self.corrected = 0
        self.largest = 0.0

    def expect(
        self, number: int, is_comparable: NDArray[np.bool_], begins: NDArray[np.bool_]
    ) -> None:
        """Compare before the next physics: see `_Expectation`."""
        self._expectation = _Expectation(number, is_comparable, begins)

    def on_physics(self, env: ObservedEnv, event: PhysicsEvent) -> None:
        """Compare, once a control step."""
        if event.phase != "before" or self._expectation is None:
            return
        number, is_comparable, begins = self._expectation
        self._expectation = None
        recorded = self._rows.rows
        differs = (event.rows.view(np.uint64) != recorded.view(np.uint64)).any(axis=1)
        if not differs.any():
            return
        env_ids = np.flatnonzero(differs)
        error = np.abs(event.rows[env_ids] - recorded[env_ids])
        distance = error[:, self._positions].max(axis=1, initial=0.0)
        distance[~is_comparable[env_ids]] = 0.0
        begun_elsewhere = env_ids[(distance > _SAME_TASK) & begins[env_ids]]
        if len(begun_elsewhere) and self._is_same_mujoco:
            raise ConfigError(
                f"{self._path}: step {number}: the episode of environment "
                f"{int(begun_elsewhere[0])} begins in another state than recorded: {_CHANGED}"
            )
        self.corrected += int(is_comparable[env_ids].sum())
        self.largest = max(self.largest, float(np.nanmax(distance, initial=0.0)))
        env.sim.engine.write("row", recorded[env_ids], env_ids)
