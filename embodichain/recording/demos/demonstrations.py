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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.config.run_folder import LOG, SHARDS
from embodichain.lab.sim.engine.api import F64
from embodichain.recording.demos.collection import CollectedEpisode, is_collection, read_collection
from embodichain.recording.demos.observation_store import ObservationStore
from embodichain.recording.demos.reenactment import Reenactment, Step
from embodichain.recording.format.log_error import LogError
from embodichain.recording.format.parts import first_file
from embodichain.recording.read.episodes import LogEpisode
from embodichain.recording.read.recorded_log import RecordedLog
from embodichain.recording.shards.shard_logs import SHARDS_SUFFIX, read_shards
from embodichain.utils.errors import ConfigError

__all__ = ["Episode", "Source", "read_episodes", "sources_of"]

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
        success: Whether it succeeded at its end, see `LogEpisode.success`; None if the log ended
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

    def entries(self, group: str = "policy") -> dict[str, NDArray[Any]]:
        """(T+1, ...) entries of an observation group by name, in order.

        Raises:
            ConfigError: If there is no such group.
        """
        if group not in self.groups:
            known = ", ".join(self.groups) or "none"
            raise ConfigError(f"{self.task}: no observation group {group!r}; there are: {known}")
        return {name: self.observations[name] for name in self.groups[group]}

    def group(self, name: str = "policy") -> NDArray[np.float32]:
        """(T+1, K) the vector of an observation group.

        Raises:
            ConfigError: If there is no such group, or one of its entries is an image.
        """
        parts = self.entries(name)
        images = [entry for entry, values in parts.items() if values.ndim > _IMAGE_NDIM]
        if images:
            raise ConfigError(f"{self.task}: {', '.join(images)}: an image is no part of a vector")
        flat = [part.reshape(len(part), -1).astype(np.float32) for part in parts.values()]
        return np.concatenate(flat, axis=1)


class Source(NamedTuple):
    """A log, and what a collection says of it.

    Attributes:
        path: The log.
        listed: Its episodes in the collection that it belongs to; None if it belongs to none.
    """

    path: Path
    listed: list[CollectedEpisode] | None

    @property
    def numbers(self) -> dict[tuple[int, int], int] | None:
        """(environment, episode) to the number of its attempt, see `Reenactment`."""
        if self.listed is None:
            return None
        return {(one.env, one.episode): one.attempt for one in self.listed}


def sources_of(path: str | Path, failures: bool = False) -> list[Source]:
    """The logs of a path: a log, the manifest of one in several files, or a folder.

    The folder of a collection has the logs with the episodes that it lists.

    Args:
        path: The path.
        failures: Whether logs of a collection count in which no episode succeeded.

    Raises:
        ConfigError: If there is no such file, a folder has no log, or a list is damaged.
    """
    path = Path(path)
    if not path.exists():
        raise ConfigError(f"{path} does not exist")
    folder = path if path.is_dir() else path.parent
    if not is_collection(folder):
        if (manifest := path if path.name.endswith(SHARDS_SUFFIX) else path / SHARDS).exists():
            logs = [manifest.with_name(entry.log) for entry in read_shards(manifest)]
            return [Source(log, None) for log in logs]
        if path.is_dir() and not (path / LOG).exists():
            raise ConfigError(f"{path} has no {LOG}: a run with record=none, or another folder")
        return [Source(path / LOG if path.is_dir() else path, None)]
    listed: dict[str, list[CollectedEpisode]] = {}
    for one in read_collection(folder, failures=True):
        listed.setdefault(one.log, []).append(one)
    if not path.is_dir():
        return [Source(path, listed.get(first_file(path).name, []))]
    if not listed:
        raise ConfigError(f"{path}: the collection has no episode yet")
    # A log that has only failures is left out, unless there is no other.
    good = {name for name, of in listed.items() if any(one.success for one in of)} or set(listed)
    return [Source(folder / name, of) for name, of in listed.items() if failures or name in good]


def read_episodes(
    paths: str | Path | Sequence[str | Path],
    *,
    failures: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[Episode]:
    """Yield the episodes of logs with the task's observations.

    Args:
        paths: One or several logs or folders, see `sources_of`.
        failures: Also yield episodes that did not succeed; of a log that belongs to no collection,
            also those whose end is not in it. Without it, a task that does not define success has
            none to yield.
        progress: Called with the numbers of episodes that were yielded, and that will be, of the
            current log.

    Raises:
        ConfigError: If a log cannot be reenacted (see `Reenactment`), has no episode to yield, or
            is of another task than the first.
        LogError: If a log has no states, or is damaged.
    """
    given = [paths] if isinstance(paths, (str, Path)) else list(paths)
    first: Episode | None = None
    for source in [source for one in given for source in sources_of(one, failures)]:
        with RecordedLog(source.path) as log:
            wanted = _wanted(log, source, failures)
            for number, episode in enumerate(_episodes(log, wanted, source.numbers), start=1):
                first = first or episode
                _require_same(first, episode)
                yield episode
                if progress is not None:
                    progress(number, len(wanted))


def _wanted(log: RecordedLog, source: Source, failures: bool) -> list[LogEpisode]:
    """The episodes to yield; with the success that a collection lists."""
    log.header.require_states(log.path)
    found = log.episodes
    if source.listed is not None:
        known = {(episode.env, episode.episode): episode for episode in found}
        lacking = [one for one in source.listed if (one.env, one.episode) not in known]
        if lacking:
            one = lacking[0]
            raise LogError(
                f"{log.path} lacks episode {one.episode} of environment {one.env}, which the "
                "collection lists"
            )
        found = [known[one.env, one.episode] for one in source.listed]
    wanted = [e for e in found if failures or e.success]
    if not wanted:
        if any(e.success is not None for e in found):
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


def _episodes(
    log: RecordedLog, wanted: Sequence[LogEpisode], numbers: Mapping[tuple[int, int], int] | None
) -> Iterator[Episode]:
    """Yield the wanted episodes of one log as they end.

    Observation k + 1 of the store follows from step k of the log.
    """
    last = max(episode.last_step for episode in wanted)
    ends: dict[int, list[LogEpisode]] = {}
    for episode in wanted:
        ends.setdefault(episode.last_step, []).append(episode)
    with Reenactment(log, numbers) as play, ObservationStore() as store:
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
        success=found.success,
        path=log.path,
        env=found.env,
        episode=found.episode,
        first_step=found.first_step,
    )
