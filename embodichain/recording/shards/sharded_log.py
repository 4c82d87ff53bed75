"""`ShardedLog`: the logs of a batch in shards as one; its summary and its verification."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.restoring.snapshot import Snapshot
from embodichain.lab.sim.engine.api import EnvIndex
from embodichain.recording.check.byte_check import check_bytes
from embodichain.recording.check.verification import VerifyReport, damaged, simulate
from embodichain.recording.format.header import Header
from embodichain.recording.format.log_error import LogError
from embodichain.recording.read.api import Log
from embodichain.recording.read.arrays import LogArrays
from embodichain.recording.read.episodes import LogEpisode
from embodichain.recording.read.events import LogEvent, LogWrite
from embodichain.recording.read.summary import ChannelInfo, LogSummary, inspect
from embodichain.recording.shards.shard_logs import ShardEntry, read_shards
from embodichain.utils.errors import ConfigError

__all__ = ["ShardedLog", "inspect_shards", "verify_shards"]

_SAME = ("task", "seed", "control_dt", "physics_dt", "model", "state", "layout", "keyframe_every")
"""What the logs of shards have in common."""


class ShardedLog(Log):
    """The open logs of a batch in shards, read as one log of the whole batch.

    Environments have the numbers of the batch. If a log ends earlier than others, the steps that
    all of them have are read.

    Args:
        path: The manifest.
        simulate: See `Log`.

    Attributes:
        shards: The open log of each shard.
        firsts: First environment of each shard.

    Raises:
        ConfigError: If the manifest or a file is missing.
        LogError: If the logs are not of one batch.
    """

    def __init__(self, path: str | Path, simulate: bool = False) -> None:
        self.path = Path(path)
        entries = read_shards(self.path)
        self.firsts = [entry.first_env for entry in entries]
        self.shards: list[Log] = []
        self._simulate = simulate
        try:
            for entry in entries:
                self.shards.append(Log(self.path.with_name(entry.log), simulate))
                if self.shards[-1].num_envs != entry.num_envs:
                    raise LogError(f"{self.shards[-1].path} is not the log that {path} describes")
            self.reader = self.shards[0].reader
            self.header = _joined_header(self.shards, self.firsts)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close all files."""
        for log in self.shards:
            log.close()

    def part_of(self, env: int) -> tuple[Log, int]:
        """The log of an environment's shard, and its number in it."""
        self.header.check_env(env)
        shard = int(np.searchsorted(self.firsts, env, side="right")) - 1
        return self.shards[shard], env - self.firsts[shard]

    @property
    def complete(self) -> bool:
        """Whether the logs of all shards are complete."""
        return all(log.complete for log in self.shards)

    @property
    def warnings(self) -> list[str]:
        """What was found missing or damaged so far, with the file's name."""
        return [f"{log.path.name}: {line}" for log in self.shards for line in log.warnings]

    def read(
        self,
        fields: str | Iterable[str] | None = None,
        env: int | Sequence[int] | None = None,
        episode: int | None = None,
        start: int = 0,
        stop: int | None = None,
    ) -> LogArrays:
        """See `RecordedLog.read`."""
        names = self._fields(fields)
        ids = self._envs(env)
        parts = []
        for log, first in zip(self.shards, self.firsts, strict=True):
            mine = ids[(ids >= first) & (ids < first + log.num_envs)] - first
            if len(mine):
                found = log.read(names, mine.tolist(), episode, start, stop)
                parts.append(replace(found, env_ids=found.env_ids + first))
        return _beside(parts)

    @cached_property
    def episodes(self) -> list[LogEpisode]:
        """Every episode, complete or not, by environment."""
        pairs = zip(self.shards, self.firsts, strict=True)
        return [replace(e, env=e.env + first) for log, first in pairs for e in log.episodes]

    def metrics(self, env: int) -> tuple[NDArray[np.int64], dict[str, NDArray[np.float64]]]:
        """See `RecordedLog.metrics`."""
        log, number = self.part_of(env)
        return log.metrics(number)

    def snapshot(self, env: int, episode: int | None = None, step: int | None = None) -> Snapshot:
        """See `Log.snapshot`."""
        log, number = self.part_of(env)
        return log.snapshot(number, episode, step)

    def events(self) -> Iterator[LogEvent]:
        """Yield the events of all shards, in the order of their steps."""
        yield from self._merged(lambda log: log.events())

    def writes(self) -> Iterator[LogWrite]:
        """Yield the writes of all shards, in the order of their steps."""
        yield from self._merged(lambda log: log.writes())

    def _merged(self, of: Callable[[Log], Iterator[Any]]) -> Iterator[Any]:
        def numbered(log: Log, first: int) -> Iterator[Any]:
            every: EnvIndex = np.arange(log.num_envs)
            for one in of(log):
                ids = every if one.env_ids is None else one.env_ids
                yield replace(one, env_ids=ids + first)

        streams = [
            numbered(log, first) for log, first in zip(self.shards, self.firsts, strict=True)
        ]
        yield from heapq.merge(*streams, key=lambda one: one.step)

    def raw_messages(self) -> Iterator[tuple[str, int, memoryview]]:
        """Refuse: topics are those of a shard's log.

        Raises:
            ConfigError: Always; names the files.
        """
        names = ", ".join(log.path.name for log in self.shards)
        raise ConfigError(f"{self.path} joins logs whose messages are read one by one: {names}")


