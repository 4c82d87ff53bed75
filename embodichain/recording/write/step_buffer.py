"""`StepBuffer`: recorded control steps that are not in the file yet."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from embodichain.recording.format.container.mcap_writer import nbytes
from embodichain.recording.format.messages.block import Recorded
from embodichain.recording.format.messages.episodes import Ends

__all__ = ["RecordedStep", "StepBuffer"]

MOST_STEPS = 256
"""Number of steps that are written together at most."""
MOST_BYTES = 2**20
"""Size of the steps that are written together at most; one larger step is written alone."""
MOST_SECONDS = 0.25
"""Age at which a step is written."""


@dataclass(slots=True)
class RecordedStep:
    """The calls of a control step.

    Attributes:
        number: Number of the step.
        calls: Its calls; of a finished step, ``step`` is the last one.
        ends: The episodes that end in it; None if none does.
    """

    number: int
    calls: list[Recorded] = field(default_factory=list)
    ends: Ends | None = None


class StepBuffer:
    """The finished steps that are not written yet, and after them the one that has begun.

    An interrupt may come between any two statements of the stepping thread, and the timer may take
    the finished steps meanwhile. So all of them are one list, the step that has begun is always its
    last item, and each change of it is a single operation on the list.

    Args:
        number: Number of the first step.
    """

    def __init__(self, number: int) -> None:
        self._steps = [RecordedStep(number)]
        self._begun = 0.0  # when the first step was finished, on the monotonic clock
        self._capacity = 1  # number of steps that are written together

    @property
    def number(self) -> int:
        """Number of the step that has begun: that of finished steps since the recording began."""
        return self._steps[-1].number

    def add(self, call: Recorded) -> None:
        """Add a call to the step that has begun."""
        self._steps[-1].calls.append(call)

    def finish_step(self, call: Recorded, ends: Ends | None) -> None:
        """Finish the step that has begun by its ``step`` call; the next one begins."""
        open_step = self._steps[-1]
        number = open_step.number
        finished = RecordedStep(number, [*open_step.calls, call], ends)
        if len(self._steps) == 1:
            size = sum(_size_of(call) for call in finished.calls)
            self._capacity = min(MOST_STEPS, 1 + MOST_BYTES // size)
            self._begun = time.monotonic()
        self._steps[-1:] = [finished, RecordedStep(number + 1)]

    def skip_step(self) -> None:
        """Count a step that is not recorded."""
        self._steps[-1].number += 1

    def is_due(self, now: float) -> bool:
        """Whether the finished steps are many, or old."""
        num_finished = len(self._steps) - 1
        if not num_finished:
            return False
        return num_finished >= self._capacity or now - self._begun > MOST_SECONDS

    def take_steps(self) -> list[RecordedStep]:
        """Return the finished steps, and forget them."""
        steps = self._steps[:-1]
        del self._steps[: len(steps)]
        return steps

    def take_calls(self) -> list[Recorded]:
        """Return the calls of the step that has begun, and forget them."""
        open_step = self._steps[-1]
        calls = open_step.calls
        open_step.calls = []
        return calls


def _size_of(call: Recorded) -> int:
    """Size in bytes of a call's arrays."""
    _, arrays = call
    if isinstance(arrays, bytes):
        return len(arrays)
    return sum(nbytes(array) for array in arrays)
