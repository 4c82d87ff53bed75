"""`read_episodes`: the episodes of logs, with the observations that the policy received.

Observations are computed again by a `Reenactment`. Episodes come in the order in which they ended,
one at a time: memory holds one episode of each environment, and images are kept in a file.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
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
        drawn: What was drawn when it began, see `LogEpisode.drawn`.
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
    drawn: Mapping[str, list[float]] = field(default_factory=dict)

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
            available = ", ".join(self.groups) or "none"
            raise ConfigError(
                f"{self.task}: no observation group {group!r}; there are: {available}"
            )
        return {name: self.observations[name] for name in self.groups[group]}

    def group(self, name: str = "policy") -> NDArray[np.float32]:
        """(T+1, K) the vector of an observation group.

        Raises:
            ConfigError: If there is no such group, or one of its entries is an image.
        """
        entries = self.entries(name)
        images = [entry for entry, values in entries.items() if values.ndim > _IMAGE_NDIM]
        if images:
            raise ConfigError(
                f"{self.task}: {', '.join(images)}: an image cannot be part of a vector"
            )
        columns = [values.reshape(len(values), -1) for values in entries.values()]
        return np.concatenate([values.astype(np.float32) for values in columns], axis=1)


class Source(NamedTuple):
    """A log, and its episodes in the lists of its collection.

    Attributes:
        path: The log.
        listed: Episodes of the log that its collection lists; None if it is not in a collection.
    """

    path: Path
    listed: list[CollectedEpisode] | None

    @property
    def numbers(self) -> dict[tuple[int, int], int] | None:
        """(environment, episode) to the number of its attempt, see `Reenactment`."""
        if self.listed is None:
            return None
        return {(episode.env, episode.episode): episode.attempt for episode in self.listed}


def sources_of(path: str | Path, failures: bool = False) -> list[Source]:
    """The logs of a path: a log, the manifest of one in several files, or a folder.

    The folder of a collection has the logs with the episodes that it lists.

    Args:
        path: The path.
        failures: Whether to include logs of a collection in which no episode succeeded.

    Raises:
        ConfigError: If there is no such file, a folder has no log, or a list is damaged.
    """
    path = Path(path)
    if not path.exists():
        raise ConfigError(f"{path} does not exist")
    folder = path if path.is_dir() else path.parent
    if is_collection(folder):
        return _sources_in_collection(path, folder, failures)
    manifest = path if path.name.endswith(SHARDS_SUFFIX) else path / SHARDS
    if manifest.exists():
        return [Source(manifest.with_name(shard.log), None) for shard in read_shards(manifest)]
    if not path.is_dir():
        return [Source(path, None)]
    if not (path / LOG).exists():
        raise ConfigError(f"{path} has no {LOG}: a run with record=none, or another folder")
    return [Source(path / LOG, None)]


def _sources_in_collection(path: Path, folder: Path, failures: bool) -> list[Source]:
    """The logs of a collection; if `path` is one of them, only this one."""
    listed: dict[str, list[CollectedEpisode]] = {}
    for episode in read_collection(folder, failures=True):
        listed.setdefault(episode.log, []).append(episode)
    if not path.is_dir():
        return [Source(path, listed.get(first_file(path).name, []))]
    if not listed:
        raise ConfigError(f"{path}: the collection has no episode yet")
    sources = [Source(folder / name, episodes) for name, episodes in listed.items()]
    if failures:
        return sources
    with_success = [s for s in sources if any(episode.success for episode in s.listed or ())]
    # If no log has a success, reading the first one says so.
    return with_success or sources


def read_episodes(
    paths: str | Path | Sequence[str | Path],
    *,
    failures: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[Episode]:
    """Yield the episodes of logs with the task's observations.

    Args:
        paths: One or several logs or folders, see `sources_of`.
        failures: Also yield episodes that did not succeed, and those whose end is missing in a log
            outside of a collection. Without it, a task that does not define success has no episode
            to yield.
        progress: Called with the numbers of episodes that were yielded, and that will be, of the
            current log.

    Raises:
        ConfigError: If a log cannot be reenacted (see `Reenactment`), has no episode to yield, or
            is of another task than the first.
        LogError: If a log has no states, or is damaged.
    """
    if isinstance(paths, (str, Path)):
        paths = [paths]
    sources: list[Source] = []
    for path in paths:
        sources += sources_of(path, failures)
    first: Episode | None = None
    for source in sources:
        with RecordedLog(source.path) as log:
            selected = _select_episodes(log, source, failures)
            for number, episode in enumerate(_read(log, selected, source.numbers), start=1):
                if first is None:
                    first = episode
                _check_same_task(first, episode)
                yield episode
                if progress is not None:
                    progress(number, len(selected))


def _select_episodes(log: RecordedLog, source: Source, failures: bool) -> list[LogEpisode]:
    """The episodes to yield; in a collection, those that it lists."""
    log.header.require_states(log.path)
    episodes = log.episodes
    if source.listed is not None:
        by_id = {(episode.env, episode.episode): episode for episode in episodes}
        for listed in source.listed:
            if (listed.env, listed.episode) not in by_id:
                raise LogError(
                    f"{log.path} lacks episode {listed.episode} of environment {listed.env}, "
                    "which the collection lists"
                )
        episodes = [by_id[listed.env, listed.episode] for listed in source.listed]
    selected = [episode for episode in episodes if failures or episode.success]
    if not selected:
        reason = "no episode ended"
        if any(episode.success is not None for episode in episodes):
            reason = f"none of its {len(episodes)} episodes succeeded"
        raise ConfigError(f"{log.path}: {reason}; --failures takes all episodes")
    return selected


def _check_same_task(first: Episode, episode: Episode) -> None:
    """Raise if an episode is of a task with other observations or actions."""
    expected = _types_of(first)
    types = _types_of(episode)
    if expected == types and first.groups == episode.groups:
        return
    names = dict.fromkeys([*expected, *types])
    differences = [name for name in names if expected.get(name) != types.get(name)]
    raise ConfigError(
        f"{episode.path} (task {episode.task}) does not belong together with {first.path} "
        f"(task {first.task}): other {', '.join(differences or ['groups'])}"
    )


def _types_of(episode: Episode) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Type and shape of each observation and of the actions in a step, and the task's name."""
    types = {
        name: (values.dtype.str, values.shape[1:]) for name, values in episode.observations.items()
    }
    types["actions"] = ("", episode.actions.shape[1:])
    types["task"] = (episode.task, ())
    return types