def _joined_header(logs: Sequence[Log], firsts: Sequence[int]) -> Header:
    first = logs[0].header
    for log in logs[1:]:
        for name in _SAME:
            mine = getattr(log.header, name)
            other = getattr(first, name)
            if mine != other:
                found = f"{name} is {mine}, not {other}"
                raise LogError(f"{log.path} is not of the batch of {logs[0].path}: {found}")
    viewed = [i + at for log, at in zip(logs, firsts, strict=True) for i in log.header.view_envs]
    count = sum(log.num_envs for log in logs)
    quota = tuple(number for log in logs for number in log.header.quota)
    return replace(first, num_envs=count, view_envs=viewed, quota=quota)


def _beside(parts: Sequence[LogArrays]) -> LogArrays:
    """Join arrays of different environments, for the steps that all of them have."""
    if len(parts) == 1:
        return parts[0]
    steps = parts[0].steps
    for part in parts[1:]:
        steps = np.intersect1d(steps, part.steps, assume_unique=True)
    rows = [np.searchsorted(part.steps, steps) for part in parts]
    values = {
        name: np.concatenate([p.values[name][r] for p, r in zip(parts, rows, strict=True)], axis=1)
        for name in parts[0].values
    }
    ids = np.concatenate([part.env_ids for part in parts])
    return replace(parts[0], steps=steps, env_ids=ids, values=values)


def inspect_shards(path: Path) -> LogSummary:
    """The summary of the logs of a batch in shards.

    Args:
        path: The manifest.
    """
    entries = read_shards(path)
    found = [inspect(path.with_name(entry.log)) for entry in entries]
    with ShardedLog(path) as log:
        header = log.header
    counts: Counter[tuple[str, str, str]] = Counter()
    for one in found:
        for c in one.channels:
            counts[c.topic, c.schema, c.encoding] += c.messages
    firsts = [entry.first_env for entry in entries]
    pairs = list(zip(found, firsts, strict=True))
    episodes = [replace(e, env=e.env + first) for one, first in pairs for e in one.episodes]
    return LogSummary(
        path=path,
        nbytes=sum(one.nbytes for one in found),
        header=header,
        channels=[ChannelInfo(*key, counts[key]) for key in sorted(counts)],
        steps=min(one.steps for one in found),
        episodes=sorted(episodes, key=lambda e: (e.last_step, e.env)),
        attachments=found[0].attachments,
        compressions=sorted({name for one in found for name in one.compressions}),
        complete=all(one.complete for one in found),
        warnings=[f"{one.path.name}: {line}" for one in found for line in one.warnings],
        files=[name for one in found for name in one.files],
    )


def verify_shards(
    path: Path,
    env: int | None,
    episode: int | None,
    num_threads: int,
    progress: Callable[[int], None] | None,
    images: bool,
) -> VerifyReport:
    """Verify the logs of a batch in shards, one after another; see `verify`."""
    entries = read_shards(path)
    logs = [path.with_name(entry.log) for entry in entries]
    checked = {log: check_bytes(log) for log in logs}
    broken = [damaged(log, found) for log, found in checked.items() if found.damage]
    if broken:
        problems = [f"{r.path.name}: {line}" for r in broken for line in r.problems]
        damage = [damage for report in broken for damage in report.damage]
        return VerifyReport(path, False, 0, 0, problems=problems, damage=damage)
    reports = []
    with ShardedLog(path) as log:
        if env is None:
            every = zip(log.shards, entries, strict=True)
            chosen: list[tuple[Log, ShardEntry, int | None]] = [(one, e, None) for one, e in every]
        else:
            mine, number = log.part_of(env)
            chosen = [(mine, entries[log.shards.index(mine)], number)]
    for shard, entry, only in chosen:
        how = only, episode, num_threads, progress, images
        found = simulate(shard.path, checked[path.with_name(entry.log)], *how)
        if found.difference is not None:
            at = found.difference.env + entry.first_env
            found = replace(found, difference=replace(found.difference, env=at))
        reports.append(found)
    return _one_report(path, reports)


def _one_report(path: Path, reports: Sequence[VerifyReport]) -> VerifyReport:
    def lines(name: str) -> list[str]:
        told = [f"{r.path.name}: {line}" for r in reports for line in getattr(r, name)]
        return told if len(reports) > 1 else list(getattr(reports[0], name))

    differing = [r.difference for r in reports if r.difference is not None]
    errors: dict[str, float] = {}
    for report in reports:
        for key, value in report.largest_error.items():
            errors[key] = max(value, errors.get(key, 0.0))
    return replace(
        reports[0],
        path=path,
        ok=all(report.ok for report in reports),
        steps=min(report.steps for report in reports),
        envs=sum(report.envs for report in reports),
        difference=min(differing, key=lambda d: (d.step, d.env), default=None),
        problems=lines("problems"),
        largest_error=errors,
        notes=lines("notes"),
        measured=sum(report.measured for report in reports),
        outside=sum(report.outside for report in reports),
    )
