"""Atomic file writes: written under a temporary name, then renamed or linked."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["atomic_file", "write_text"]


@contextmanager
def atomic_file(path: Path, *, new: bool = False) -> Iterator[Path]:
    """Yield a temporary path to write to; at the end the file is renamed to `path` in one step.

    If writing fails, the temporary file is removed.

    Args:
        path: The file; its folder must exist. The temporary name has the same suffix.
        new: If true, an existing file is not replaced.

    Raises:
        FileExistsError: If `new` and the file exists.
        OSError: If the file cannot be written.
    """
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.{threading.get_ident()}{path.suffix}")
    try:
        yield temporary
        with temporary.open("rb") as stream:
            os.fsync(stream.fileno())
        if not new:
            os.replace(temporary, path)
            return
        try:
            os.link(temporary, path)  # unlike a rename, it fails if the name exists
        except FileExistsError:
            raise
        except OSError:  # a file system without links: create the file, then replace it
            path.open("xb").close()
            os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str, *, new: bool = False) -> None:
    """Write a text file atomically: readers get the old content or the new, never a part.

    Args:
        path: The file; its folder must exist.
        text: Its content.
        new: If true, an existing file is not replaced.

    Raises:
        FileExistsError: If `new` and the file exists.
        OSError: If the file cannot be written; no partial file remains.
    """
    with atomic_file(path, new=new) as temporary:
        temporary.write_text(text, encoding="utf-8")
