"""`Drives`: the PD drives of an articulation - gains per environment and targets.

The compiler puts the stiffness into an actuator and the damping into the joint (implicit), so a
drive's force is ``kp (target - q) - kd qvel`` and a velocity target adds ``kd target_qvel``, which
enters the control as ``target + (kd / kp) target_qvel``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.objects._arrays import as_rows, columns_of
from embodichain.lab.sim.objects.joint_limits import JointLimits

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.base import F64, EnvIndex
    from embodichain.lab.sim.objects.articulation import Articulation

__all__ = ["Drives"]

NO_LIMIT = 1e9
"""Efforts at least this large count as unlimited (EmbodiChain's default is 1e10)."""
_NO_EFFORT_LIMIT = 1e10
_JOINT_FIELDS = {
    "damping": "dof_damping",
    "friction": "dof_frictionloss",
    "armature": "dof_armature",
}
_GAINS = ("stiffness", "damping", "max_effort", "max_velocity", "friction", "armature")
_SAVED = (*_GAINS, "strength", "target_qvel")


class Drives:
    """Gains and targets of D joints in N environments.

    Attributes:
        stiffness, damping, max_effort, max_velocity, friction, armature: (N, D) current values.
        strength: (N, D) factors of what the drives' springs and effort limits yield.
        limits: Joint position limits.
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
        self._limits_vary = False
        self.strength: F64 = np.ones((count, len(parsed.joint_names)))
        self.limits = JointLimits(np.asarray(parsed.qpos_limits, np.float64), count)

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
        low, high = self.limits.of_all(joints) if ids is None else self.limits.of(joints, ids)
        # np.minimum/maximum, not np.clip: half the cost on small arrays; so are arrays of one type.
        clamped = np.maximum(np.asarray(target, np.float64), low)
        np.minimum(clamped, high, out=clamped)
        if self.has_velocity_target:
            clamped = clamped + self._lead((slice(None) if ids is None else ids[:, None], joints))
        self._owner.engine.write("ctrl", clamped, ids, columns)

    def _lead(self, where: Any) -> F64:
        stiffness = self.stiffness[where] * self.strength[where]
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
        for name, value in values.items():
            if value is None:
                continue
            array = as_rows(value, rows, len(joints), f"{owner.uid}: {name}", finite=False)
            if not (array >= 0).all():
                raise ValueError(f"{owner.uid}: {name} must not be negative or NaN")
            self.put(name, array, ids, joints)

    def put(self, name: str, values: F64, ids: EnvIndex | None, joints: NDArray[np.int64]) -> None:
        """Set one property (n, k) from checked arrays: the door for terms.

        Args:
            name: An attribute of this class: ``stiffness``, ``friction``...
            values: Not negative; `max_effort` from `NO_LIMIT` on is none.
            ids: (n,) environments, or None for all.
            joints: (k,) joint indices.
        """
        where = (slice(None) if ids is None else ids[:, None], joints)
        getattr(self, name)[where] = values
        engine, entity = self._owner.engine, self._owner.entity
        if name in _JOINT_FIELDS:
            dofs = np.asarray(entity.dof_adr, np.int64)[joints]
            engine.write_model(_JOINT_FIELDS[name], values, ids, columns_of(dofs))
            if name == "armature":
                engine.set_const_later(ids)
        elif name == "max_velocity":
            return  # only remembered: MuJoCo has no velocity limit
        else:
            actuators = self._actuators(joints)
            if name != "max_effort":
                self._write_gains(actuators, where, ids)
            if name != "stiffness":
                self._write_efforts(actuators, where, ids)

    def _write_gains(self, actuators: NDArray[np.int64], where: Any, ids: EnvIndex | None) -> None:
        engine = self._owner.engine
        gains = engine.model.actuator_gainprm.shape[1]
        bias = engine.model.actuator_biasprm.shape[1]
        spring = self.stiffness[where] * self.strength[where]
        engine.write_model("actuator_gainprm", spring, ids, columns_of(actuators * gains))
        engine.write_model("actuator_biasprm", -spring, ids, columns_of(actuators * bias + 1))

    def _write_efforts(
        self, actuators: NDArray[np.int64], where: Any, ids: EnvIndex | None
    ) -> None:
        engine = self._owner.engine
        limit = self.max_effort[where]
        limited = limit < NO_LIMIT
        compiled = engine.model.actuator_forcelimited[actuators] != 0
        if (limited != compiled).any():
            self._limits_vary = True  # who is limited differs between environments
        if self._limits_vary:
            flags = limited.astype(np.float64)
            engine.write_model("actuator_forcelimited", flags, ids, columns_of(actuators))
        elif not compiled.any():
            return
        finite = np.where(limited, limit * self.strength[where], 0.0)
        engine.write_model("actuator_forcerange", -finite, ids, columns_of(2 * actuators))
        engine.write_model("actuator_forcerange", finite, ids, columns_of(2 * actuators + 1))

    def put_limit(
        self,
        side: Literal[0, 1],
        values: F64,
        ids: EnvIndex | None,
        joints: NDArray[np.int64],
    ) -> None:
        """Set lower (0) or upper (1) position limits (n, k) of joints that have limits."""
        engine, entity = self._owner.engine, self._owner.entity
        self.limits.set(side, values, joints, ids)
        model_joints = engine.model.dof_jntid[np.asarray(entity.dof_adr, np.int64)[joints]]
        columns = columns_of(2 * model_joints.astype(np.int64) + side)
        engine.write_model("jnt_range", values, ids, columns)

    def take_over(self, ids: EnvIndex | None, fields: Mapping[str, NDArray[Any]]) -> None:
        """Read gains and limits out of a model that environments were given; no targets.

        The model holds products: where stiffness and effort limit are scaled alike, or only a limit
        is there, strength is what scaled them; else it is taken as 1.

        Args:
            ids: (n,) environments, or None for all.
            fields: Model fields, (size,) each, of all these environments; absent ones are as
                compiled.
        """
        where: Any = slice(None) if ids is None else ids
        owner, parsed = self._owner, self._owner.parsed
        model, entity = owner.engine.model, owner.entity

        def changed(name: str, columns: NDArray[np.int64], declared: Any) -> F64:
            compiled = np.asarray(getattr(model, name), np.float64).reshape(-1)[columns]
            given = np.asarray(fields.get(name, compiled), np.float64)
            now = given if name not in fields else given.reshape(-1)[columns]
            return np.where(now == compiled, np.asarray(declared, np.float64), now)

        dofs = np.asarray(entity.dof_adr, np.int64)
        for name, field in _JOINT_FIELDS.items():
            getattr(self, name)[where] = changed(field, dofs, getattr(parsed, name))
        joints = model.dof_jntid[dofs].astype(np.int64)
        for side in (0, 1):
            limits = changed("jnt_range", 2 * joints + side, parsed.qpos_limits[:, side])
            if ids is not None or not np.array_equal(limits, self.limits.compiled[:, side]):
                rows = np.arange(owner.num_instances) if ids is None else ids
                self.limits.set(side, limits, np.arange(len(joints)), rows)
        actuators = np.asarray(entity.actuator_ids, np.int64)
        driven = np.flatnonzero(actuators >= 0)
        actuators = actuators[driven]
        gains = model.actuator_gainprm.shape[1]
        declared = np.asarray(parsed.stiffness, np.float64)[driven]
        most = np.asarray(parsed.max_effort, np.float64)[driven]
        stiffness = changed("actuator_gainprm", gains * actuators, declared)
        effort = changed("actuator_forcerange", 2 * actuators + 1, most)
        limited = changed("actuator_forcelimited", actuators, -1.0)
        effort = np.where(limited == 0, _NO_EFFORT_LIMIT, effort)
        scale = np.divide(
            effort, most, out=np.ones_like(most), where=(most > 0) & (most < NO_LIMIT)
        )
        spring = np.divide(stiffness, declared, out=scale.copy(), where=declared > 0)
        alike = np.isclose(scale, spring, rtol=1e-9, atol=0.0)
        for name, values in (
            ("strength", np.where(alike, scale, 1.0)),
            ("stiffness", np.where(alike, declared, stiffness)),
            ("max_effort", np.where(alike, most, effort)),
        ):
            columns = getattr(self, name)[where]
            columns[:, driven] = values
            getattr(self, name)[where] = columns
        self._limits_vary = True
        self.clear(ids)

    def state_dict(self) -> dict[str, F64]:
        """Targets and gains (copies)."""
        saved = {name: getattr(self, name).copy() for name in _SAVED}
        return {**saved, "limits": self.limits.values.copy()}

    def load_state_dict(self, state: dict[str, F64]) -> None:
        """Continue exactly where `state_dict` was taken; the engine restores model fields."""
        for name in _SAVED:
            getattr(self, name)[...] = state[name]
        self.limits.restore(state["limits"])
        self._limits_vary = True
        self.has_velocity_target = bool(self.target_qvel.any())
