"""`Pool`: whether the batch's threads still look for work when physics is due again.

MuJoCo's threads look for work for some 45 us after a call, and sleep then; to wake one takes 30 us,
half of what 8 arms' physics takes. A call in between that computes nothing has them look on. How
that is asked of the batch lives here; when physics is due is the caller's business.
"""

from __future__ import annotations

import math
import time

import mujoco
from mujoco import batch as mjbatch

__all__ = ["Pool"]

_LOOKS_SECONDS = 45e-6
"""So long after a call MuJoCo's threads look for work (measured with MuJoCo 4.0.0)."""
_SOON_SECONDS = 60e-6
"""From the moment they may be asked to the next physics: a third more than they look, so that one
slow step, which waking threads makes slower still, does not end it."""
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
        self._began = self._ended = 0.0
        self._hinted = -math.inf
        self._until_physics = math.inf

    def began(self) -> None:
        """Physics is about to step."""
        self._began = time.perf_counter()
        self._until_physics = self._began - self._hinted

    def ended(self) -> None:
        """Physics has stepped."""
        self._ended = time.perf_counter()

    def sleeps_soon(self) -> bool:
        """Whether threads would fall asleep before physics is due, unless they are asked again.

        To be called at the same place of each step. Physics is due as long after that as it came
        the last time: whoever does something long between two steps gains nothing.
        """
        now = self._hinted = time.perf_counter()
        short = self._ended - self._began < _SHORT_SECONDS
        due_soon = short and self._until_physics < _SOON_SECONDS
        return due_soon and not self._alone and now - self._ended < _LOOKS_SECONDS

    def ask(self) -> None:
        """Have the threads look for work anew. Outputs that were bound are overwritten."""
        # Of all simulations: choosing one for each thread takes longer than loading a few more.
        self._batch.forward(stage=_STAGE_NONE)
        self._hinted = time.perf_counter()
