"""Processes that are told apart for good: whether one has ended, and ending with a parent.

A process id is used again, means nothing on another machine, and another one in a container. With
the machine, its boot, the namespace of ids, and the time when the process began, it is unique.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

__all__ = ["ProcessId", "end_with", "own_process"]

_PATTERN = re.compile(r"([0-9a-f]{8})-(\d+)-(\d+)")
_PERIOD = 0.5
"""Seconds between two looks at a parent."""
_ENDED = "ZX"
"""States of proc(5) of a process that has ended, and that its parent has not waited for."""


@dataclass(frozen=True, slots=True)
class ProcessId:
    """A process, told apart from all others that ever were.

    Attributes:
        place: Digest of the machine's name, its boot and the namespace of process ids.
        pid: Its id there.
        began: When it began, in clock ticks since the boot; 0 where the system does not tell.
    """

    place: str
    pid: int
    began: int

    def __str__(self) -> str:
        return f"{self.place}-{self.pid}-{self.began}"

    @staticmethod
    def parse(text: str) -> ProcessId | None:
        """Return the process of a text that `str` made; None for another text."""
        match = _PATTERN.fullmatch(text)
        if match is None:
            return None
        return ProcessId(place=match[1], pid=int(match[2]), began=int(match[3]))

    @property
    def has_ended(self) -> bool:
        """Whether it has certainly ended.

        False for a process of another place, and where the system does not tell.
        """
        if not self.began or self.place != _place():
            return False
        try:
            os.kill(self.pid, 0)  # signal 0 only asks
        except ProcessLookupError:
            return True
        except OSError:
            return False  # somebody else's, which may be hidden in /proc
        state = _state(self.pid)
        return state is not None and (state[1] != self.began or state[0] in _ENDED)


def own_process() -> ProcessId:
    """Return this process."""
    pid = os.getpid()
    state = _state(pid)
    return ProcessId(_place(), pid, 0 if state is None else state[1])


def end_with(parent: ProcessId) -> None:
    """End this process, as if it were killed, within a second of the end of another one.

    A thread looks at the parent. `PR_SET_PDEATHSIG` of prctl(2) does not do: it fires when the
    thread ends that started this process. Does nothing where the system does not tell when a
    process began.

    Args:
        parent: A process of this machine.
    """
    if parent.began:
        threading.Thread(target=_watch, args=[parent], name="parent", daemon=True).start()


def _watch(parent: ProcessId) -> None:
    while not parent.has_ended:
        time.sleep(_PERIOD)
    os._exit(1)  # what runs here may wait for the parent, and would never return


def _state(pid: int) -> tuple[str, int] | None:
    """The state of a process, and when it began (proc(5)); None where there is no such file."""
    with suppress(OSError, ValueError, IndexError):
        text = Path(f"/proc/{pid}/stat").read_text(errors="replace")
        fields = text.rpartition(")")[2].split()  # the name before it may have blanks
        return fields[0], int(fields[19])
    return None


def _place() -> str:
    parts = [platform.node()]
    with suppress(OSError):
        parts.append(Path("/proc/sys/kernel/random/boot_id").read_text())
        parts.append(os.readlink("/proc/self/ns/pid"))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:8]
