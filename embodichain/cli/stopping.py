"""Signals as a flag that a loop reads, so that everything is closed before leaving.

Ctrl-C and SIGTERM, and SIGUSR2: what batch systems send some time before they kill
(`sbatch --signal=USR2@120`). All of them end a run after its current step.
"""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any

__all__ = ["StopFlag"]

_SIGNALS = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGUSR2") if hasattr(signal, name)
]


class StopFlag:
    """Within a ``with`` block, the first signal sets `stopped`; a second Ctrl-C raises at once.

    Outside the main thread (a sweep's worker may be a thread) signals cannot be handled, and the
    flag stays down.

    Attributes:
        stopped: Name of the signal that came (``SIGINT``), or None.
    """

    def __init__(self) -> None:
        self.stopped: str | None = None
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> StopFlag:
        if threading.current_thread() is threading.main_thread():
            for number in _SIGNALS:
                self._before[number] = signal.signal(number, self._raise_flag)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before.clear()

    def _raise_flag(self, number: int, frame: FrameType | None) -> None:
        if self.stopped is not None and number == signal.SIGINT:
            raise KeyboardInterrupt("interrupted twice: left without closing everything")
        self.stopped = signal.Signals(number).name
