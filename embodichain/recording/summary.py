"""`LogSummary`: what is in a log, gathered in one pass."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from mcap.records import Channel

from embodichain.recording.attachments import model_digest
from embodichain.recording.episode_log import TOPIC as EPISODE_TOPIC
from embodichain.recording.episode_log import EndedEpisode, decode_ends
from embodichain.recording.header import Header
from embodichain.recording.messages import StepOutcome
from embodichain.recording.reader import LogReader
from embodichain.recording.wire import WireError

__all__ = ["ChannelInfo", "Episode", "LogSummary", "summarize"]


@dataclass(frozen=True, slots=True)
class ChannelInfo:
    """One channel of a log."""

    topic: str
    schema: str
    encoding: str
    messages: int


@dataclass(frozen=True, slots=True)
class Episode:
    """An episode that ended within the log.

    Attributes:
        env: The environment.
        episode: Its episode id, from 0 within the environment.
        steps: Control steps within the log.
        total_reward: Sum of rewards over them, undiscounted.
        terminated: Whether it ended by itself; else by a limit.
        last_step: Control step that ended it.
        success: Whether it was one; None where the task does not say.
    """

    env: int
    episode: int
    steps: int
    total_reward: float
    terminated: bool
    last_step: int
    success: bool | None = None


@dataclass(frozen=True, slots=True)
class LogSummary:
    """What is in a log.

    Attributes:
        path: The file.
        nbytes: Its size, that of all its files.
        header: What was recorded and how.
        channels: By topic.
        steps: Control steps.
        episodes: Episodes that ended, in order of their ends.
        attachments: Name to size in bytes.
        compressions: Compressions of its chunks.
        complete: Whether the file has its end and everything that was announced.
        warnings: What is missing or damaged, one line each; empty for a complete log.
        files: Names of the files it lies in.
    """

    path: Path
    nbytes: int
    header: Header
    channels: list[ChannelInfo]
    steps: int
    episodes: list[Episode]
    attachments: dict[str, int]
    compressions: list[str]
    complete: bool
    warnings: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)

    @property
    def messages(self) -> int:
        """Messages in all channels."""
        return sum(channel.messages for channel in self.channels)

    @property
    def duration_s(self) -> float:
        """Simulated seconds."""
        return self.steps * self.header.control_dt

    @property
    def mean_reward(self) -> float | None:
        """Mean over ended episodes of their summed reward; None without one."""
        if not self.episodes:
            return None
        return float(np.mean([episode.total_reward for episode in self.episodes]))


class _Episodes:
    """Adds up rewards until episodes end."""

    def __init__(self, num_envs: int) -> None:
        self._sums = np.zeros(num_envs)
        self._lengths = np.zeros(num_envs, np.int64)
        self.ended: list[Episode] = []

    def add(self, step: StepOutcome) -> None:
        if len(step.reward) != len(self._sums):
            raise WireError(f"step {step.step} is of {len(step.reward)} environments")
        self._sums += step.reward
        self._lengths += 1
        for env in np.flatnonzero(step.terminated | step.truncated).tolist():
            self.ended.append(
                Episode(
                    env,
                    int(step.episode_ids[env]),
                    int(self._lengths[env]),
                    float(self._sums[env]),
                    bool(step.terminated[env]),
                    step.step,
                )
            )
            self._sums[env] = self._lengths[env] = 0


def summarize(path: str | Path) -> LogSummary:
    """Read a log once and return what is in it; a broken one up to where it is readable.

    Raises:
        ConfigError: If the file is missing, empty or not MCAP.
        LogError: If it is not a log of embodichain's.
    """
    counts: Counter[str] = Counter()
    steps, last_step = 0, -1
    episodes: _Episodes | None = None
    ended: list[EndedEpisode] = []
    with LogReader(Path(path)) as reader:
        for topic, message in reader.messages():
            counts[topic] += 1
            if topic == "/sim/step":
                if episodes is None:
                    episodes = _Episodes(reader.require_header().num_envs)
                try:
                    outcome = StepOutcome.decode(message.data)
                    episodes.add(outcome)
                except WireError as error:
                    reader.complete, reader.damage = False, f"a step is damaged ({error})"
                    break
                steps, last_step = steps + 1, outcome.step
            elif topic == EPISODE_TOPIC:
                try:
                    ended += decode_ends(message.data)
                except WireError as error:
                    reader.complete, reader.damage = False, f"an episode is damaged ({error})"
                    break
            elif topic == "/sim/state" and not reader.header:
                reader.require_header()
        header = reader.require_header()
        channels = [
            ChannelInfo(
                channel.topic,
                _schema_name(reader, channel),
                channel.message_encoding,
                counts[channel.topic],
            )
            for channel in sorted(reader.channels.values(), key=lambda c: c.topic)
        ]
        return LogSummary(
            path=reader.path,
            nbytes=reader.total_bytes,
            header=header,
            channels=channels,
            steps=steps,
            episodes=_joined(header, episodes.ended if episodes else [], ended),
            attachments={name: len(data) for name, data in reader.attachments.items()},
            compressions=sorted(reader.compressions),
            complete=reader.complete and reader.finished,
            warnings=_warnings(reader, last_step),
            files=[file.name for file in reader.files],
        )


def _joined(header: Header, found: list[Episode], ended: list[EndedEpisode]) -> list[Episode]:
    """Episodes of a log's steps, or of `/episode` where steps are left out on purpose."""
    if header.state == "none" or header.every > 1:
        return [
            Episode(e.env, e.episode, e.steps, e.total_reward, e.terminated, e.step, e.success)
            for e in ended
        ]
    success = {(e.env, e.step): e.success for e in ended}
    return [replace(e, success=success.get((e.env, e.last_step))) for e in found]


def _schema_name(reader: LogReader, channel: Channel) -> str:
    schema = reader.schemas.get(channel.schema_id)
    return schema.name if schema is not None else ""


def _warnings(reader: LogReader, last_step: int) -> list[str]:
    warnings = []
    if reader.recovered and reader.complete:
        where = f"after step {last_step}" if last_step >= 0 else "before its first step is complete"
        warnings.append(f"recovered from a broken file; it ends {where}: {reader.recovered}")
    elif not reader.complete:
        why = reader.damage or "its end is missing"
        missing = f"what followed step {last_step} is missing"
        warnings.append(f"incomplete: {why}; {missing if last_step >= 0 else 'no step is in it'}")
    elif not reader.finished:
        warnings.append("the recorder did not close this log: its last steps may be missing")
    if reader.part_note:
        warnings.append(reader.part_note)
    mjb = reader.attachments.get("model.mjb", b"")
    if model_digest(mjb) != reader.require_header().model:
        warnings.append("the attachment model.mjb is not the model that was recorded")
    return warnings
