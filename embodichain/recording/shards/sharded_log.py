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
from embodichain.utils.array_types import EnvIds
from embodichain.utils.errors import ConfigError

__all__ = ["ShardedLog", "inspect_shards", "verify_shards"]

_SHARED_FIELDS = (
    "task",
    "seed",
    "control_dt",
    "physics_dt",
    "model",
    "state",
    "layout",
    "keyframe_every",
)
"""Fields of the header that are equal in the logs of all shards."""


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
                log = Log(self.path.with_name(entry.log), simulate)
                self.shards.append(log)
                if log.num_envs != entry.num_envs:
                    raise LogError(f"{log.path} is not the log that {path} describes")
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
        env_ids = self._envs(env)
        parts = []
        for log, first in zip(self.shards, self.firsts, strict=True):
            in_shard = (env_ids >= first) & (env_ids < first + log.num_envs)
            local_ids = (env_ids[in_shard] - first).tolist()
            if local_ids:
                part = log.read(names, local_ids, episode, start, stop)
                parts.append(replace(part, env_ids=part.env_ids + first))
        return _join_environments(parts)

    @cached_property
    def episodes(self) -> list[LogEpisode]:
        """Every episode, complete or not, by environment."""
        episodes = []
        for log, first in zip(self.shards, self.firsts, strict=True):
            episodes += [replace(episode, env=episode.env + first) for episode in log.episodes]
        return episodes

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

    def _merged(self, records_of: Callable[[Log], Iterator[Any]]) -> Iterator[Any]:
        """Yield events or writes of all shards with the batch's numbers of environments."""

        def renumbered(log: Log, first: int) -> Iterator[Any]:
            all_envs: EnvIds = np.arange(log.num_envs)
            for record in records_of(log):
                env_ids = all_envs if record.env_ids is None else record.env_ids
                yield replace(record, env_ids=env_ids + first)

        streams = [
            renumbered(log, first) for log, first in zip(self.shards, self.firsts, strict=True)
        ]
        yield from heapq.merge(*streams, key=lambda record: record.step)

    def raw_messages(self) -> Iterator[tuple[str, int, memoryview]]:
        """Raise `ConfigError`: the messages of several logs cannot be read as one log's.

        Raises:
            ConfigError: Always; the error names the files.
        """
        names = ", ".join(log.path.name for log in self.shards)
        raise ConfigError(f"{self.path} joins logs whose messages are read one by one: {names}")


def _joined_header(logs: Sequence[Log], firsts: Sequence[int]) -> Header:
    first_header = logs[0].header
    for log in logs[1:]:
        for name in _SHARED_FIELDS:
            value = getattr(log.header, name)
            expected = getattr(first_header, name)
            if value != expected:
                difference = f"{name} is {value}, not {expected}"
                raise LogError(f"{log.path} is not of the batch of {logs[0].path}: {difference}")
    view_envs: list[int] = []
    quota: list[int] = []
    for log, first in zip(logs, firsts, strict=True):
        view_envs += [env_id + first for env_id in log.header.view_envs]
        quota += log.header.quota
    return replace(
        first_header,
        num_envs=sum(log.num_envs for log in logs),
        view_envs=view_envs,
        quota=tuple(quota),
    )


def _join_environments(parts: Sequence[LogArrays]) -> LogArrays:
    """Join arrays of different environments, for the steps that all of them have."""
    if len(parts) == 1:
        return parts[0]
    steps = parts[0].steps
    for part in parts[1:]:
        steps = np.intersect1d(steps, part.steps, assume_unique=True)
    rows = [np.searchsorted(part.steps, steps) for part in parts]
    values = {}
    for name in parts[0].values:
        pieces = [part.values[name][index] for part, index in zip(parts, rows, strict=True)]
        values[name] = np.concatenate(pieces, axis=1)
    env_ids = np.concatenate([part.env_ids for part in parts])
    return replace(parts[0], steps=steps, env_ids=env_ids, values=values)


