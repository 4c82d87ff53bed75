"""`read_episodes`: the episodes of logs, with the observations that the policy received.

Observations are computed again by a `Reenactment`. Episodes come in the order in which they ended,
one at a time: memory holds one episode of each environment, and images are kept in a file.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import F64
from embodichain.recording.episodes import LogEpisode
from embodichain.recording.observation_store import ObservationStore
from embodichain.recording.recorded_log import RecordedLog
from embodichain.recording.reenactment import Reenactment, Step
from embodichain.utils.errors import ConfigError

__all__ = ["Episode", "logs_of", "read_episodes"]

_IMAGE_NDIM = 3
"""Entries with more axes, time included, are images."""


@dataclass(frozen=True, slots=True)
class Episode:
    """An episode of T control steps, as the policy saw it.

    ``observations[name][t]`` is what the policy saw before ``actions[t]``, and
    ``observations[name][t + 1]`` what followed from it; ``[T]`` is the final observation, before
    the reset.

    Attributes:
        task: Name of the task.
        observations: Path of an entry, joined by "/" (``qpos``, ``robot/qvel``,
            ``sensor/cam/color``), to (T+1, ...) float32, or the type of images and counts.
        groups: Observation group to the names of its entries, in order (``policy``, ``critic``):
            side by side they are the vector of the group.
        actions: (T, A) float32, as given to the environment.
        rewards: (T,) float32.
        states: (T, nstate) float64 recorded full state (`mjSTATE_INTEGRATION`) before the physics
            of each step, controls included.
        terminated: As in Gymnasium.
        truncated: As in Gymnasium; both are False if the log ended first.
        success: Whether it succeeded at its end, see `LogEpisode.succeeded`; None if the log ended
            first.
        path: The log.
        env: The environment in it.
        episode: Number of the episode in its environment.
        first_step: First control step in the log.
    """

    task: str
    observations: Mapping[str, NDArray[Any]]
    groups: Mapping[str, tuple[str, ...]]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float32]
    states: F64
    terminated: bool
    truncated: bool
    success: bool | None
    path: Path
    env: int
    episode: int
    first_step: int

    def __len__(self) -> int:
        """Number of control steps T."""
        return len(self.actions)

    @property
    def dones(self) -> NDArray[np.bool_]:
        """(T,) whether the episode ended with the step."""
        dones = np.zeros(len(self), np.bool_)
        dones[-1:] = self.terminated or self.truncated
        return dones

    def group(self, name: str = "policy") -> NDArray[np.float32]:
        """(T+1, K) the vector of an observation group.

        Raises:
            ConfigError: If there is no such group, or one of its entries is an image.
        """
        if name not in self.groups:
            known = ", ".join(self.groups) or "none"
            raise ConfigError(f"{self.task}: no observation group {name!r}; there are: {known}")
        parts = [self.observations[entry] for entry in self.groups[name]]
        images = [e for e, p in zip(self.groups[name], parts, strict=True) if p.ndim > _IMAGE_NDIM]
        if images:
            raise ConfigError(f"{self.task}: {', '.join(images)}: an image is no part of a vector")
        flat = [part.reshape(len(part), -1).astype(np.float32) for part in parts]
        return np.concatenate(flat, axis=1)


def logs_of(path: str | Path) -> list[Path]:
    """The logs of a path: a log, the manifest of one in several files, or the folder of a run.

    Raises:
        ConfigError: If a folder has no log.
    """
    path = Path(path)
    if not path.is_dir():
        return [path]
    if (path / "rollout.mcap").exists():
        return [path / "rollout.mcap"]
    raise ConfigError(f"{path} has no log: a run with record=none, or another folder")


def read_episodes(
    paths: str | Path | Sequence[str | Path],
    *,
    failures: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[Episode]:
    """Yield the episodes of logs with the task's observations.

    Args:
        paths: One or several logs or folders, see `logs_of`.
        failures: Also yield episodes that did not succeed, or whose end is not in the log. Without
            it, a task that does not define success has none to yield.
        progress: Called with the numbers of episodes that were yielded, and that will be, of the
            current log.

    Raises:
        ConfigError: If a log cannot be reenacted (see `Reenactment`), has no episode to yield, or
            is of another task than the first.
        LogError: If a log has no states, or is damaged.
    """
    given = [paths] if isinstance(paths, (str, Path)) else list(paths)
    first: Episode | None = None
    for path in [log for one in given for log in logs_of(one)]:
        with RecordedLog(path) as log:
            wanted = _wanted(log, failures)
            for number, episode in enumerate(_episodes(log, wanted), start=1):
                first = first or episode
                _require_same(first, episode)
                yield episode
                if progress is not None:
                    progress(number, len(wanted))


def _wanted(log: RecordedLog, failures: bool) -> list[LogEpisode]:
    """The episodes to yield."""
    log.header.require_states(log.path)
    found = log.episodes
    wanted = [e for e in found if failures or e.succeeded]
    if not wanted:
        if any(e.succeeded is not None for e in found):
            why = f"none of its {len(found)} episodes succeeded"
        else:
            why = "no episode ended"
        raise ConfigError(f"{log.path}: {why}; --failures takes all episodes")
    return wanted


def _require_same(first: Episode, episode: Episode) -> None:
    """Refuse an episode of a task with other observations or actions."""
    shapes = [
        {n: (o.dtype.str, o.shape[1:]) for n, o in e.observations.items()}
        | {"actions": ("", e.actions.shape[1:]), "task": (e.task, ())}
        for e in (first, episode)
    ]
    if shapes[0] == shapes[1] and first.groups == episode.groups:
        return
    differ = [
        name for name in {**shapes[0], **shapes[1]} if shapes[0].get(name) != shapes[1].get(name)
    ]
    raise ConfigError(
        f"{episode.path} (task {episode.task}) does not belong together with {first.path} "
        f"(task {first.task}): other {', '.join(differ or ['groups'])}"
    )


def _episodes(log: RecordedLog, wanted: Sequence[LogEpisode]) -> Iterator[Episode]:
    """Yield the wanted episodes of one log as they end.

    Observation k + 1 of the store follows from step k of the log.
    """
    last = max(episode.last_step for episode in wanted)
    ends: dict[int, list[LogEpisode]] = {}
    for episode in wanted:
        ends.setdefault(episode.last_step, []).append(episode)
    with Reenactment(log) as play, ObservationStore() as store:
        paths = play.env.observation_manager.paths
        groups = {name: tuple("/".join(path) for path in of) for name, of in paths.items()}
        store.add(0, play.first)
        steps: deque[Step] = deque()
        begun = np.zeros(play.env.num_envs, np.int64)
        for step in play.steps(last):
            steps.append(step)
            for found in ends.get(step.number, ()):
                own = list(islice(steps, found.first_step - steps[0].number, None))
                seen = store.take(found.env, found.first_step, step.number + 1, step.seen)
                yield _made(log, found, groups, own, seen)
            store.add(step.number + 1, step.next)
            steps[-1] = step._replace(seen=play.first, next=play.first)  # they are in the store
            begun[step.terminated | step.truncated] = step.number + 1
            store.forget(int(begun.min()))
            while steps and steps[0].number < begun.min():
                steps.popleft()


def _made(
    log: RecordedLog,
    found: LogEpisode,
    groups: Mapping[str, tuple[str, ...]],
    steps: Sequence[Step],
    seen: Mapping[str, NDArray[Any]],
) -> Episode:
    return Episode(
        task=log.task,
        observations=seen,
        groups=groups,
        actions=np.array([step.action[found.env] for step in steps], np.float32),
        rewards=np.array([step.reward[found.env] for step in steps], np.float32),
        states=np.array([step.row[found.env] for step in steps]),
        terminated=found.terminated,
        truncated=found.truncated,
        success=found.succeeded,
        path=log.path,
        env=found.env,
        episode=found.episode,
        first_step=found.first_step,
    )
