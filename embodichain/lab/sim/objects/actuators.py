"""`ActuatedJoints`: an articulation's controls, actuator by actuator.

What a control means is the actuator's business (`embodichain show`): a force, a position or a
velocity target, a muscle's excitation. `Articulation.set_qpos` and `set_qvel` set joints' targets.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.objects._arrays import as_rows, columns_of, names_matching, to_tensor
from embodichain.lab.sim.objects.named_joints import NamedJoints

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler import EntityIndex
    from embodichain.lab.sim.engine.base import F64, Engine, EnvIndex
    from embodichain.lab.sim.objects.drives import Drives

__all__ = ["ActuatedJoints"]


class ActuatedJoints(NamedJoints):
    """An entity with M controls: those of its file's actuators in the file's order, then drives."""

    drives: Drives
    _joint_of: NDArray[np.int64]

    def bind(self, engine: Engine, index: EntityIndex) -> None:
        """Learn where the compiled model keeps the controls."""
        super().bind(engine, index)
        joints = {int(column): row for row, column in enumerate(index.ctrl_ids)}
        # Which joint's drive each control is, or -1.
        drives = [joints.get(int(column), -1) for column in index.own_ctrl_ids]
        self._joint_of = np.asarray(drives, np.int64)

    @property
    def actuator_names(self) -> list[str]:
        """Names of the M controls: the actuator's, with ``.INPUT`` where it has several."""
        return list(self.parsed.control_names)

    @property
    def ctrl_limits(self) -> torch.Tensor:
        """(M, 2) lower and upper controls, infinite where nothing limits them.

        MuJoCo clamps controls of the file's actuators, a drive its target to the joint's limits.
        """
        return to_tensor(self.parsed.ctrl_limits)

    def find_actuators(self, patterns: str | Sequence[str]) -> list[int]:
        """Indices of controls whose names a regex matches in full, in their order.

        Raises:
            ValueError: If a pattern matches nothing; lists the names.
        """
        return names_matching(patterns, self.parsed.control_names, f"actuator of {self.uid}")

    def _picked(self, actuator_ids: Any, names: str | Sequence[str] | None) -> NDArray[np.int64]:
        count = len(self.parsed.control_names)
        if names is not None:
            actuator_ids = self.find_actuators(names)
        elif actuator_ids is None:
            return np.arange(count)
        if isinstance(actuator_ids, torch.Tensor):
            actuator_ids = actuator_ids.tolist()
        ids = np.asarray(actuator_ids, np.int64).reshape(-1)
        if ((ids < 0) | (ids >= count)).any():
            raise ValueError(
                f"{self.uid}: actuator_ids must be in [0, {count}), got {ids.tolist()}"
            )
        return ids

    def get_ctrl(
        self, actuator_ids: Any = None, names: str | Sequence[str] | None = None
    ) -> torch.Tensor:
        """(N, k) controls, by index or by regex over `actuator_names`; all M without a choice."""
        return to_tensor(self.read_ctrl()[:, self._picked(actuator_ids, names)])

    def set_ctrl(
        self,
        ctrl: Any,
        actuator_ids: Any = None,
        env_ids: Any = None,
        names: str | Sequence[str] | None = None,
    ) -> None:
        """Set controls; they stay until they are overwritten or the environment is reset.

        Args:
            ctrl: (n, k) in the actuators' units, or (k,) for all n environments.
            actuator_ids: The k controls; None is all M.
            env_ids: The n environments; None is all N.
            names: Regexes over `actuator_names`, instead of ``actuator_ids``.

        Raises:
            ValueError: If a shape, an index or a value is wrong, or a regex matches nothing.
        """
        ids, rows = self._ids(env_ids)
        which = self._picked(actuator_ids, names)
        values = as_rows(ctrl, rows, len(which), f"{self.uid}: ctrl", shared=True)
        self.write_ctrl(values, which, ids)

    def read_ctrl(self) -> F64:
        """(N, M) controls: a live view or a copy; do not write or keep."""
        return self.engine.state("ctrl")[:, columns_of(self.entity.own_ctrl_ids)]

    def write_ctrl(
        self,
        values: F64,
        which: NDArray[np.int64],
        ids: EnvIndex | None = None,
        seconds: float | None = None,
    ) -> None:
        """Set controls (n, k) from checked arrays: the door for action terms.

        Args:
            values: In the actuators' units.
            which: (k,) controls.
            ids: (n,) environments, or None for all.
            seconds: If given, targets of drives move within their `max_velocity` times it.
        """
        columns = np.asarray(self.entity.own_ctrl_ids, np.int64)[which]
        joints = self._joint_of[which]
        drives = np.flatnonzero(joints >= 0)
        if len(drives):
            values, joints = values.astype(np.float64), joints[drives]
            targets = self.drives.take_targets(values[:, drives], joints, ids, seconds)
            values[:, drives] = targets
        self.engine.write("ctrl", values, ids, columns_of(columns))
