"""The part of a log to write, and what the writers of parts share."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.recording.read.api import Log
from embodichain.recording.read.episodes import LogEpisode
from embodichain.recording.read.playback import Playback, Span, Stretch
from embodichain.utils.errors import ConfigError

__all__ = [
    "Demonstration",
    "Part",
    "about",
    "demonstrations",
    "episodes_with_draws",
    "poses",
    "span_of_part",
]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Part:
    """The part of a log to write.

    Attributes:
        env: One environment; None is all (for ROS 2 and Rerun the viewed ones, for mp4 the first
            viewed one).
        episode: One of its episodes; needs `env`.
        start: First control step.
        stop: End of the control steps, exclusive; None is the end of the log.
        cameras: Cameras whose pictures are drawn, see `cameras_of`; None is all camera sensors of
            the task (for mp4, one: the scene's ``default`` or a front view).
        size: Width and height of the pictures in pixels; None is that of each camera.
    """

    env: int | None = None
    episode: int | None = None
    start: int = 0
    stop: int | None = None
    cameras: tuple[str, ...] | None = None
    size: tuple[int, int] | None = None

    @property
    def last(self) -> int | None:
        """Last control step, included; None is the end of the log."""
        return None if self.stop is None else self.stop - 1

    def envs_of(self, log: Log) -> list[int]:
        """The selected environment, or the viewed ones if none is selected."""
        if self.env is not None:
            return [self.env]
        return log.header.view_envs or [0]

    def steps_of(self, episode: LogEpisode) -> range:
        """The control steps of an episode that are in the part."""
        if self.env not in (None, episode.env):
            return range(0)
        if self.episode not in (None, episode.episode):
            return range(0)
        start = max(self.start, episode.first_step)
        stop = episode.last_step + 1
        if self.stop is not None:
            stop = min(stop, self.stop)
        return range(start, stop)


@dataclass(frozen=True, slots=True)
class Demonstration:
    """An episode, or the steps of it that are in a part.

    Attributes:
        episode: The episode.
        steps: Its control steps in the part, counted from the start of the log.
    """

    episode: LogEpisode
    steps: range

    @property
    def span(self) -> Span:
        """Its control steps, as a playback takes them."""
        return Span(self.steps.start, self.steps.stop - 1)


def about(log: Log) -> dict[str, str]:
    """Metadata for tables: task, seed, versions, whether the log is complete."""
    header = log.header
    return {
        "task": header.task,
        "seed": str(header.seed),
        "num_envs": str(header.num_envs),
        "control_dt": repr(header.control_dt),
        "physics_dt": repr(header.physics_dt),
        "mujoco_version": header.mujoco_version,
        "complete": str(log.complete).lower(),
        "quaternions": "wxyz",
    }


def episodes_with_draws(log: Log, part: Part) -> list[LogEpisode]:
    """The episodes of a part for which the log has draws: those that ended, by environment."""
    return [episode for episode in log.episodes if episode.drawn and part.steps_of(episode)]


def demonstrations(log: Log, part: Part) -> list[Demonstration]:
    """Return the episodes of a part and their steps in it, by environment, then in time.

    With `record.every`, steps of some episodes are missing. These episodes are left out, since a
    demonstration must have no gaps, and their number is logged.

    Raises:
        ConfigError: If there are no episodes.
    """
    all_demos = []
    for episode in log.episodes:
        steps = part.steps_of(episode)
        if steps:
            all_demos.append(Demonstration(episode, steps))
    if not all_demos:
        raise ConfigError("no episode is in the chosen range")
    if log.header.every <= 1:
        return all_demos
    recorded = log.read(()).steps
    demos = [demo for demo in all_demos if _is_recorded(demo, recorded)]
    why = f"record.every={log.header.every} did not record all of their steps"
    if not demos:
        raise ConfigError(f"none of {len(all_demos)} episodes is whole: {why}")
    left_out = len(all_demos) - len(demos)
    if left_out:
        _log.warning("%d of %d episodes are left out: %s", left_out, len(all_demos), why)
    return demos


def _is_recorded(demo: Demonstration, recorded: NDArray[np.int64]) -> bool:
    """Whether all steps of a demonstration are among the recorded ones, which ascend."""
    first, end = np.searchsorted(recorded, [demo.steps.start, demo.steps.stop]).tolist()
    return bool(end - first == len(demo.steps))


def span_of_part(log: Log, env: int, part: Part) -> Span:
    """The control steps of a part, as a playback of one environment takes them.

    Raises:
        ConfigError: If the part does not exist.
    """
    stretch = Stretch(env=env, episode=part.episode, first=part.start, last=part.last)
    return stretch.span_in(log)


def poses(log: Log, env: int, part: Part) -> Iterator[tuple[int, mujoco.MjData, bool]]:
    """Yield the control steps of a part of one environment.

    Each comes with the input state of physics and its kinematics, in data that the next step
    overwrites, and with whether `data.model`, the environment's model, has changed.

    Raises:
        ConfigError: If the part does not exist.
        LogError: If the log is damaged.
    """
    playback = Playback(log, env)
    data = mujoco.MjData(log.model)
    changes = -1  # so that the first step counts as changed
    for step in playback.steps(span_of_part(log, env, part)):
        changed = playback.changes != changes
        if changed:
            changes = playback.changes
            data = mujoco.MjData(playback.engine.model_of(0))
        state = playback.engine.rows[0]
        mujoco.mj_setState(data.model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_kinematics(data.model, data)
        yield step, data, changed