def inspect_shards(path: Path) -> LogSummary:
    """The summary of the logs of a batch in shards.

    Args:
        path: The manifest.
    """
    entries = read_shards(path)
    summaries = [inspect(path.with_name(entry.log)) for entry in entries]
    with ShardedLog(path) as log:
        header = log.header
    num_messages: Counter[tuple[str, str, str]] = Counter()
    episodes: list[LogEpisode] = []
    compressions: set[str] = set()
    warnings: list[str] = []
    files: list[str] = []
    for entry, summary in zip(entries, summaries, strict=True):
        for channel in summary.channels:
            num_messages[channel.topic, channel.schema, channel.encoding] += channel.messages
        for episode in summary.episodes:
            episodes.append(replace(episode, env=episode.env + entry.first_env))
        compressions.update(summary.compressions)
        warnings += [f"{summary.path.name}: {line}" for line in summary.warnings]
        files += summary.files
    channels = [
        ChannelInfo(topic, schema, encoding, messages=num_messages[topic, schema, encoding])
        for topic, schema, encoding in sorted(num_messages)
    ]
    return LogSummary(
        path=path,
        nbytes=sum(summary.nbytes for summary in summaries),
        header=header,
        channels=channels,
        steps=min(summary.steps for summary in summaries),
        episodes=sorted(episodes, key=lambda episode: (episode.last_step, episode.env)),
        attachments=summaries[0].attachments,
        compressions=sorted(compressions),
        complete=all(summary.complete for summary in summaries),
        warnings=warnings,
        files=files,
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
    # All bytes of all logs first: nothing of a damaged batch is simulated.
    checked = [check_bytes(log) for log in logs]
    damaged_logs = [
        damaged(log, report) for log, report in zip(logs, checked, strict=True) if report.damage
    ]
    if damaged_logs:
        return _damage_report(path, damaged_logs)
    with ShardedLog(path) as batch:  # the logs are of one batch
        if env is None:
            shards = list(range(len(entries)))
            local_env = None
        else:
            log, local_env = batch.part_of(env)
            shards = [batch.shards.index(log)]
    reports = []
    for shard in shards:
        report = simulate(
            logs[shard],
            checked[shard],
            env=local_env,
            episode=episode,
            num_threads=num_threads,
            progress=progress,
            images=images,
        )
        reports.append(_with_batch_numbers(report, entries[shard]))
    return _join_reports(path, reports)


def _with_batch_numbers(report: VerifyReport, entry: ShardEntry) -> VerifyReport:
    """A shard's report, in which environments have the numbers of the batch."""
    difference = report.difference
    if difference is None:
        return report
    env = difference.env + entry.first_env
    return replace(report, difference=replace(difference, env=env))


def _damage_report(path: Path, reports: Sequence[VerifyReport]) -> VerifyReport:
    """The report of a batch in which logs are damaged."""
    problems = []
    damage = []
    for report in reports:
        problems += [f"{report.path.name}: {line}" for line in report.problems]
        damage += report.damage
    return VerifyReport(path, ok=False, steps=0, envs=0, problems=problems, damage=damage)


def _join_reports(path: Path, reports: Sequence[VerifyReport]) -> VerifyReport:
    """The report of a batch from those of its shards."""
    if len(reports) == 1:
        return replace(reports[0], path=path)
    problems = []
    notes = []
    largest_error: dict[str, float] = {}
    for report in reports:
        problems += [f"{report.path.name}: {line}" for line in report.problems]
        notes += [f"{report.path.name}: {line}" for line in report.notes]
        for component, error in report.largest_error.items():
            largest_error[component] = max(error, largest_error.get(component, 0.0))
    differences = [report.difference for report in reports if report.difference is not None]
    return replace(
        reports[0],
        path=path,
        ok=all(report.ok for report in reports),
        steps=min(report.steps for report in reports),
        envs=sum(report.envs for report in reports),
        difference=min(
            differences, key=lambda difference: (difference.step, difference.env), default=None
        ),
        problems=problems,
        largest_error=largest_error,
        notes=notes,
        measured=sum(report.measured for report in reports),
        outside=sum(report.outside for report in reports),
    )
