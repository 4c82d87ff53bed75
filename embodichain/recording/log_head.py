"""What every file of a log begins with, and how a log goes on in another file.

All of it runs on the background thread but `Rolling.due`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from embodichain.recording.attachments import Attachment
from embodichain.recording.header import METADATA, METADATA_END, Header
from embodichain.recording.parts import Manifest, part_name
from embodichain.recording.writer import McapThread

__all__ = ["LogHead", "Rolling"]


class LogHead:
    """Attachments and metadata.

    Args:
        header: Of the first file.
        make: Makes the attachments.
        again: Whether they are needed more than once.
    """

    def __init__(self, header: Header, make: Callable[[], list[Attachment]], again: bool) -> None:
        self.header = header
        self._make, self._again = make, again
        self._made: list[Attachment] = []

    def write(self, file: McapThread, part: int = 0, first_step: int = 0) -> None:
        """Write them at the start of a file."""
        attachments = self._made or self._make()
        if self._again:  # files of the scene may be gone by then
            self._made = attachments
        for name, media_type, data in attachments:
            file.attach(name, media_type, data, self.header.start_ns)
        header = replace(self.header, part=part, first_step=first_step)
        file.metadata(METADATA, header.to_metadata())


class Rolling:
    """Closes a file that has become too large, and begins the next.

    Args:
        file: The log.
        head: What every file begins with.
        max_bytes: Size after which the next one begins. A file holds at least as much of the run
            as it has attachments.
    """

    def __init__(self, file: McapThread, head: LogHead, max_bytes: float) -> None:
        header = head.header
        self._file, self._head, self._max = file, head, max_bytes
        self._manifest = Manifest(
            file.folder, file.path.name, header.log_id, header.period_ns * 1e-9
        )
        self._asked = 0
        self._head_bytes = 0

    @property
    def due(self) -> bool:
        """Whether the file has reached its size; asked on the simulation's thread."""
        file = self._file
        here = file.part == self._asked and self._head_bytes > 0
        return here and file.size > max(self._max, 2 * self._head_bytes)

    def began(self, file: McapThread) -> None:
        """The state at the start of the file has been written."""
        self._head_bytes = file.size

    def job(self, step: int) -> Callable[[McapThread], None]:
        """What makes the log go on in another file with control step `step`."""
        self._asked += 1
        part = self._asked
        name = part_name(self._file.path.name, part)

        def last(file: McapThread) -> None:
            file.metadata(METADATA_END, {"steps": str(step), "next": name})

        def go_on(file: McapThread) -> None:
            self._head_bytes = 0
            self._manifest.closed(step, file.roll(name, last))
            self._head.write(file, part, step)
            self._manifest.begun(name, step)
            self._manifest.write(complete=False)

        return go_on

    def finish(self, steps: int) -> Callable[[McapThread], None]:
        """What completes the manifest, if there is one, when the last file is whole."""

        def whole(nbytes: int) -> None:
            if self._file.part:
                self._manifest.closed(steps, nbytes)
                self._manifest.write(complete=True)

        def job(file: McapThread) -> None:
            file.finished = whole

        return job
