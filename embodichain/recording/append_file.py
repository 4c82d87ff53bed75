"""`AppendFile`: a file that only grows, and may grow larger than memory.

What is in it, and when it is readable, is known elsewhere.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from io import FileIO

__all__ = ["AppendFile"]

_BLOCK = 4 * 2**20
_WINDOW = 64 * 2**20
"""Of what is behind, this much is let go again: a disk may take a while to take it in."""


class AppendFile:
    """Writes at the end of a file, and lets the system's page cache go of what is written.

    Nobody reads a log while it is made, and kept pages of it push out other files. New ones also
    cost more than the writing: on a virtual machine whose host gives memory as it is touched a MB
    took 2.8 ms where pages were kept, and 0.3 ms where they came round again.

    Args:
        stream: Where to write, without a buffer: what could not be written must not come again. It
            stays open.
    """

    def __init__(self, stream: FileIO) -> None:
        self._descriptor = stream.fileno()
        self._told = 0
        self.size = 0
        """Bytes written."""

    def write(self, parts: Sequence[bytes]) -> None:
        """Append bytes at once.

        Raises:
            OSError: If not all of them could be written; `size` says how many are in the file.
        """
        left = list[bytes | memoryview](parts)
        while left:
            done = os.writev(self._descriptor, left)
            self.size += done
            while left and done >= len(left[0]):
                done -= len(left.pop(0))
            if left:  # a disk that is nearly full may take a part
                left[0] = memoryview(left[0])[done:]
        if self.size >= self._told + _BLOCK:
            self._let_go()

    def _let_go(self) -> None:
        """Have new pages written to the disk, without waiting for it, and older ones dropped."""
        self._told = self.size
        if hasattr(os, "posix_fadvise"):  # Linux; other systems keep the pages
            start = max(0, self.size - _WINDOW)
            with suppress(OSError):  # a file system may not take advice
                os.posix_fadvise(self._descriptor, start, self.size - start, os.POSIX_FADV_DONTNEED)