def _read(
    log: RecordedLog, selected: Sequence[LogEpisode], numbers: Mapping[tuple[int, int], int] | None
) -> Iterator[Episode]:
    """Yield the selected episodes of one log as they end.

    Observation k + 1 of the store follows from step k of the log.
    """
    last_step = max(episode.last_step for episode in selected)
    ending: dict[int, list[LogEpisode]] = {}  # last step to the episodes that end with it
    for episode in selected:
        ending.setdefault(episode.last_step, []).append(episode)
    with Reenactment(log, numbers) as play, ObservationStore() as store:
        paths = play.env.observation_manager.paths
        groups = {
            name: tuple("/".join(path) for path in entries) for name, entries in paths.items()
        }
        store.add(0, play.first)
        steps: deque[Step] = deque()
        first_steps = np.zeros(play.env.num_envs, np.int64)  # of the running episodes
        for step in play.steps(last_step):
            steps.append(step)
            for episode in ending.get(step.number, ()):
                skipped = episode.first_step - steps[0].number
                yield _make_episode(
                    log,
                    episode,
                    groups=groups,
                    steps=list(islice(steps, skipped, None)),
                    observations=store.take(
                        episode.env, episode.first_step, step.number + 1, final=step.seen
                    ),
                )
            store.add(step.number + 1, step.next)
            # The store has the observations: images must not be kept twice.
            steps[-1] = step._replace(seen=play.first, next=play.first)
            first_steps[step.terminated | step.truncated] = step.number + 1
            oldest = int(first_steps.min())
            store.forget(oldest)
            while steps and steps[0].number < oldest:
                steps.popleft()


def _make_episode(
    log: RecordedLog,
    episode: LogEpisode,
    groups: Mapping[str, tuple[str, ...]],
    steps: Sequence[Step],
    observations: Mapping[str, NDArray[Any]],
) -> Episode:
    env = episode.env
    return Episode(
        task=log.task,
        observations=observations,
        groups=groups,
        actions=np.array([step.action[env] for step in steps], np.float32),
        rewards=np.array([step.reward[env] for step in steps], np.float32),
        states=np.array([step.row[env] for step in steps]),
        terminated=episode.terminated,
        truncated=episode.truncated,
        success=episode.success,
        path=log.path,
        env=env,
        episode=episode.episode,
        first_step=episode.first_step,
        drawn=episode.drawn,
    )
