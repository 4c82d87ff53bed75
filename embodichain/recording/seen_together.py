"""`SeenTogether`: what viewers are shown of control steps that a log takes together.

Samples of moments with the same scenes and commands, and metrics, are made and written together; so
a file has messages of one topic in the order of their times, but not those of several.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from embodichain.lab.sim.engine.base import F64
from embodichain.recording.batches import Aside
from embodichain.recording.foxglove.view_encoder import ViewEncoder
from embodichain.recording.log_file import LogFile
from embodichain.recording.steady_log import SteadySteps

__all__ = ["VIEW", "SeenTogether"]

VIEW = "view."
"""What names of `ViewEncoder`'s methods begin with."""
_NUMBERS, _LINE = VIEW + "numbers", VIEW + "line"


class SeenTogether:
    """Control steps as viewers see them.

    Args:
        views: Makes the messages.
        file: Where they are written.
        steps: The steps.
        first: Number of the first of them.
        times: The moment of each in ns.
    """

    def __init__(
        self,
        views: ViewEncoder,
        file: LogFile,
        steps: SteadySteps,
        first: int,
        times: Sequence[int],
    ) -> None:
        self._views, self._file, self._steps = views, file, steps
        self._first, self._times = first, times
        self._due: list[int] = []
        self._numbers: list[tuple[int, F64]] = []

    def aside(self, aside: Aside) -> None:
        """Carry out a call between those of the steps."""
        if aside.name == _NUMBERS:
            self._numbers.append((aside.args[0], aside.args[1]))
            return
        if aside.name != _LINE:  # it may change what is seen
            self.finish()
        aside.carry_out()

    def step(self, k: int) -> None:
        """Sample the k-th step, if it is due."""
        if not self._views.is_due(self._first + k):
            return
        if not self._views.scenes_due:
            self._due.append(k)
        else:
            self._look()
            (rows,) = self._steps.rows_at([k], self._views.env_ids)
            self._views.look(self._first + k, self._times[k], rows)

    def finish(self) -> None:
        """Write what was not written yet."""
        self._look()
        numbers, self._numbers = self._numbers, []
        if numbers:
            times, taken = zip(*numbers, strict=True)
            self._file.write_rows(self._views.numbers_often(np.array(taken)), times)

    def _look(self) -> None:
        due, self._due = self._due, []
        if due:
            rows = self._steps.rows_at(due, self._views.env_ids)
            times = [self._times[k] for k in due]
            messages = self._views.look_often(self._first + due[-1], times, rows)
            self._file.write_rows(messages, times)
