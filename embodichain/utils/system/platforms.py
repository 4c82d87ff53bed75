"""What works on Linux only, and what is asked of the operating system.

Everything is developed and tested on Linux. macOS and Windows are untried: the package imports
there (tested on Linux without the modules and functions of Python that they lack), and what cannot
work is refused by name.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from embodichain.utils.errors import ConfigError, Problem

__all__ = [
    "LIMITED",
    "LIMITS",
    "Limit",
    "is_locked",
    "limits",
    "lock",
    "locked_by",
    "memory_bytes",
    "need",
    "shared_lock",
]

LIMITED = {"darwin": "macOS", "win32": "Windows"}
"""`sys.platform` -> name of a system that lacks something, and on which the package is untried."""
_BOTH = tuple(LIMITED)


@dataclass(frozen=True, slots=True)
class Limit:
    """Something that another system than Linux lacks.

    Attributes:
        feature: What is missing, as a user writes it.
        systems: Values of `sys.platform` on which it is.
        reason: Why.
        instead: What works there.
        refused: Whether `need` raises for it; otherwise something else happens.
    """

    feature: str
    systems: tuple[str, ...]
    reason: str
    instead: str
    refused: bool = False


LIMITS = (
    Limit(
        "record=mcap",
        ("win32",),
        "files are opened relative to a folder's descriptor",
        "record=none, or Linux in WSL",
        refused=True,
    ),
    Limit("collect", ("win32",), "its lists are locked with flock", "Linux in WSL", refused=True),
    Limit(
        "viewer=web",
        ("win32",),
        "its process inherits a socket",
        "viewer=native, or Linux in WSL",
        refused=True,
    ),
    Limit(
        "outputs/latest", ("win32",), "it is a symbolic link", "switch on Windows' Developer Mode"
    ),
    Limit("SIGUSR2", ("win32",), "there is no such signal", "Ctrl-C ends a run"),
    Limit("sim.engine=warp on CUDA", ("darwin",), "there is no CUDA", "device=cpu"),
    Limit("viewer=native", ("darwin",), "MuJoCo's window needs `mjpython`", "viewer=web"),
    Limit("batch renderer", ("darwin",), "it needs OpenGL 4.5", "MuJoCo's renderer draws, slower"),
    Limit("pictures without a display", _BOTH, "EGL is Linux's", "a session with a display"),
    Limit("sim.num_threads=0", _BOTH, "there is no affinity to read", "it is all of the cores"),
    Limit("make, scripts/system_deps.sh", _BOTH, "they use Debian's packages", "pip install"),
)
"""All of them; a test compares the table in docs/install.md."""


def limits() -> list[Limit]:
    """What this machine's system lacks; empty on Linux."""
    return [limit for limit in LIMITS if sys.platform in limit.systems]


def need(*features: str) -> None:
    """Check that features of `LIMITS` work here.

    Raises:
        ConfigError: This system lacks one; names it, and what works instead.
    """
    missing = [limit for limit in limits() if limit.feature in features and limit.refused]
    if missing:
        raise ConfigError([_problem(limit, LIMITED[sys.platform]) for limit in missing])


def _problem(limit: Limit, system: str) -> Problem:
    key, has_value, _ = limit.feature.partition("=")
    message = f"{limit.feature} does not work on {system}: {limit.reason}"
    return Problem(key if has_value else "", message, f"Instead: {limit.instead}")


def lock(descriptor: int) -> None:
    """Lock an open file for this process, until it is closed.

    Raises:
        BlockingIOError: Another process has locked it.
        ConfigError: This system has no such locks.
    """
    need("collect")
    import fcntl

    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextmanager
def shared_lock(folder: Path) -> Iterator[None]:
    """Lock a folder, which several processes may; it is for `is_locked` only.

    Windows has no such locks: nothing is done there.

    Raises:
        OSError: The folder cannot be locked.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH)
        yield
    finally:
        os.close(descriptor)


def is_locked(folder: Path) -> bool:
    """Whether a process has locked a folder; False where that cannot be known."""
    try:
        import fcntl

        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except (ImportError, OSError):
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    finally:
        os.close(descriptor)
    return False


def locked_by(descriptor: int) -> int | None:
    """Return the process of this machine that has locked a file (proc(5)).

    Args:
        descriptor: The file, opened by this process.

    Returns:
        Its id; None if another machine has locked it, or where the system does not tell.
    """
    status = os.fstat(descriptor)
    device = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}"
    place = f"{device}:{status.st_ino}"
    with suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/locks").read_text().splitlines():
            fields = line.split()
            if fields[1] == "FLOCK" and fields[5] == place and int(fields[4]) > 0:
                return int(fields[4])
    return None


def memory_bytes() -> float:
    """Memory of this machine in bytes; inf where the system does not tell (Windows)."""
    if not hasattr(os, "sysconf"):
        return float("inf")
    return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
