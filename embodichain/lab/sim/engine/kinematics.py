"""`Kinematics`: poses and velocities of every body, without contacts and constraints."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import batch as mjbatch
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import EnvIndex

__all__ = ["STAGES", "Kinematics"]

_STAGE_POS = int(mujoco.mjtStage.mjSTAGE_POS)
_STAGE_VEL = int(mujoco.mjtStage.mjSTAGE_VEL)

STAGES = dict.fromkeys(
    (
        "xpos", "xquat", "xmat", "xipos", "ximat", "xanchor", "xaxis", "geom_xpos", "geom_xmat",
        "site_xpos", "site_xmat", "subtree_com", "cdof",
    ),
    _STAGE_POS,
) | dict.fromkeys(("cvel", "cdof_dot", "sensordata"), _STAGE_VEL)  # fmt: skip
"""Fields that contacts do not enter, and the stage that computes each."""

_NO_CONTACT = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
_NO_CONSTRAINT = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
_NO_SENSOR = int(mujoco.mjtDisableBit.mjDSBL_SENSOR)


class Kinematics:
    """Forward kinematics of a batch: less than half of its position and velocity stages.

    Contacts are switched off meanwhile; that they have no room in memory is found by the next step.

    Attributes:
        enough: Whether it computes all fields that were asked for.
    """

    def __init__(self) -> None:
        self.enough = True
        self._stage = _STAGE_POS
        self._left_out = _NO_CONTACT | _NO_CONSTRAINT | _NO_SENSOR

    def need(self, name: str) -> None:
        """Compute this field, too, from now on."""
        stage = STAGES.get(name)
        if stage is None:
            self.enough = False
        else:
            self._stage = max(self._stage, stage)
        if name == "sensordata":  # a sensor may be about the constraint of a joint's limit
            self._left_out = _NO_CONTACT

    def forward(
        self, batch: mjbatch.Batch, flags: NDArray[np.int32], env_ids: EnvIndex | None
    ) -> None:
        """Compute the fields at the batch's present state.

        Args:
            batch: The batch.
            flags: (N, 1) its live ``opt.disableflags``, which are left as they are.
            env_ids: (n,) environments, or None for all.

        Raises:
            mujoco.batch.SimulationError: If MuJoCo raised in one.
        """
        kept = flags.copy()
        flags |= self._left_out
        try:
            batch.forward(env_ids, stage=self._stage)
        finally:
            flags[...] = kept
