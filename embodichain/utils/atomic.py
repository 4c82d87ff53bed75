"""Files that appear complete or not at all: written under another name, then renamed or linked."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["atomic_file", "write_text"]


@contextmanager
def atomic_file(path: Path, *, new: bool = False) -> Iterator[Path]:
    """Give a name to write a file under; at the end the file gets its own name in one step.

    Nothing is left behind where writing fails.

    Args:
        path: The file; its folder exists. The name to write under ends as `path` does.
        new: Whether a file of that name is kept instead of replaced.

    Raises:
        FileExistsError: `new`, and the name is taken.
        OSError: The file cannot be written.
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
            os.link(temporary, path)  # unlike a rename, it refuses a name that is taken
        except FileExistsError:
            raise
        except OSError:  # a file system without links: claim the name, then take its place
            path.open("xb").close()
            os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str, *, new: bool = False) -> None:
    """Write a text file; readers see the old content or the new one, never a part.

    Args:
        path: The file; its folder exists.
        text: Its content.
        new: Whether a file of that name is kept instead of replaced.

    Raises:
        FileExistsError: `new`, and the name is taken.
        OSError: The file cannot be written; nothing is left behind.
    """
    with atomic_file(path, new=new) as temporary:
        temporary.write_text(text, encoding="utf-8")
