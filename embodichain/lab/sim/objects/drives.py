"""`Drives`: the PD drives of an articulation - gains per environment and targets.

A drive is one actuator, whose force is ``clip(kp (target - q) - kd qvel, -effort, effort)``. A
velocity target adds ``kd target_qvel`` and enters the control as ``target + (kd / kp)
target_qvel``. Without stiffness the control is the velocity target itself.
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
    "joint_damping": "dof_damping",
    "friction": "dof_frictionloss",
    "armature": "dof_armature",
}
_GAINS = ("stiffness", "damping", "max_effort", "max_velocity", "friction", "armature")
_SAVED = (*_GAINS, "joint_damping", "strength", "target_qvel")


class Drives:
    """Gains and targets of D joints in N environments.

    Attributes:
        stiffness, damping, max_effort, max_velocity, friction, armature: (N, D) current values; the
            damping of a joint without a drive is its own.
        joint_damping: (N, D) passive damping of the joints.
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
        self.joint_damping: F64 = np.tile(np.asarray(parsed.joint_damping, np.float64), (count, 1))
        self.target_qvel: F64 = np.zeros((count, len(parsed.joint_names)))
        self.has_velocity_target = False
        self._springless = False
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
        if self._mixes:
            rows = slice(None) if ids is None else ids[:, None]
            clamped = self._control(clamped, (rows, joints))
        self._owner.engine.write("ctrl", clamped, ids, columns)

    @property
    def _mixes(self) -> bool:
        """Whether a control is something else than the position target."""
        return self.has_velocity_target or self._springless

    def _control(self, target: F64, where: Any) -> F64:
        """Controls of position targets (n, k) and of the velocity targets there."""
        stiffness, velocity = self.stiffness[where], self.target_qvel[where]
        ratio = np.divide(
            self.damping[where], stiffness, out=np.zeros_like(stiffness), where=stiffness > 0
        )
        control: F64 = np.where(stiffness > 0, target + ratio * velocity, velocity)
        return control

    def read_target_qpos(self) -> F64:
        """(N, D) position targets; the joint's position where nothing holds a position."""
        owner = self._owner
        actuators = np.asarray(owner.entity.actuator_ids, np.int64)
        driven = np.flatnonzero(actuators >= 0)
        out = owner.read_qpos().copy()
        control = owner.engine.state("ctrl")[:, actuators[driven]]
        if self._mixes:
            where = (slice(None), driven)
            lead = self._control(np.zeros_like(control), where)
            control = np.where(self.stiffness[where] > 0, control - lead, out[where])
        out[:, driven] = control
        return out

    def within_rate(
        self, target: F64, joints: NDArray[np.int64], seconds: float, ids: EnvIndex | None = None
    ) -> F64:
        """Position targets (n, k) as far as `max_velocity` lets them move in some time.

        Args:
            target: (n, k) wanted.
            joints: (k,) joint indices.
            seconds: Since the last target; they start from the targets now.
            ids: (n,) environments, or None for all.
        """
        rows = slice(None) if ids is None else ids[:, None]
        reach = self.max_velocity[rows, joints] * seconds
        if (reach >= NO_LIMIT * seconds).all():
            return target
        now = self.read_target_qpos()[rows, joints]
        return np.minimum(np.maximum(target, now - reach), now + reach)

    def write_target_qvel(
        self, target: F64, joints: NDArray[np.int64], ids: EnvIndex | None
    ) -> None:
        """Set velocity targets (n, k) and fold them into the control."""
        columns = self._actuators(joints)
        rows = np.arange(self._owner.num_instances) if ids is None else ids
        where = (rows[:, None], joints)
        position = self.read_target_qpos()[where]
        self.target_qvel[where] = target
        self.has_velocity_target = bool(self.target_qvel.any())
        self._owner.engine.write("ctrl", self._control(position, where), ids, columns)

    def clear(self, ids: EnvIndex | None) -> None:
        """Forget velocity targets, as a reset does, which has set the controls as compiled."""
        self._forget_velocities(ids)
        compiled = np.asarray(self._owner.parsed.stiffness, np.float64)
        driven = np.asarray(self._owner.entity.actuator_ids, np.int64) >= 0
        changed = np.flatnonzero((((self.stiffness > 0) != (compiled > 0)) & driven).any(axis=0))
        if len(changed):  # position drives that events or users made velocity drives, or back
            rows = np.arange(self._owner.num_instances) if ids is None else ids
            home = np.asarray(self._owner.parsed.init_qpos, np.float64)[changed]
            target = np.tile(home, (len(rows), 1))
            columns = self._actuators(changed)
            self._owner.engine.write(
                "ctrl", self._control(target, (rows[:, None], changed)), ids, columns
            )

    def _forget_velocities(self, ids: EnvIndex | None) -> None:
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
        owner = self._owner
        engine, entity = owner.engine, owner.entity
        driven = np.asarray(entity.actuator_ids, np.int64)[joints] >= 0
        if name == "damping" and not driven.all():
            # What a joint without a drive has is its own damping.
            self.put("joint_damping", values[:, ~driven], ids, joints[~driven])
            joints, values = joints[driven], values[:, driven]
            if not len(joints):
                return
        rows = slice(None) if ids is None else ids[:, None]
        where = (rows, joints)
        getattr(self, name)[where] = values
        if name in _JOINT_FIELDS:
            dofs = np.asarray(entity.dof_adr, np.int64)[joints]
            engine.write_model(_JOINT_FIELDS[name], values, ids, columns_of(dofs))
            if name == "armature":
                engine.set_const_later(ids)
            elif name == "joint_damping" and not driven.all():
                self.damping[rows, joints[~driven]] = values[:, ~driven]
        elif name == "max_velocity":
            return  # for actions: MuJoCo has no velocity limit
        else:
            actuators = self._actuators(joints)
            if name != "max_effort":
                self._springless = self._has_springless()
                self._write_gains(actuators, where, ids)
            if name in ("max_effort", "strength"):
                self._write_efforts(actuators, where, ids)

    def bind(self) -> None:
        """Learn which joints have a drive; the owner knows its place in the model."""
        self._springless = self._has_springless()

    def _has_springless(self) -> bool:
        """Whether a drive has no stiffness: its control is a velocity target."""
        driven = np.asarray(self._owner.entity.actuator_ids, np.int64) >= 0
        return bool((self.stiffness[:, driven] == 0).any())

    def _write_gains(self, actuators: NDArray[np.int64], where: Any, ids: EnvIndex | None) -> None:
        engine = self._owner.engine
        gains = engine.model.actuator_gainprm.shape[1]
        bias = engine.model.actuator_biasprm.shape[1]
        spring = self.stiffness[where] * self.strength[where]
        damper = self.damping[where] * self.strength[where]
        gain = np.where(spring > 0, spring, damper)
        engine.write_model("actuator_gainprm", gain, ids, columns_of(actuators * gains))
        for column, value in ((1, spring), (2, damper)):
            engine.write_model(
                "actuator_biasprm", -value, ids, columns_of(actuators * bias + column)
            )

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
        bias = model.actuator_biasprm.shape[1] * actuators
        springs = np.asarray(parsed.stiffness, np.float64)[driven]
        dampers = np.asarray(parsed.damping, np.float64)[driven]
        most = np.asarray(parsed.max_effort, np.float64)[driven]
        stiffness = np.abs(changed("actuator_biasprm", bias + 1, springs))
        damping = np.abs(changed("actuator_biasprm", bias + 2, dampers))
        effort = changed("actuator_forcerange", 2 * actuators + 1, most)
        limited = changed("actuator_forcelimited", actuators, -1.0)
        effort = np.where(limited == 0, _NO_EFFORT_LIMIT, effort)
        scale = np.divide(
            effort, most, out=np.ones_like(most), where=(most > 0) & (most < NO_LIMIT)
        )
        alike = np.ones_like(scale, np.bool_)
        for now, declared in ((stiffness, springs), (damping, dampers)):
            factor = np.divide(now, declared, out=scale.copy(), where=declared > 0)
            alike &= np.isclose(scale, factor, rtol=1e-9, atol=0.0)
        for name, values in (
            ("strength", np.where(alike, scale, 1.0)),
            ("stiffness", np.where(alike, springs, stiffness)),
            ("damping", np.where(alike, dampers, damping)),
            ("max_effort", np.where(alike, most, effort)),
        ):
            columns = getattr(self, name)[where]
            columns[:, driven] = values
            getattr(self, name)[where] = columns
        undriven = np.flatnonzero(np.asarray(entity.actuator_ids, np.int64) < 0)
        own = self.damping[where]
        own[:, undriven] = self.joint_damping[where][:, undriven]
        self.damping[where] = own
        self._limits_vary = True
        self._springless = self._has_springless()
        self._forget_velocities(ids)

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
        self._springless = self._has_springless()
        self.has_velocity_target = bool(self.target_qvel.any())
