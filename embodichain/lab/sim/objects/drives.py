"""`Drives` and `ActuatorControls`: gains and targets of PD drives, joint limits, controls.

A drive is one actuator, whose force is ``clip(kp (target - q) - kd qvel, -effort, effort)``: what
`drive_pros` adds, or a servo of the file (in units of its own: see `Transmission`). A velocity
target adds ``kd target_qvel`` and enters the control as ``target + (kd / kp) target_qvel``. Without
stiffness the control is the velocity target itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drive_cfg import NO_LIMIT
from embodichain.lab.sim.objects._arrays import as_rows, columns_of
from embodichain.lab.sim.objects.drive_units import ModelGains, Transmission
from embodichain.lab.sim.objects.joint_state import JointLimits, JointState

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.articulation import ParsedArticulation
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.base import F64, EnvIndex
    from embodichain.lab.sim.host import Binding

__all__ = ["ActuatorControls", "Drives"]


_JOINT_FIELDS = {
    "joint_damping": "dof_damping",
    "friction": "dof_frictionloss",
    "armature": "dof_armature",
}
_GAINS = ("stiffness", "damping", "max_effort", "max_velocity", "friction", "armature")
_SAVED = (*_GAINS, "joint_damping", "strength", "target_qvel")


class Drives:
    """Gains and targets of D joints in N environments.

    Args:
        binding: The articulation's place in the simulation.
        parsed: Its compiled gains and limits.
        joints: Its joints.

    Attributes:
        stiffness, damping, max_effort, max_velocity, friction, armature: (N, D) current values; the
            damping of a joint without a drive is its own.
        joint_damping: (N, D) passive damping of the joints.
        strength: (N, D) factors of what the drives' springs and effort limits yield.
        limits: Joint position limits.
        target_qvel: (N, D) velocity targets.
    """

    def __init__(
        self, binding: Binding[EntityIndex], parsed: ParsedArticulation, joints: JointState
    ) -> None:
        count, width = binding.num_envs, len(parsed.joint_names)
        self.parsed = parsed
        self._binding = binding
        self._joints = joints

        def tiled(values: F64) -> F64:
            return np.tile(np.asarray(values, np.float64), (count, 1))

        self.stiffness: F64 = tiled(parsed.stiffness)
        self.damping: F64 = tiled(parsed.damping)
        self.max_effort: F64 = tiled(parsed.max_effort)
        self.max_velocity: F64 = tiled(parsed.max_velocity)
        self.friction: F64 = tiled(parsed.friction)
        self.armature: F64 = tiled(parsed.armature)
        self.joint_damping: F64 = tiled(parsed.joint_damping)
        self.strength: F64 = np.ones((count, width))
        self.target_qvel: F64 = np.zeros((count, width))
        self.has_velocity_target = False
        self._springless = False
        self._limits_vary = False
        self._transmission = Transmission(parsed.servos)
        self.limits = JointLimits(np.asarray(parsed.qpos_limits, np.float64), count)

    def _actuators(self, joints: NDArray[np.int64]) -> NDArray[np.int64]:
        ids: NDArray[np.int64] = np.asarray(self._binding.index.actuator_ids, np.int64)[joints]
        if (ids < 0).any():
            names = [self.parsed.joint_names[j] for j, a in zip(joints, ids, strict=True) if a < 0]
            raise ValueError(
                f"{self._binding.uid}: joints {names} have no drive (drive_type none, mimics of "
                "others, or without a servo in their file); set their position with target=False"
            )
        return ids

    def columns(self, joints: NDArray[np.int64]) -> NDArray[np.int64]:
        """(k,) columns in ``ctrl`` of the drives of joints; ValueError where there is none."""
        self._actuators(joints)
        found: NDArray[np.int64] = np.asarray(self._binding.index.ctrl_ids, np.int64)[joints]
        return found

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
        clamped = self.limits.clamp(np.asarray(target, np.float64), joints, ids)
        if self._mixes:
            rows = slice(None) if ids is None else ids[:, None]
            clamped = self._control(clamped, (rows, joints))
        self._binding.engine.write("ctrl", clamped, ids, columns)
        if self.has_velocity_target:
            self._write_velocity_servos(joints, ids)

    @property
    def _mixes(self) -> bool:
        """Whether a control is something else than the position target."""
        return self.has_velocity_target or self._springless or self._transmission.scales

    def _control(self, target: F64, where: Any) -> F64:
        """Controls of position targets (n, k) and of the velocity targets there."""
        return self._transmission.control(self._mixed(target, where), where[1])

    def _mixed(self, target: F64, where: Any) -> F64:
        """The same, as if the actuator were the joint itself."""
        stiffness, velocity = self.stiffness[where], self.target_qvel[where]
        ratio = np.divide(
            self.damping[where], stiffness, out=np.zeros_like(stiffness), where=stiffness > 0
        )
        control: F64 = np.where(stiffness > 0, target + ratio * velocity, velocity)
        return control

    def read_target_qpos(self) -> F64:
        """(N, D) position targets; the joint's position where nothing holds a position."""
        columns = np.asarray(self._binding.index.ctrl_ids, np.int64)
        driven = np.flatnonzero(columns >= 0)
        out = self._joints.qpos().copy()
        control = self._binding.engine.state("ctrl")[:, columns[driven]]
        if self._mixes:
            where = (slice(None), driven)
            control = self._transmission.target(control, driven)
            lead = self._mixed(np.zeros_like(control), where)
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
        if self.max_velocity.min(initial=NO_LIMIT) >= NO_LIMIT:
            return target
        rows = slice(None) if ids is None else ids[:, None]
        reach = self.max_velocity[rows, joints] * seconds
        now = self.read_target_qpos()[rows, joints]
        return np.minimum(np.maximum(target, now - reach), now + reach)

    def write_target_qvel(
        self, target: F64, joints: NDArray[np.int64], ids: EnvIndex | None
    ) -> None:
        """Set velocity targets (n, k) and fold them into the control."""
        columns = self.columns(joints)
        rows = np.arange(self._binding.num_envs) if ids is None else ids
        where = (rows[:, None], joints)
        position = self.read_target_qpos()[where]
        self.target_qvel[where] = target
        self.has_velocity_target = bool(self.target_qvel.any())
        self._binding.engine.write("ctrl", self._control(position, where), ids, columns)
        self._write_velocity_servos(joints, ids)

    def _write_velocity_servos(self, joints: NDArray[np.int64], ids: EnvIndex | None) -> None:
        """Give velocity servos beside position servos their targets."""
        columns = np.asarray(self._binding.index.velocity_ctrl_ids, np.int64)[joints]
        if not (columns >= 0).any():
            return
        joints = joints[columns >= 0]
        target = self.target_qvel[slice(None) if ids is None else ids][:, joints]
        scale = self.parsed.servos.velocity_scale[joints]
        self._binding.engine.write("ctrl", target * scale, ids, columns[columns >= 0])

    def take_targets(
        self,
        control: F64,
        joints: NDArray[np.int64],
        ids: EnvIndex | None,
        seconds: float | None = None,
    ) -> F64:
        """Return controls (n, k) of drives as they are written, and take them for the targets.

        Position targets of drives that are not the file's are clamped to the joints' limits.

        Args:
            control: In the actuators' units.
            joints: (k,) joint indices.
            ids: (n,) environments, or None for all.
            seconds: If given, targets keep to `max_velocity` (see `within_rate`).
        """
        where = (slice(None) if ids is None else ids[:, None], joints)
        stiff = self.stiffness[where] > 0
        target = asked = self._transmission.target(control, joints)
        if seconds is not None:
            most = self.max_velocity[where]
            slow = self.within_rate(target, joints, seconds, ids)
            target = np.where(stiff, slow, np.minimum(np.maximum(target, -most), most))
        if self._mixes:
            self.target_qvel[where] = np.where(stiff, 0.0, target)
            self.has_velocity_target = bool(self.target_qvel.any())
        clamped = self.limits.clamp(target, joints, ids)
        target = np.where(stiff & self.parsed.driven[joints], clamped, target)
        # What is not changed is written as it was given, to the bit.
        return np.where(target == asked, control, self._transmission.control(target, joints))

    def clear(self, ids: EnvIndex | None) -> None:
        """Forget velocity targets, as a reset does, which has set the controls as compiled."""
        self._forget_velocities(ids)
        compiled = np.asarray(self.parsed.stiffness, np.float64)
        driven = np.asarray(self._binding.index.actuator_ids, np.int64) >= 0
        changed = np.flatnonzero((((self.stiffness > 0) != (compiled > 0)) & driven).any(axis=0))
        if len(changed):  # position drives that events or users made velocity drives, or back
            rows = np.arange(self._binding.num_envs) if ids is None else ids
            home = np.asarray(self.parsed.init_qpos, np.float64)[changed]
            target = np.tile(home, (len(rows), 1))
            columns = self.columns(changed)
            self._binding.engine.write(
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
        uid = self._binding.uid
        for name, value in values.items():
            if value is None:
                continue
            array = as_rows(value, rows, len(joints), f"{uid}: {name}", finite=False)
            if not (array >= 0).all():
                raise ValueError(f"{uid}: {name} must not be negative or NaN")
            self.put(name, array, ids, joints)

    def put(self, name: str, values: F64, ids: EnvIndex | None, joints: NDArray[np.int64]) -> None:
        """Set one property (n, k) from checked arrays.

        Args:
            name: An attribute of this class: ``stiffness``, ``friction``...
            values: Not negative; `max_effort` from `NO_LIMIT` on is none.
            ids: (n,) environments, or None for all.
            joints: (k,) joint indices.
        """
        engine, entity = self._binding.engine, self._binding.index
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
        """Look up which joints have a drive; called once the scene is compiled."""
        self._springless = self._has_springless()

    def _has_springless(self) -> bool:
        """Whether a drive has no stiffness: its control is a velocity target."""
        driven = np.asarray(self._binding.index.actuator_ids, np.int64) >= 0
        return bool((self.stiffness[:, driven] == 0).any())

    def _write_gains(self, actuators: NDArray[np.int64], where: Any, ids: EnvIndex | None) -> None:
        engine = self._binding.engine
        gains = engine.model.actuator_gainprm.shape[1]
        bias = engine.model.actuator_biasprm.shape[1]
        spring = self.stiffness[where] * self.strength[where]
        damper = self.damping[where] * self.strength[where]
        gain = self._transmission.gain(np.where(spring > 0, spring, damper), where[1])
        engine.write_model("actuator_gainprm", gain, ids, columns_of(actuators * gains))
        for column, value in ((1, spring), (2, damper)):
            engine.write_model(
                "actuator_biasprm",
                -self._transmission.feedback(value, where[1]),
                ids,
                columns_of(actuators * bias + column),
            )

    def _write_efforts(
        self, actuators: NDArray[np.int64], where: Any, ids: EnvIndex | None
    ) -> None:
        engine = self._binding.engine
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
        for side, bound in enumerate(self._transmission.force_range(finite, where[1])):
            engine.write_model("actuator_forcerange", bound, ids, columns_of(2 * actuators + side))

    def put_limit(
        self,
        side: Literal[0, 1],
        values: F64,
        ids: EnvIndex | None,
        joints: NDArray[np.int64],
    ) -> None:
        """Set lower (0) or upper (1) position limits (n, k) of joints that have limits."""
        engine, entity = self._binding.engine, self._binding.index
        self.limits.set(side, values, joints, ids)
        model_joints = engine.model.dof_jntid[np.asarray(entity.dof_adr, np.int64)[joints]]
        columns = columns_of(2 * model_joints.astype(np.int64) + side)
        engine.write_model("jnt_range", values, ids, columns)

    def take_over(self, ids: EnvIndex | None, fields: Mapping[str, NDArray[Any]]) -> None:
        """Read gains and limits out of a model that environments were given; no targets.

        Args:
            ids: (n,) environments, or None for all.
            fields: Model fields, (size,) each, of all these environments; absent ones are as
                compiled.
        """
        where: Any = slice(None) if ids is None else ids
        parsed = self.parsed
        model, entity = self._binding.engine.model, self._binding.index
        given = ModelGains(model, fields)
        dofs = np.asarray(entity.dof_adr, np.int64)
        for name, field in _JOINT_FIELDS.items():
            getattr(self, name)[where] = given.read(field, dofs, getattr(parsed, name))
        joints = model.dof_jntid[dofs].astype(np.int64)
        for side in (0, 1):
            limits = given.read("jnt_range", 2 * joints + side, parsed.qpos_limits[:, side])
            if ids is not None or not np.array_equal(limits, self.limits.compiled[:, side]):
                rows = np.arange(self._binding.num_envs) if ids is None else ids
                self.limits.set(side, limits, np.arange(len(joints)), rows)
        actuators = np.asarray(entity.actuator_ids, np.int64)
        driven = np.flatnonzero(actuators >= 0)
        gains = given.drives(parsed, self._transmission, actuators[driven], driven)
        for name, values in gains.items():
            columns = getattr(self, name)[where]
            columns[:, driven] = values
            getattr(self, name)[where] = columns
        undriven = np.flatnonzero(actuators < 0)
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
