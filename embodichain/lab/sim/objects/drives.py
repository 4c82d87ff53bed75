"""`Drives`: the PD drives of an articulation - gains per environment and targets.

The compiler puts the stiffness into an actuator and the damping into the joint (implicit), so a
drive's force is ``kp (target - q) - kd qvel`` and a velocity target adds ``kd target_qvel``, which
enters the control as ``target + (kd / kp) target_qvel``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.objects._arrays import as_rows

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.base import F64, EnvIndex
    from embodichain.lab.sim.objects.articulation import Articulation

__all__ = ["Drives"]

NO_LIMIT = 1e9
"""Efforts at least this large count as unlimited (EmbodiChain's default is 1e10)."""


class Drives:
    """Gains and targets of D joints in N environments.

    Attributes:
        stiffness, damping, max_effort, max_velocity, friction, armature: (N, D) current values.
        target_qvel: (N, D) velocity targets.
    """

    def __init__(self, owner: Articulation) -> None:
        parsed = owner.parsed
        count = owner.num_instances
        self._owner = owner
        self.stiffness: F64 = np.tile(np.asarray(parsed.stiffness, np.float64), (count, 1))
        self.damping: F64 = np.tile(np.asarray(parsed.damping, np.float64), (count, 1))
        self.max_effort: F64 = np.tile(np.asarray(parsed.max_effort, np.float64), (count, 1))
        self.max_velocity: F64 = np.tile(np.asarray(parsed.max_velocity, np.float64), (count, 1))
        self.friction: F64 = np.tile(np.asarray(parsed.friction, np.float64), (count, 1))
        self.armature: F64 = np.tile(np.asarray(parsed.armature, np.float64), (count, 1))
        self.target_qvel: F64 = np.zeros((count, len(parsed.joint_names)))
        self.has_velocity_target = False
        self._limits = np.asarray(parsed.qpos_limits, np.float64)
        self._bounds: dict[bytes, tuple[F64, F64]] = {}

    def _actuators(self, joints: NDArray[np.int64]) -> NDArray[np.int64]:
        ids: NDArray[np.int64] = np.asarray(self._owner.entity.actuator_ids, np.int64)[joints]
        if (ids < 0).any():
            names = [self._owner.joint_names[j] for j, a in zip(joints, ids, strict=True) if a < 0]
            raise ValueError(
                f"{self._owner.uid}: joints {names} have no drive (drive_type none, or they mimic "
                "another joint); set their position with target=False"
            )
        return ids

    def write_target_qpos(
        self, target: F64, joints: NDArray[np.int64], columns: Any, ids: EnvIndex | None
    ) -> None:
        """Set position targets (n, k), clamped to the joints' limits.

        Args:
            target: (n, k) finite values.
            joints: (k,) joint indices.
            columns: Their columns in ``ctrl``.
            ids: (n,) environments, or None for all.
        """
        bounds = self._bounds.get(key := joints.tobytes())
        if bounds is None:
            low, high = self._limits[joints].T.copy()
            bounds = self._bounds[key] = (low, high)
        # np.minimum/maximum, not np.clip: half the cost on small arrays.
        clamped = np.maximum(target, bounds[0])
        np.minimum(clamped, bounds[1], out=clamped)
        if self.has_velocity_target:
            clamped = clamped + self._lead((slice(None) if ids is None else ids[:, None], joints))
        self._owner.engine.write("ctrl", clamped, ids, columns)

    def _lead(self, where: Any) -> F64:
        stiffness = self.stiffness[where]
        gain = np.divide(
            self.damping[where], stiffness, out=np.zeros_like(stiffness), where=stiffness > 0
        )
        lead: F64 = gain * self.target_qvel[where]
        return lead

    def read_target_qpos(self) -> F64:
        """(N, D) position targets; the joint's position where there is no drive."""
        owner = self._owner
        actuators = np.asarray(owner.entity.actuator_ids, np.int64)
        driven = actuators >= 0
        out = owner.read_qpos().copy()
        out[:, driven] = owner.engine.state("ctrl")[:, actuators[driven]]
        if self.has_velocity_target:
            out[:, driven] -= self._lead((slice(None), np.flatnonzero(driven)))
        return out

    def write_target_qvel(
        self, target: F64, joints: NDArray[np.int64], ids: EnvIndex | None
    ) -> None:
        """Set velocity targets (n, k) and fold them into the control."""
        columns = self._actuators(joints)
        rows = np.arange(self._owner.num_instances) if ids is None else ids
        position = self.read_target_qpos()[rows[:, None], joints]
        self.target_qvel[rows[:, None], joints] = target
        self.has_velocity_target = bool(self.target_qvel.any())
        lead = self._lead((rows[:, None], joints))
        self._owner.engine.write("ctrl", position + lead, ids, columns)

    def clear(self, ids: EnvIndex | None) -> None:
        """Forget velocity targets, as a reset does."""
        if self.has_velocity_target:
            self.target_qvel[slice(None) if ids is None else ids] = 0.0
            self.has_velocity_target = bool(self.target_qvel.any())

    def set(
        self, ids: EnvIndex | None, rows: int, joints: NDArray[np.int64], **values: Any
    ) -> None:
        """Set gains per environment; each value is (n, k) or None.

        Raises:
            ValueError: If a shape is wrong or a value is negative.
        """
        owner = self._owner
        where = (slice(None) if ids is None else ids[:, None], joints)
        for name, value in values.items():
            if value is None:
                continue
            array = as_rows(value, rows, len(joints), f"{owner.uid}: {name}", finite=False)
            if not (array >= 0).all():
                raise ValueError(f"{owner.uid}: {name} must not be negative or NaN")
            getattr(self, name)[where] = array
            self._apply(name, array, ids, joints)
        if values.get("armature") is not None:
            owner.engine.set_const(ids)

    def _apply(
        self, name: str, value: F64, ids: EnvIndex | None, joints: NDArray[np.int64]
    ) -> None:
        engine, entity = self._owner.engine, self._owner.entity
        dofs = np.asarray(entity.dof_adr, np.int64)[joints]
        if name in ("damping", "friction", "armature"):
            field = {"friction": "dof_frictionloss"}.get(name, f"dof_{name}")
            engine.write_model(field, value, ids, dofs)
        elif name == "stiffness":
            actuators = self._actuators(joints)
            gains = engine.model.actuator_gainprm.shape[1]
            bias = engine.model.actuator_biasprm.shape[1]
            engine.write_model("actuator_gainprm", value, ids, actuators * gains)
            engine.write_model("actuator_biasprm", -value, ids, actuators * bias + 1)
        elif name == "max_effort":
            actuators = self._actuators(joints)
            limited = value < NO_LIMIT
            finite = np.where(limited, value, 0.0)
            engine.write_model("actuator_forcelimited", limited.astype(np.float64), ids, actuators)
            engine.write_model("actuator_forcerange", -finite, ids, 2 * actuators)
            engine.write_model("actuator_forcerange", finite, ids, 2 * actuators + 1)
        # max_velocity is only remembered: MuJoCo has no velocity limit.

    def state_dict(self) -> dict[str, F64]:
        """Targets and gains (copies)."""
        names = ("stiffness", "damping", "max_effort", "max_velocity", "friction", "armature")
        return {n: getattr(self, n).copy() for n in (*names, "target_qvel")}

    def load_state_dict(self, state: dict[str, F64]) -> None:
        """Continue exactly where `state_dict` was taken; the engine restores model fields."""
        for name, values in state.items():
            getattr(self, name)[...] = values
        self.has_velocity_target = bool(self.target_qvel.any())
