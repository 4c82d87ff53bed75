"""`SeenTogether`: what viewers of a log are shown, of many moments at once.

Samples with the same scenes, looks and commands wait for each other, and so do metrics: one moment
costs nearly as much as sixty. So a file has messages of one topic in the order of their times, but
not those of several. What is in a message is `ViewEncoder`'s business.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from embodichain.lab.sim.engine.base import F64
from embodichain.recording.foxglove.view_encoder import PUSHED, ViewEncoder
from embodichain.recording.log_file import LogFile
from embodichain.recording.steady_log import SteadySteps

__all__ = ["VIEW", "SeenTogether"]

VIEW = "view."
"""What names of `ViewEncoder`'s methods begin with, where they are called by name."""
_MOST = 64
"""Moments that wait for each other: what they have in common costs little by then."""


class SeenTogether:
    """Collects what viewers see; nothing of it is in the file before `finish`.

    Args:
        views: Makes the messages.
        file: Where they are written.
    """

    def __init__(self, views: ViewEncoder, file: LogFile) -> None:
        self._views, self._file = views, file
        self._sampled = -1
        self._times: list[int] = []
        self._rows: list[F64] = []  # (L, n, nstate) each
        self._numbers: list[tuple[int, F64]] = []
        self._steps: SteadySteps | None = None
        self._first = 0
        self._moments: Sequence[int] = ()
        self._due: list[int] = []  # of those steps

    def methods(self) -> dict[str, Callable[..., None]]:
        """What may be called by name, `VIEW` and a method of `ViewEncoder`'s."""
        views = self._views
        found = {name: self._after_all(getattr(views, name)) for name in PUSHED}
        found |= {"numbers": self._take_numbers, "line": views.line, "event": views.event}
        return {VIEW + name: method for name, method in found.items()}

    def _after_all(self, method: Callable[..., None]) -> Callable[..., None]:
        """A method that changes what is seen, or shows something at once."""

        def called(*args: object) -> None:
            self.finish()
            method(*args)

        return called

    def _take_numbers(self, time_ns: int, taken: F64) -> None:
        self._numbers.append((time_ns, np.array(taken)))  # its memory is lent
        self._finish_many()

    def is_due(self, step: int) -> bool:
        """Whether a control step is to be sampled and was not yet."""
        return step != self._sampled and self._views.is_due(step)

    def look(self, step: int, time_ns: int, rows: F64) -> None:
        """Sample a control step that is due.

        Args:
            step: The step.
            time_ns: Its moment.
            rows: (n, nstate) rows of the viewed environments, as physics receives them; kept.
        """
        self._sampled = step
        if self._views.scenes_due:
            self.finish()
            self._views.look(time_ns, rows)
        else:
            self._put([time_ns], rows[None])
            self._finish_many()

    def begin(self, steps: SteadySteps, first: int, times: Sequence[int]) -> None:
        """Control steps follow that a log takes together.

        Args:
            steps: The steps.
            first: Number of the first of them.
            times: The moment of each in ns.
        """
        self._steps, self._first, self._moments = steps, first, times

    def step(self, k: int) -> None:
        """Sample the k-th of those steps, if it is due."""
        if self._steps is None or not self.is_due(self._first + k):
            return
        if self._views.scenes_due:
            (rows,) = self._steps.rows_at([k], self._views.env_ids)
            self.look(self._first + k, self._moments[k], rows)
        else:
            self._sampled = self._first + k
            self._due.append(k)

    def end(self) -> None:
        """Those steps are over: their arrays are not looked at again."""
        self._gather()
        self._steps = None
        self._finish_many()

    def _gather(self) -> None:
        due, self._due = self._due, []
        if due and self._steps is not None:
            rows = self._steps.rows_at(due, self._views.env_ids)
            self._put([self._moments[k] for k in due], rows)

    def _put(self, times: Sequence[int], rows: F64) -> None:
        self._times += times
        self._rows.append(rows)

    def _finish_many(self) -> None:
        if max(len(self._times), len(self._numbers)) >= _MOST:
            self.finish()

    def finish(self) -> None:
        """Write what was not written yet."""
        self._gather()
        if self._times:
            times, rows = self._times, np.concatenate(self._rows)
            self._times, self._rows = [], []
            self._file.write_rows(self._views.look_often(times, rows), times)
        if self._numbers:
            moments, taken = zip(*self._numbers, strict=True)
            self._numbers = []
            self._file.write_rows(self._views.numbers_often(np.array(taken)), moments)
