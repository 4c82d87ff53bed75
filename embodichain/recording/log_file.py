"""`LogFile`: the MCAP file of a log, which may go on in another file; channels are known by topic.

What messages mean is known elsewhere.
"""

from __future__ import annotations

import errno
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from io import FileIO

from embodichain.recording.handover import Counters
from embodichain.recording.mcap_file import McapFile, Part, Piece
from embodichain.recording.schemas import descriptor_set

__all__ = ["LogFile"]

_LIBRARY = "embodichain"


class LogFile:
    """A log's file in progress.

    Args:
        file: Descriptor of a new file; it is closed in the end.
        folder: Of the file's folder: later files go there, whoever renames it meanwhile.
        name: The file's name.
        compression: One of `mcap_file.COMPRESSORS`.
        counters: Told how large it is; None tells nobody.
    """

    def __init__(
        self, file: int, folder: int, name: str, compression: str, counters: Counters | None = None
    ) -> None:
        self.name, self.folder = name, folder
        self._compression = compression
        self._counters = counters
        self._stream = FileIO(file, "wb")
        self._writer = McapFile(self._stream, compression, _LIBRARY)
        self._before: Counter[str] = Counter()
        self._bytes_before = 0
        self._head_bytes = 0
        self.part = 0
        """Files that were finished."""
        self.finished: Callable[[int], None] | None = None
        """Called with the size of the last file, when it is whole."""
        self._channels: dict[str, int] = {}
        self._declared: dict[str, tuple[str, bytes | None]] = {}
        self._schemas: dict[str, int] = {}
        self.count()

    def channel(self, topic: str, schema: str, data: bytes | None = None) -> None:
        """Declare a channel once.

        Args:
            topic: Its name.
            schema: ``embodichain.NAME`` or ``foxglove.NAME``.
            data: The schema's FileDescriptorSet, where it is this run's own.
        """
        if topic in self._channels:
            return
        self._declared[topic] = schema, data
        if schema not in self._schemas:
            self._schemas[schema] = self._writer.schema(
                schema, data if data is not None else descriptor_set(schema)
            )
        self._channels[topic] = self._writer.channel(topic, self._schemas[schema])

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Add an attachment."""
        self._writer.attachment(name, media_type, data, time_ns)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._writer.metadata(name, values)

    def write(self, topic: str, time_ns: int, parts: Sequence[Part]) -> None:
        """Add a message to a declared channel."""
        self._writer.message(self._channels[topic], time_ns, parts)

    def send(self, time_ns: int, messages: Sequence[tuple[str, bytes]]) -> None:
        """Write messages of one moment, each with its topic."""
        channels = self._channels
        self._writer.messages(time_ns, [(channels[topic], data) for topic, data in messages])

    def write_rows(
        self, messages: Sequence[tuple[str, Sequence[Piece]]], times: Sequence[int]
    ) -> None:
        """Write the same messages for each of some moments: see `McapFile.rows`."""
        channels = self._channels
        self._writer.rows([(channels[topic], pieces) for topic, pieces in messages], times)

    def began(self) -> None:
        """The start of this file is written."""
        self._head_bytes = self._writer.size
        self.count()

    def written(self, topic: str) -> int:
        """How many messages of a channel are in the files, readable there."""
        channel = self._channels.get(topic)
        return self._before[topic] + (0 if channel is None else self._writer.count(channel))

    @property
    def where_it_ends(self) -> str:
        """Where the log ends if nothing more is written, in words."""
        steps = self.written("/sim/step")
        return f"it ends after control step {steps - 1}" if steps else "no control step is in it"

    def flush(self) -> None:
        """Make everything readable in the file.

        Raises:
            OSError: If it cannot be written, or was removed.
        """
        self._writer.flush()
        self._check_place()
        self.count()

    def roll(self, name: str, last: Callable[[LogFile], None]) -> int:
        """Finish the file, and go on in another one, with the same channels under the same ids.

        The new file exists before the old one names it: whoever reads finds both.

        Args:
            name: The new file, in the same folder.
            last: Called for what the old file shall end with.

        Returns:
            Size of the finished file.
        """
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        opened = os.open(name, flags, 0o666, dir_fd=self.folder)
        stream = FileIO(opened, "wb")
        try:
            last(self)
            self._writer.finish()
            self._check_place()
        except BaseException:
            stream.close()
            raise
        for topic, channel in self._channels.items():
            self._before[topic] += self._writer.count(channel)
        nbytes = self._writer.nbytes
        self._stream.close()
        self._stream = stream
        self._writer = McapFile(stream, self._compression, _LIBRARY)
        self._bytes_before += nbytes
        self._head_bytes = 0
        self._channels.clear()
        self._schemas.clear()
        for topic, (schema, data) in list(self._declared.items()):
            self.channel(topic, schema, data)
        self.part += 1
        self.count()
        return nbytes

    def finish(self) -> None:
        """Write the index and the end of the file, and close it.

        Raises:
            OSError: If it cannot be written, or was removed.
        """
        self._writer.finish()
        self._check_place()
        if self.finished is not None:
            self.finished(self._writer.nbytes)
        self.count()
        self.close()

    def close(self) -> None:
        """Close the file as it is. Some file systems say only here that they could not write."""
        os.close(self.folder)
        self._stream.close()

    def _check_place(self) -> None:
        """Raise if the file was removed: what is written then is gone with this process."""
        if not os.fstat(self._stream.fileno()).st_nlink:
            raise FileNotFoundError(errno.ENOENT, "the file was removed while it was written")

    def count(self) -> None:
        """Say how large the files are."""
        if self._counters is not None:
            nbytes = self._bytes_before + self._writer.nbytes
            self._counters.set(nbytes, self._writer.size, self.part, self._head_bytes)
