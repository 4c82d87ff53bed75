"""Lines of jobs that run at once: each begins with its job, ``[3 seed=1]``.

What jobs one after the other print needs no label, and keeps its live display.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TextIO

__all__ = ["SWEPT_VARIABLE", "told_apart"]

SWEPT_VARIABLE = "EMBODICHAIN_SWEPT"
"""Environment variable with the keys that a sweep varies, for its workers."""
_ONE_BY_ONE = "BasicLauncher"


@contextmanager
def told_apart(*, json: bool) -> Iterator[None]:
    """Label what is printed within, where other jobs print at the same time.

    Args:
        json: Whether stdout is for programs: its lines then stay as they are.
    """
    label = _label()
    if label is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = sys.stdout, sys.stderr
    sys.stderr = _Labelled(sys.stderr, label)
    if not json:
        sys.stdout = _Labelled(sys.stdout, label)
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        sys.stdout, sys.stderr = before


def _label() -> str | None:
    """``[NUMBER KEY=VALUE ...]`` of a job of several at once, else None."""
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode

    if not HydraConfig.initialized() or HydraConfig.get().mode != RunMode.MULTIRUN:
        return None
    config = HydraConfig.get()
    if str(config.launcher.get("_target_", "")).endswith(_ONE_BY_ONE):
        return None
    return _text(config.job.num, config.overrides.task, os.environ.get(SWEPT_VARIABLE, ""))


def _text(number: int, overrides: Sequence[str], swept: str) -> str:
    keys = swept.split(",")
    lines = [line.lstrip("+") for line in overrides]
    point = [line for line in lines if line.partition("=")[0] in keys]
    return f"[{' '.join([str(number), *point])}] "


class _Labelled:
    """A text stream whose lines begin with a label; each is written as a whole.

    It is no terminal, whatever is below: bars of several jobs would overwrite each other.
    """

    def __init__(self, stream: TextIO, label: str) -> None:
        self._stream, self._label, self._rest = stream, label, ""

    def write(self, text: str) -> int:
        """Write the lines that are complete."""
        *lines, self._rest = (self._rest + text).split("\n")
        if lines:
            self._stream.write(
                "".join(f"{self._label}{line}\n" if line else "\n" for line in lines)
            )
            self._stream.flush()
        return len(text)

    def flush(self) -> None:
        """Write what is left, as a line."""
        if self._rest:
            self.write("\n")

    def isatty(self) -> bool:
        """Return False."""
        return False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
