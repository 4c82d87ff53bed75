"""`LogWriter`: writes the content of a log: header, starts, runs, ends of episodes, parts."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.format.attachments import Attachment
from embodichain.recording.format.container.unpacking import listed
from embodichain.recording.format.header import METADATA, METADATA_END, Header
from embodichain.recording.format.messages.block import (
    ArrayKind,
    CallKind,
    Recorded,
    joined_places,
    pack_steps,
)
from embodichain.recording.format.messages.episodes import (
    COUNTED_TOPIC,
    EPISODE_TOPIC,
    Ends,
    EpisodeSums,
    encode_counted,
    encode_ends,
)
from embodichain.recording.format.messages.schema import START_TOPIC, STEPS_TOPIC
from embodichain.recording.format.parts import LogPlace, Manifest, part_name
from embodichain.recording.format.seals import sealed
from embodichain.recording.write.log_file import LogFile
from embodichain.recording.write.step_buffer import RecordedStep

__all__ = ["LAYOUT_FILE", "LogWriter", "Queue"]

LAYOUT_FILE = "foxglove_layout.json"


class _Channel(NamedTuple):
    """A channel to be declared: the arguments of `LogFile.channel`."""

    topic: str
    schema: str
    data: bytes | None


class _Sample(NamedTuple):
    """Messages of one time, each with its topic; they are encoded during iteration."""

    time_ns: int
    messages: Iterable[tuple[str, bytes]]


class Queue:
    """Messages for viewers that are written together with the next steps.

    It is the sink of `views.Views`.
    """

    def __init__(self) -> None:
        self._samples: deque[_Sample] = deque()
        self._channels: deque[_Channel] = deque()

    def channel(self, topic: str, schema: str, data: bytes | None = None) -> None:
        """Declare a channel: see `LogFile.channel`."""
        self._channels.append(_Channel(topic, schema, data))

    def send(self, time_ns: int, messages: Iterable[tuple[str, bytes]]) -> None:
        """Queue messages of one time, each with its topic."""
        self._samples.append(_Sample(time_ns, messages))

    def write(self, file: LogFile) -> None:
        """Write all queued messages; others may be queued by another thread meanwhile."""
        while True:
            sample = None
            if self._samples:
                sample = self._samples.popleft()
            # The channels are taken after the sample: its channels were declared before it was
            # queued, so none of them is missing.
            while self._channels:
                channel = self._channels.popleft()
                file.channel(channel.topic, channel.schema, channel.data)
            if sample is None:
                return
            for topic, data in sample.messages:
                file.write(topic, sample.time_ns, data)


class LogWriter:
    """A log in progress. Building it creates the file.

    Args:
        path: A new file.
        compression: As in `RecordOptions`.
        header: Metadata of the first file.
        attachments: Attachments of every file.
        layout: The viewers' layout, for a file next to the log.
        place: Where to continue a log; None begins it.
    """

    def __init__(
        self,
        path: Path,
        compression: str,
        header: Header,
        attachments: Sequence[Attachment],
        layout: Mapping[str, Any],
        place: LogPlace | None = None,
    ) -> None:
        part, step = (0, 0) if place is None else (place.part, place.step)
        self.file = LogFile(path, compression, part)
        self.views = Queue()
        if place is not None:
            header = replace(header, log_id=place.log_id)
        header = replace(header, attachments=listed(attachments))
        self._header = header
        self._attachments = attachments
        self._sums = EpisodeSums(header.num_envs)
        self._manifest = Manifest(
            self.file.folder, path.name, header.log_id, header.period_ns * 1e-9
        )
        if place is not None:
            self._sums.load(place.episodes, place.returns, place.lengths)
            self._manifest.files = [replace(file) for file in place.files]
            self._manifest.begun(part_name(path.name, part), step)
        self._head_bytes = 0
        self._write_head(part, step)
        if header.state != "none":
            self.file.channel(STEPS_TOPIC, "embodichain.Steps")
            self.file.channel(START_TOPIC, "embodichain.Steps")
        self.file.channel(EPISODE_TOPIC, "embodichain.Episodes")
        if header.lists_counted:
            self.file.channel(COUNTED_TOPIC, "embodichain.Counted")
        self.file.write_beside(LAYOUT_FILE, json.dumps(layout, indent=1))

    def _write_head(self, part: int, first_step: int) -> None:
        for name, media_type, data in self._attachments:
            self.file.attach(name, media_type, data, self._header.start_ns)
        header = replace(self._header, part=part, first_step=first_step)
        self.file.metadata(METADATA, header.to_metadata())

    def _time_of(self, step: int) -> int:
        return self._header.start_ns + step * self._header.period_ns

    def start(self, step: int, row: NDArray[Any], fields: Mapping[str, NDArray[Any]]) -> int:
        """Write the state of the simulation before a control step; return the message's size.

        Args:
            step: The control step.
            row: (N, nstate) rows.
            fields: Name to (N, ...) values of randomized model fields.
        """
        arrays = {"row": np.array(row, np.float64, order="C")}
        for name, values in fields.items():
            flat = np.asarray(values).reshape(len(row), -1)
            arrays[name] = np.ascontiguousarray(flat, np.float64)
        kinds = tuple(ArrayKind(name, "<f8", array.shape) for name, array in arrays.items())
        call = (CallKind("start", arrays=kinds), tuple(arrays.values()))
        data = pack_steps(step, [[call]])
        return self.file.write(START_TOPIC, self._time_of(step), data)

    def count(self, step: int, env_ids: Sequence[int], episodes: Sequence[int]) -> None:
        """After a control step: list episodes that count; their ends were written before."""
        self.file.write(COUNTED_TOPIC, self._time_of(step), encode_counted(env_ids, episodes))

    def add_rewards(
        self,
        step: int,
        rewards: NDArray[Any],
        episode_ids: NDArray[np.int64],
        ends: Ends | None,
    ) -> None:
        """Add control steps, recorded or not, to their episodes, and write those that end.

        Args:
            step: The last of S control steps.
            rewards: (S, N) rewards.
            episode_ids: (N,) episodes of all of them.
            ends: The episodes that end in the last one.
        """
        self._sums.add_steps(rewards, episode_ids)
        if ends is not None:
            data = encode_ends(step, ends, self._sums, episode_ids)
            self.file.write(EPISODE_TOPIC, self._time_of(step), data)

    def write(self, steps: Sequence[RecordedStep]) -> int:
        """Write control steps, the ends of their episodes, and the viewers' messages.

        Args:
            steps: Consecutive finished steps.

        Returns:
            Size of their message.
        """
        size = 0
        if steps and self._header.state != "none":
            first = steps[0].number
            data = pack_steps(first, [step.calls for step in steps])
            size = self.file.write(STEPS_TOPIC, self._time_of(first), data, steps[-1].number)
        self._add_rewards_of(steps)
        self.views.write(self.file)
        return size

    def _add_rewards_of(self, steps: Sequence[RecordedStep]) -> None:
        """Add steps to their episodes: together, up to one in which some of them end."""
        if not steps:
            return
        kind, _ = steps[0].calls[-1]
        _, reward_place, _, _, ids_place = joined_places(kind.arrays)
        joined: list[Any] = [step.calls[-1][1] for step in steps]
        reward_bytes = b"".join([data[reward_place] for data in joined])
        ids_bytes = b"".join([data[ids_place] for data in joined])
        rewards = np.frombuffer(reward_bytes, np.float32).reshape(len(steps), -1)
        episode_ids = np.frombuffer(ids_bytes, np.int64).reshape(len(steps), -1)
        has_other_episodes = (episode_ids[1:] != episode_ids[:-1]).any(axis=1).tolist()
        first = 0
        for index, step in enumerate(steps):
            is_last = index + 1 == len(steps) or has_other_episodes[index]
            if is_last or step.ends is not None:
                end = index + 1
                self.add_rewards(step.number, rewards[first:end], episode_ids[index], step.ends)
                first = end

    def write_unfinished(self, number: int, calls: Sequence[Recorded]) -> None:
        """Write the calls after the last control step, and the viewers' messages.

        Args:
            number: Number of the step that they would have begun.
            calls: The calls.
        """
        if self._header.state != "none":
            self.file.write(STEPS_TOPIC, self._time_of(number), pack_steps(number, [calls]))
        self.views.write(self.file)

    def flush(self) -> None:
        """Write everything to the file, so that it can be read.

        Raises:
            OSError: If it cannot be written, or was removed.
        """
        self.views.write(self.file)
        self.file.flush()

    def began(self) -> None:
        """Flush the header and the start of this file, so that they can be read."""
        self.flush()
        self._head_bytes = self.file.size

    def is_full(self, max_bytes: float) -> bool:
        """Whether the current file has reached this size, and twice the size of its header."""
        return self.file.size > max(max_bytes, 2 * self._head_bytes)

    def roll(self, step: int) -> None:
        """Continue in a new file from this control step; the caller writes a start next."""
        part = self.file.part + 1
        name = part_name(self.file.name, part)
        self.views.write(self.file)
        end = sealed(METADATA_END, {"steps": str(step), "next": name})
        self._manifest.closed(
            step, self.file.roll(name, lambda: self.file.metadata(METADATA_END, end))
        )
        self._write_head(part, step)
        self._manifest.begun(name, step)
        self._manifest.write(complete=False)

    def place(self, step: int) -> LogPlace:
        """Where the current file began, for a recorder that continues there; after `roll`."""
        return LogPlace(
            log_id=self._header.log_id,
            part=self.file.part,
            step=step,
            start_ns=self._header.start_ns,
            files=tuple(replace(file) for file in self._manifest.files[:-1]),
            episodes=self._sums.episodes.copy(),
            returns=self._sums.returns.copy(),
            lengths=self._sums.lengths.copy(),
        )

    def finish(self, steps: int) -> None:
        """Write the end of a log with this number of control steps, and close the file.

        Raises:
            OSError: If it could not be written.
        """
        self.views.write(self.file)
        self.file.metadata(METADATA_END, sealed(METADATA_END, {"steps": str(steps)}))
        size = self.file.finish()
        if self.file.part:
            self._manifest.closed(steps, size)
            self._manifest.write(complete=True)
        self.file.close()
