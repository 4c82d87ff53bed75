"""Atomic file writes: written under a temporary name, then renamed or linked.

A temporary name says which process writes: ``.STEM.PROCESS-NUMBER.part.SUFFIX``. What a process
left that was killed is removed by the next one that writes in the folder.
"""

from __future__ import annotations

import errno
import itertools
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from embodichain.utils.errors import EmbodichainError
from embodichain.utils.system.processes import ProcessId, own_process

__all__ = [
    "atomic_file",
    "move_new",
    "named_errors",
    "remove_abandoned",
    "temporary_name",
    "write_text",
    "write_text_at",
]

_NAME = re.compile(r"\..*\.(?P<process>[0-9a-f]{8}-\d+-\d+)-\d+\.part(\.[^.]*)?", re.DOTALL)
_FAILS = (errno.EIO, errno.ENOSPC, errno.EDQUOT, errno.ESTALE, errno.EROFS)
"""Errors of a disk, not of one that has no links."""
_numbers = itertools.count(1)


def temporary_name(name: str) -> str:
    """Return a name for what this process writes, to be renamed to `name`; none is given twice.

    It begins with a dot and has the same suffix.
    """
    path = Path(name)
    return f".{path.stem}.{own_process()}-{next(_numbers)}.part{path.suffix}"


def remove_abandoned(folder: str | Path | int) -> None:
    """Remove from a folder what processes that have ended left under a `temporary_name`.

    Files of processes that live, or of another machine, container or boot stay, as do all others.
    What cannot be removed stays too, as in a folder that only may be read.

    Args:
        folder: A folder, or its descriptor; those in it are not searched.
    """
    with suppress(OSError), os.scandir(folder) as entries:
        # A list: the folder is not to be read while entries are removed from it.
        names = [(entry.name, entry.is_dir(follow_symlinks=False)) for entry in entries]
        place = folder if isinstance(folder, int) else None
        for name, is_folder in names:
            match = _NAME.fullmatch(name)
            process = None if match is None else ProcessId.parse(match["process"])
            if process is None or not process.has_ended:
                continue
            path = name if isinstance(folder, int) else os.path.join(folder, name)
            with suppress(OSError):
                if is_folder:
                    shutil.rmtree(path, dir_fd=place)
                else:
                    os.unlink(path, dir_fd=place)


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
    remove_abandoned(path.parent)
    temporary = path.with_name(temporary_name(path.name))
    try:
        with named_errors(temporary, path):
            yield temporary
            if new:
                move_new(temporary, path)
            else:
                _sync(temporary)
                os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def named_errors(temporary: Path, path: Path) -> Iterator[None]:
    """Raise an error about a temporary file as one about the file that it was to become.

    Libraries raise errors of their own while one of the disk is handled (PyTorch, which ends a zip:
    "unexpected pos 23232 vs 23120"): the disk's is raised.

    Args:
        temporary: The temporary name.
        path: The file.

    Raises:
        OSError: Names `path`, unless the error is about another file.
    """
    try:
        yield
    except Exception as error:
        reason = _disk_error(error)
        if reason is None or reason.errno is None:
            raise
        name = reason.filename
        if name is None or str(name) == str(temporary):
            name = str(path)
        elif reason is error:
            raise
        raise OSError(reason.errno, reason.strerror, name) from error


def _disk_error(error: Exception) -> OSError | None:
    """The error of the system that an error is, or that was handled when a library raised it."""
    if isinstance(error, OSError):
        return error
    if isinstance(error, EmbodichainError):
        return None  # it says what failed
    seen: list[BaseException] = []
    handled = error.__cause__ or error.__context__
    while handled is not None and handled not in seen:
        if isinstance(handled, OSError) and handled.errno in _FAILS:
            return handled
        seen.append(handled)
        handled = handled.__cause__ or handled.__context__
    return None


def _sync(path: Path) -> None:
    """Let the system write a file to the disk."""
    with path.open("rb") as stream:
        os.fsync(stream.fileno())


def move_new(temporary: Path, path: Path) -> None:
    """Give a whole file or folder its name, unless that exists.

    Args:
        temporary: The file, of which the temporary name may stay as a second one; or the folder.
        path: Its name, in the same folder.

    Raises:
        FileExistsError: If the name exists.
        OSError: If it cannot be renamed; `path` does not exist then.
    """
    if temporary.is_dir():
        temporary.rename(path)  # fails if the name exists, unless it is an empty folder
        return
    _sync(temporary)
    try:
        os.link(temporary, path)  # unlike a rename, it fails if the name exists
    except OSError as error:
        if isinstance(error, FileExistsError) or error.errno in _FAILS:
            raise
        # A file system without links: create the file, then replace it.
        path.open("xb").close()
        try:
            os.replace(temporary, path)
        except OSError:
            path.unlink(missing_ok=True)  # the empty one
            raise


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


def write_text_at(folder: int, name: str, text: str, *, new: bool = False) -> None:
    """Write a text file atomically into an open folder, which may have been renamed.

    Args:
        folder: Its descriptor.
        name: The file's name.
        text: Its content.
        new: If true, an existing file is left as it is.

    Raises:
        OSError: If the file cannot be written; no partial file remains.
    """
    remove_abandoned(folder)
    temporary = temporary_name(name)
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
    descriptor = os.open(temporary, flags, 0o666, dir_fd=folder)
    try:
        with open(descriptor, "w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        if new and _exists_at(folder, name):
            return
        os.replace(temporary, name, src_dir_fd=folder, dst_dir_fd=folder)
    finally:
        with suppress(FileNotFoundError):
            os.unlink(temporary, dir_fd=folder)


def _exists_at(folder: int, name: str) -> bool:
    try:
        os.stat(name, dir_fd=folder, follow_symlinks=False)
    except FileNotFoundError:
        return False
    return True
