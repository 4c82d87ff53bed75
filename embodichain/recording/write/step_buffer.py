"""`StepBuffer`: recorded calls that are not in the file yet."""

from __future__ import annotations

import time

from embodichain.recording.format.messages.block import Recorded

__all__ = ["StepBuffer"]

MOST_STEPS = 256
"""Number of steps that are written together at most."""
MOST_BYTES = 2**20
"""Size of the steps that are written together at most; one larger step is written alone."""
MOST_SECONDS = 0.25
"""Age at which a step is written."""


class StepBuffer:
    """The calls since the last control step, and the finished steps that are not written yet.

    Attributes:
        calls: Calls since the last control step.
        steps: The calls of each finished step.
        first_step: Number of the first of these.
    """

    def __init__(self) -> None:
        self.calls: list[Recorded] = []
        self.steps: list[list[Recorded]] = []
        self.first_step = 0
        self._begun = 0.0  # when the first step was added, on the monotonic clock
        self._capacity = 1  # number of steps that are written together

    @property
    def end_step(self) -> int:
        """Number of the step after the last finished one."""
        return self.first_step + len(self.steps)

    def finish_step(self, number: int) -> None:
        """Make the calls since the last step a finished one."""
        if not self.steps:
            size = sum(array.nbytes for _, arrays in self.calls for array in arrays)
            self._capacity = min(MOST_STEPS, 1 + MOST_BYTES // size)
            self.first_step = number
            self._begun = time.monotonic()
        # A single statement adds the step, so an interrupt neither loses nor repeats it.
        self.steps.append(self.calls)
        self.calls = []

    def is_due(self, now: float) -> bool:
        """Whether the finished steps are many, or old."""
        if not self.steps:
            return False
        return len(self.steps) >= self._capacity or now - self._begun > MOST_SECONDS

    def take_steps(self) -> list[list[Recorded]]:
        """Return the finished steps, which begin with `first_step`, and forget them."""
        steps = self.steps
        self.steps = []
        return steps

    def take_calls(self) -> list[Recorded]:
        """Return the calls since the last control step, and forget them."""
        calls = self.calls
        self.calls = []
        return calls

    def drop_repeated_calls(self) -> None:
        """After an interrupt: drop calls that were already added as a step."""
        if self.steps and self.calls is self.steps[-1]:
            self.calls = []
