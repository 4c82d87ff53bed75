"""`Pool`: whether the batch's threads still look for work when physics is due again.

MuJoCo's threads look for work for some 45 us after a call, and sleep then; to wake one takes 30 us,
half of what 8 arms' physics takes. A call in between that computes nothing has them look on. How
that is asked of the batch lives here; when physics is due is the caller's business.
"""

from __future__ import annotations

import time

import mujoco
import numpy as np
from mujoco import batch as mjbatch

__all__ = ["Pool"]

_LOOKS_SECONDS = 45e-6
"""So long after a call MuJoCo's threads look for work (measured with MuJoCo 4.0.0)."""
_SHORT_SECONDS = 300e-6
"""Of physics: where a call takes longer, being awake would save less than a tenth of it."""
_STAGE_NONE = int(mujoco.mjtStage.mjSTAGE_NONE)


class Pool:
    """Watches the calls that step physics.

    Args:
        batch: The batch.
    """

    def __init__(self, batch: mjbatch.Batch) -> None:
        self._batch = batch
        self._alone = batch.nthread < 2
        # One simulation for each thread: with fewer, some would not be asked.
        self._each = np.linspace(0, batch.nsim - 1, batch.nthread).astype(np.int32)
        self._began = self._ended = 0.0
        self._between = np.inf

    def began(self) -> None:
        """Physics is about to step."""
        self._began = time.perf_counter()
        self._between = self._began - self._ended

    def ended(self) -> None:
        """Physics has stepped."""
        self._ended = time.perf_counter()

    @property
    def may_sleep(self) -> bool:
        """Whether threads would fall asleep before physics is due, unless they are asked again.

        It is due as long after the last time as then after the time before: whoever does something
        long between two steps gains nothing.
        """
        short = self._ended - self._began < _SHORT_SECONDS
        due_soon = short and self._between < 2 * _LOOKS_SECONDS
        if self._alone or not due_soon:
            return False
        return time.perf_counter() - self._ended < _LOOKS_SECONDS

    def ask(self) -> None:
        """Have the threads look for work anew. Outputs that were bound are overwritten."""
        self._batch.forward(self._each, stage=_STAGE_NONE)
