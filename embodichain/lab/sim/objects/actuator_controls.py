"""`ActuatorControls`: an articulation's controls, actuator by actuator."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.objects._arrays import columns_of

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.base import F64, EnvIndex
    from embodichain.lab.sim.host import Binding
    from embodichain.lab.sim.objects.drives import Drives

__all__ = ["ActuatorControls"]


class ActuatorControls:
    """M controls: those of the file's actuators in the file's order, then those of drives.

    What a control means depends on the actuator (`embodichain show`): a force, a position or a
    velocity target, a muscle's excitation.

    Args:
        binding: The articulation's place in the simulation.
        drives: Its drives, some of whose targets are controls.
    """

    def __init__(self, binding: Binding[EntityIndex], drives: Drives) -> None:
        self._binding = binding
        self._drives = drives
        self._joint_of = np.zeros(0, np.int64)  # (M,) whose drive each control is, or -1

    def bind(self) -> None:
        """Look up the controls; called once the scene is compiled."""
        index = self._binding.index
        joints = {int(column): row for row, column in enumerate(index.ctrl_ids)}
        drives = [joints.get(int(column), -1) for column in index.own_ctrl_ids]
        self._joint_of = np.asarray(drives, np.int64)

    def read(self) -> F64:
        """(N, M) controls: a live view or a copy; do not write or keep."""
        columns = columns_of(self._binding.index.own_ctrl_ids)
        return self._binding.engine.state("ctrl")[:, columns]

    def write(
        self,
        values: F64,
        which: NDArray[np.int64],
        ids: EnvIndex | None = None,
        seconds: float | None = None,
    ) -> None:
        """Set controls (n, k) from checked arrays.

        Args:
            values: In the actuators' units.
            which: (k,) controls.
            ids: (n,) environments, or None for all.
            seconds: If given, targets of drives move within their `max_velocity` times it.
        """
        columns = np.asarray(self._binding.index.own_ctrl_ids, np.int64)[which]
        joints = self._joint_of[which]
        drives = np.flatnonzero(joints >= 0)
        if len(drives):
            values, joints = values.astype(np.float64), joints[drives]
            targets = self._drives.take_targets(values[:, drives], joints, ids, seconds)
            values[:, drives] = targets
        self._binding.engine.write("ctrl", values, ids, columns_of(columns))
