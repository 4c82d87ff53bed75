"""`StateDump`: what is kept of environments that diverge, for people to look into.

Who has diverged is decided in `BaseEnv.step`: a counter of MuJoCo's rose, or an observation or a
reward is not finite.
"""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.base import F64
    from embodichain.lab.sim.engine.cpu import CpuEngine

__all__ = ["MAX_DUMPS", "StateDump"]

MAX_DUMPS = 10
"""Files a run keeps at most; a task that always diverges would fill the disk."""

logger = logging.getLogger(__name__)


class StateDump:
    """Copies the rows before physics, and writes those of environments that diverge to files.

    Args:
        engine: The simulations.
    """

    def __init__(self, engine: CpuEngine) -> None:
        self._engine = engine
        self._before: F64 = engine.rows.copy()
        self._written = 0

    def keep(self) -> None:
        """Copy all rows as physics is about to receive them."""
        np.copyto(self._before, self._engine.rows)

    def write(
        self, folder: Path | None, rows: NDArray[np.bool_], control_step: int, action: F64
    ) -> None:
        """Log which environments diverged, and write the first `MAX_DUMPS` of them to files.

        A file ``diverged/step_S_env_I.npz`` holds the integration state ``before`` and ``after``
        the physics of that control step, the ``action`` (A,) as given, and the environment's own
        ``model.FIELD`` values.

        Args:
            folder: The run's folder; None writes nothing.
            rows: (N,) bool, who diverged.
            control_step: Number of the step, from 0: the one that a log of this run gives it.
            action: (N, A).
        """
        ids = np.flatnonzero(rows)
        logger.warning(
            "control step %d: %d of %d environments diverged (%s%s); they end and are reset",
            control_step,
            len(ids),
            len(rows),
            ", ".join(map(str, ids[:8])),
            ", ..." if len(ids) > 8 else "",
        )
        if folder is None or self._written >= MAX_DUMPS:
            return
        fields = self._engine.state_dict()["model"]
        target = folder / "diverged"
        target.mkdir(parents=True, exist_ok=True)
        for env_id in ids[: MAX_DUMPS - self._written]:
            path = target / f"step_{control_step}_env_{env_id}.npz"
            values = {
                "before": self._before[env_id],
                "after": self._engine.rows[env_id],
                "action": action[env_id],
                **{f"model.{name}": field[env_id] for name, field in fields.items()},
            }
            partial = path.with_suffix(".partial.npz")
            np.savez(partial, allow_pickle=False, **values)
            os.replace(partial, path)
            self._written += 1
