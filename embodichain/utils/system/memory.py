"""How much memory is free, so that what cannot fit is refused before it is allocated."""

from __future__ import annotations

import os
from pathlib import Path

from embodichain.utils.errors import ConfigError, Problem

__all__ = ["available_memory", "require_memory_for"]

_MEMINFO = Path("/proc/meminfo")
_LIMIT = Path("/sys/fs/cgroup/memory.max")
_USED = Path("/sys/fs/cgroup/memory.current")


def available_memory() -> int | None:
    """Bytes that this process may still allocate; None where the system does not say.

    On Linux the memory that is available without swapping, within the control group's limit;
    elsewhere all memory of the machine.
    """
    limits: list[int] = []
    try:
        for line in _MEMINFO.read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                limits.append(1024 * int(line.split()[1]))
        limits.append(int(_LIMIT.read_text()) - int(_USED.read_text()))
    except (OSError, ValueError):
        pass  # another system, or no limit ("max")
    if limits:
        return max(0, min(limits))
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None


def require_memory_for(count: int, each: int, what: str, path: str) -> None:
    """Refuse a number of things that do not fit into memory.

    Args:
        count: How many.
        each: Bytes that one needs at least.
        what: Their name in the plural.
        path: The key that gives their number.

    Raises:
        ConfigError: If they do not fit; says what they need, what is free and how many fit.
    """
    free = available_memory()
    if free is None or count * each <= free:
        return
    message = (
        f"{count:,} {what} need at least {_gigabytes(count * each)} of memory, and "
        f"{_gigabytes(free)} are free: at most {free // each:,} fit"
    )
    raise ConfigError([Problem(path, message)])


def _gigabytes(count: int) -> str:
    digits = ",.3g" if count < 1e12 else ",.0f"
    return f"{count / 1e9:{digits}} GB"
