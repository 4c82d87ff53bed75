"""`inspect`: a summary of a log, gathered in one pass over it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from embodichain.recording.format.attachments import MODEL, model_digest, unpack_model
from embodichain.recording.format.header import Header
from embodichain.recording.format.log_error import DamageError, LogError
from embodichain.recording.format.messages.block import unpack_steps
from embodichain.recording.format.messages.episodes import COUNTED_TOPIC, EPISODE_TOPIC
from embodichain.recording.format.messages.schema import STEPS_TOPIC
from embodichain.recording.read.chunks import LogReader
from embodichain.recording.read.counted import Counting
from embodichain.recording.read.episodes import LogEpisode, decode_ends
from embodichain.recording.read.trajectory import outcomes

__all__ = ["ChannelInfo", "LogSummary", "inspect"]


@dataclass(frozen=True, slots=True)
class ChannelInfo:
    """One channel of a log."""

    topic: str
    schema: str
    encoding: str
    messages: int


@dataclass(frozen=True, slots=True)
class LogSummary:
    """Summary of a log.

    Attributes:
        path: The file.
        nbytes: Size of all its files.
        header: Metadata of the recording.
        channels: Topic to channel.
        steps: Number of control steps.
        episodes: Episodes that ended, in order of their ends.
        attachments: Name -> size in bytes.
        compressions: Compressions of its chunks.
        complete: Whether the file has its end, and the number of messages that it announces.
        warnings: What is missing or damaged, one line each; empty for a complete log.
        files: Names of the files that contain it.
    """

    path: Path
    nbytes: int
    header: Header
    channels: list[ChannelInfo]
    steps: int
    episodes: list[LogEpisode]
    attachments: dict[str, int]
    compressions: list[str]
    complete: bool
    warnings: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)

    @property
    def messages(self) -> int:
        """Number of messages in all channels."""
        return sum(channel.messages for channel in self.channels)

    @property
    def duration_s(self) -> float:
        """Simulated time in seconds."""
        return self.steps * self.header.control_dt

    @property
    def counted(self) -> int | None:
        """Number of episodes that count; None if the log does not say."""
        if not (self.header.quota or self.header.lists_counted):
            return None
        return sum(bool(episode.counted) for episode in self.episodes)

    @property
    def mean_reward(self) -> float | None:
        """Mean return of the episodes that ended; None if there is none."""
        if not self.episodes:
            return None
        return float(np.mean([episode.total_reward for episode in self.episodes]))


def inspect(path: str | Path) -> LogSummary:
    """Read a log once and return its summary; a broken log is read up to the first damage.

    Raises:
        ConfigError: If the file is missing, empty or not MCAP.
        LogError: If it is not an embodichain log.
    """
    num_messages: Counter[str] = Counter()  # by topic
    steps = 0
    last_step = -1
    episodes: list[LogEpisode] = []
    with LogReader(path) as reader:
        header = reader.require_header()
        counting = Counting(header)
        try:
            for topic, _, data in reader.messages():
                num_messages[topic] += 1
                if topic == STEPS_TOPIC:
                    message_runs = unpack_steps(
                        data,
                        num_envs=header.num_envs,
                        moved=header.moved_width,
                        nstate=header.nstate,
                        is_read=outcomes,
                    )
                    for run in message_runs:
                        if run.steps:
                            steps += run.steps
                            last_step = run.first + run.count - 1
                elif topic == EPISODE_TOPIC:
                    episodes += decode_ends(data)
                elif topic == COUNTED_TOPIC:
                    counting.add(data)
        except DamageError as error:
            reader.complete = False
            reader.damage = f"a message is damaged: {error}"
        # A log that ends early may list an episode although its last steps are missing.
        if not reader.complete and header.state != "none" and header.every == 1:
            episodes = [episode for episode in episodes if episode.last_step <= last_step]
        attachments, warnings = _attachments(reader)
        channels = []
        for channel in sorted(reader.channels.values(), key=lambda channel: channel.topic):
            schema = reader.schemas.get(channel.schema_id)
            channels.append(
                ChannelInfo(
                    topic=channel.topic,
                    schema="" if schema is None else schema.name,
                    encoding=channel.message_encoding,
                    messages=num_messages[channel.topic],
                )
            )
        return LogSummary(
            path=reader.path,
            nbytes=reader.total_bytes,
            header=header,
            channels=channels,
            steps=steps,
            episodes=counting.marked(episodes),
            attachments=attachments,
            compressions=sorted(reader.compressions),
            complete=reader.complete and reader.finished,
            warnings=[*_end(reader, last_step), *warnings],
            files=[file.name for file in reader.files],
        )


def _attachments(reader: LogReader) -> tuple[dict[str, int], list[str]]:
    """Sizes of the attachments, and warnings about damaged ones."""
    sizes = {}
    warnings = []
    model = b""
    for name in reader.attachments:
        try:
            data = reader.attachment(name)
        except LogError as error:
            reader.complete = False
            warnings.append(str(error).removeprefix(f"{reader.path}: "))
            continue
        sizes[name] = len(data)
        if name == MODEL:
            model = data
    try:
        header = reader.require_header()
        is_recorded_model = model_digest(unpack_model(model, header)) == header.model
    except LogError:
        is_recorded_model = False
    if not is_recorded_model:
        warnings.append(f"the attachment {MODEL} is not the model that was recorded")
    return sizes, warnings


def _end(reader: LogReader, last_step: int) -> list[str]:
    """Warnings about where a log ends, if it is incomplete."""
    warnings = []
    if not reader.complete:
        if last_step >= 0:
            missing = f"what followed step {last_step} is missing"
        else:
            missing = "no step is in it"
        warnings.append(f"incomplete: {reader.cut}; {missing}")
    elif reader.recovered:
        where = f"after step {last_step}" if last_step >= 0 else "before its first step is complete"
        warnings.append(f"recovered from a broken file; it ends {where}: {reader.recovered}")
    elif not reader.finished:
        warnings.append("the recorder did not close this log: its last steps may be missing")
    if reader.part_note:
        warnings.append(reader.part_note)
    return warnings
