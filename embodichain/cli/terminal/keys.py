"""Keys that are pressed in the terminal, without Enter: for commands that wait for a person."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["has_person", "pressed_keys"]

_MOST_BYTES = 1024


def has_person() -> bool:
    """Whether somebody sits at this command: it is in the foreground of a terminal."""
    try:
        is_terminal = sys.stdin.isatty() and sys.stderr.isatty()
        if not is_terminal:
            return False
        if not hasattr(os, "tcgetpgrp"):  # Windows
            return True
        # A job in the background is stopped by the system when it reads the terminal.
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (AttributeError, OSError, ValueError):  # no stream, none of the system, or closed
        return False


@contextmanager
def pressed_keys() -> Iterator[Callable[[], bool]]:
    """Read keys inside the context; what was typed before it is dropped.

    Yields:
        A function that returns whether a key was pressed since its last call. Ctrl-C is a signal
        as ever.
    """
    if sys.platform == "win32":
        yield _pressed_on_windows
        return
    import termios
    import tty

    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal)  # drops what was typed
    try:
        yield lambda: _take_keys(terminal)
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)


def _take_keys(terminal: int) -> bool:
    """Read what was typed; return whether that was anything."""
    readable, _, _ = select.select([terminal], [], [], 0.0)
    return bool(readable) and bool(os.read(terminal, _MOST_BYTES))


def _pressed_on_windows() -> bool:
    """Read what was typed; return whether that was anything."""
    import msvcrt

    was_pressed = False
    while msvcrt.kbhit():  # type: ignore[attr-defined]
        msvcrt.getch()  # type: ignore[attr-defined]
        was_pressed = True
    return was_pressed
