"""`Drives`: gains and targets of an articulation's PD drives, and its joints' limits.

A drive is an actuator with force ``clip(kp (target - q) - kd qvel, -effort, effort)``: one that
`drive_pros` adds, or a servo of the file. A velocity target adds ``kd target_qvel``: the control is
``target + (kd / kp) target_qvel``. Without stiffness the control is the velocity target itself.

A servo of an MJCF file has a gear, ``length = gear * q``, and its control may differ in units
from its length: ``ctrl = scale * target``. With the joint's stiffness k, damping d and control gain
g (``force = g * target - k * q - d * qvel``), the actuator's values are ``k / gear**2``,
``d / gear**2`` and ``g / (gear * scale)``. Drives of `drive_pros` have gear and scale 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.configs.drive_cfg import NO_LIMIT
from embodichain.utils.arrays import columns_of, field_values, is_host
from embodichain.utils.short_repr import short_repr

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
    from embodichain.lab.sim.engine.api import Columns, EnvIndex
    from embodichain.lab.sim.objects.entity import Handle
    from embodichain.utils.array_types import Floats
    from embodichain.utils.arrays import Arrays

__all__ = ["GAINS", "Drives", "JointLimits"]

Joints = NDArray[np.int64]

GAINS = ("stiffness", "damping", "max_effort", "max_velocity", "friction", "armature")
"""Properties of a drive and its joint that can be set."""
_JOINT_FIELDS = {
    "joint_damping": "dof_damping",
    "friction": "dof_frictionloss",
    "armature": "dof_armature",
}
_SAVED = (*GAINS, "joint_damping", "strength", "target_qvel", "cut_effort", "encoder_bias")


class JointLimits:
    """Position limits of D joints in N environments, rad or m; infinite where there are none.

    Args:
        limits: (D, 2) initial lower and upper limits of all environments.
        count: N.
        arrays: Makes the arrays.
    """

    def __init__(self, limits: Floats, count: int, arrays: Arrays) -> None:
        self._sides = tuple(arrays.put(np.tile(side, (count, 1))) for side in limits.T)

    @property
    def values(self) -> Floats:
        """(N, D, 2) copies."""
        return np.stack(self._sides, axis=-1)

    def of(self, joints: Joints, ids: EnvIndex | None) -> tuple[Floats, Floats]:
        """Lower and upper limits (n, k) of joints in environments; do not write."""
        where = (slice(None), columns_of(joints)) if ids is None else (ids[:, None], joints)
        low, high = self._sides
        return low[where], high[where]

    def clamp(self, values: Floats, joints: Joints, ids: EnvIndex | None) -> Floats:
        """Return positions (n, k) of joints, clamped to their limits."""
        low, high = self.of(joints, ids)
        return np.minimum(np.maximum(values, low), high)

    def set(
        self, side: Literal[0, 1], values: Floats, joints: Joints, ids: EnvIndex | None
    ) -> None:
        """Set lower (0) or upper (1) limits (n, k) of joints in environments."""
        self._sides[side][_at(ids, joints)] = values

    def restore(self, values: Floats) -> None:
        """Set all limits, (N, D, 2)."""
        for side, limits in enumerate(self._sides):
            limits[:] = values[..., side]


class Drives:
    """Gains and targets of D joints in N environments.

    Methods take checked arrays: joints are (k,) indices, ids (n,) environments or None for all N.

    Args:
        handle: The articulation.
        parsed: Its compiled gains and limits.

    Attributes:
        stiffness, damping, max_effort, max_velocity, friction, armature: (N, D) current values;
            `damping` of a joint without a drive is its passive damping.
        joint_damping: (N, D) passive damping of the joints.
        strength: (N, D) factors of the drives' gains and effort limits.
        limits: Joint position limits.
        target_qvel: (N, D) velocity targets.
        encoder_bias: (N, D) what the joints' encoders read minus their positions, rad or m.
        cut_effort: (N, D) what `max_effort` cuts off the efforts that actions ask for, N m or N.
        joints: (k,) joints with a drive; empty before the scene is compiled.
        control_columns: Their columns in ``ctrl``.
    """

    stiffness: Floats
    damping: Floats
    max_effort: Floats
    max_velocity: Floats
    friction: Floats
    armature: Floats
    joint_damping: Floats

    def __init__(self, handle: Handle[EntityIndex], parsed: ParsedArticulation) -> None:
        self.parsed = parsed
        self._handle = handle
        self._arrays = handle.sim.arrays
        count = handle.num_instances
        for name in (*GAINS, "joint_damping"):
            setattr(self, name, self._arrays.put(np.tile(getattr(parsed, name), (count, 1))))
        self.strength: Floats = np.ones_like(self.stiffness)
        self.target_qvel: Floats = np.zeros_like(self.stiffness)
        self.cut_effort: Floats = np.zeros_like(self.stiffness)
        self.encoder_bias: Floats = np.zeros_like(self.stiffness)
        self.limits = JointLimits(parsed.qpos_limits, count, self._arrays)
        self.has_velocity_target = False
        self.joints: Joints = np.arange(0)
        self.control_columns: Columns = slice(0)
        self._columns_of_joints: dict[bytes, Columns] = {}
        # Live views of the limits of `joints`, where these are evenly spaced.
        self._limits_of_drives: tuple[Floats, Floats] | None = None
        self._joint_of_control: Joints = np.arange(0)  # column in ``ctrl`` -> joint, or -1
        # Drives switched between position and velocity control in any environment.
        self._switched: Joints = np.arange(0)
        self._rated = False  # whether a drive has a `max_velocity`
        self._springless = False  # whether a drive has no stiffness: its control is a velocity
        self._limits_vary = False  # whether environments limit efforts of different joints
        self._gear = parsed.servos.gear
        self._scale = parsed.servos.scale
        self._shares = parsed.servos.shares
        self._scaled = bool((self._scale != 1).any())  # whether units of controls differ

    def __repr__(self) -> str:
        """Return the articulation, N, and how many joints there are and are driven."""
        num_envs, num_joints = self.stiffness.shape
        return short_repr(
            self,
            self._handle.uid,
            num_envs=num_envs,
            joints=num_joints,
            driven=len(self.joints),
        )

    def bind(self) -> None:
        """Look up which joints have a drive; called once the scene is compiled."""
        index = self._handle.index
        self.joints = np.flatnonzero(index.ctrl_ids >= 0)
        columns = index.ctrl_ids[self.joints]
        self.control_columns = columns_of(columns)
        self._joint_of_control = np.full(self._handle.engine.state("ctrl").shape[1], -1)
        self._joint_of_control[columns] = self.joints
        if isinstance(columns_of(self.joints), slice) and not self._arrays.on_device:
            self._limits_of_drives = self.limits.of(self.joints, None)
        self._note(self.parsed.stiffness[None], self.parsed.max_velocity[None])

    # -- targets ---------------------------------------------------------------------------------

    def columns(self, joints: Joints) -> Joints:
        """(k,) columns in ``ctrl`` of the drives of joints.

        Raises:
            ValueError: If a joint has no drive; lists those.
        """
        columns = self._handle.index.ctrl_ids[joints]
        if (columns < 0).any():
            names = [self.parsed.joint_names[j] for j in joints[columns < 0]]
            raise ValueError(
                f"{self._handle.uid}: joints {names} have no drive (drive_type none, mimics of "
                "others, or without a servo in their file); set their position with target=False"
            )
        return columns

    def control_columns_of(self, joints: Joints) -> Columns:
        """`columns`, as a slice where they are evenly spaced; looked up once."""
        key = joints.tobytes()
        columns = self._columns_of_joints.get(key)
        if columns is None:
            columns = columns_of(self.columns(joints))
            self._columns_of_joints[key] = columns
        return columns

    def write_target_qpos(
        self, target: Floats, joints: Joints, columns: Columns, ids: EnvIndex | None
    ) -> None:
        """Set finite position targets (n, k), clamped to the limits, in columns of ``ctrl``."""
        if joints is self.joints and ids is None and self._limits_of_drives is not None:
            low, high = self._limits_of_drives
            clamped = np.maximum(target, low)
            np.minimum(clamped, high, out=clamped)
        else:
            clamped = self.limits.clamp(target, joints, ids)
        if self._mixes:
            clamped = self._control(clamped, _at(ids, joints))
        self._handle.engine.write("ctrl", clamped, ids, columns)
        if self.has_velocity_target:
            self._write_velocity_servos(joints, ids)

    @property
    def _mixes(self) -> bool:
        """Whether controls may differ from position targets."""
        return self.has_velocity_target or self._springless or self._scaled

    def _control(self, target: Floats, where: Any) -> Floats:
        """Controls for position targets (n, k) and the current velocity targets."""
        return self._mixed(target, where) * self._scale[where[1]]

    def _mixed(self, target: Floats, where: Any) -> Floats:
        """As `_control`, in units of the joint."""
        stiffness = self.stiffness[where]
        velocity = self.target_qvel[where]
        ratio = np.divide(
            self.damping[where], stiffness, out=np.zeros_like(stiffness), where=stiffness > 0
        )
        return np.where(stiffness > 0, target + ratio * velocity, velocity)

    def read_target_qpos(self) -> Floats:
        """(N, D) position targets; the joint's position where a drive has no stiffness."""
        engine = self._handle.engine
        index = self._handle.index
        driven = self.joints
        target = engine.state("qpos")[:, index.qpos_adr]
        control = engine.state("ctrl")[:, index.ctrl_ids[driven]]
        if self._mixes:
            where = (slice(None), driven)
            control = control / self._scale[driven]
            of_velocity = self._mixed(np.zeros_like(control), where)
            control = np.where(self.stiffness[where] > 0, control - of_velocity, target[where])
        target[:, driven] = control
        return target

    def within_rate(
        self, target: Floats, joints: Joints, seconds: float, ids: EnvIndex | None = None
    ) -> Floats:
        """Limit position targets (n, k) to what `max_velocity` lets them move in a time."""
        if not self._rated:
            return target
        where = _at(ids, joints)
        reach = self.max_velocity[where] * seconds
        present = self.read_target_qpos()[where]
        return np.minimum(np.maximum(target, present - reach), present + reach)

    def write_target_qvel(self, target: Floats, joints: Joints, ids: EnvIndex | None) -> None:
        """Set velocity targets (n, k) and update the controls."""
        columns = self.columns(joints)
        where = _at(ids, joints)
        position = self.read_target_qpos()[where]
        self.target_qvel[where] = target
        self._note_velocities()
        self._handle.engine.write("ctrl", self._control(position, where), ids, columns)
        self._write_velocity_servos(joints, ids)

    def _write_velocity_servos(self, joints: Joints, ids: EnvIndex | None) -> None:
        """Write the targets of velocity servos that act beside position servos."""
        columns = self._handle.index.velocity_ctrl_ids[joints]
        has_servo = columns >= 0
        if not has_servo.any():
            return
        joints = joints[has_servo]
        columns = columns[has_servo]
        target = self.target_qvel[_at(ids, joints)] * self.parsed.servos.velocity_scale[joints]
        self._handle.engine.write("ctrl", target, ids, columns)

    def take_controls(
        self, control: Floats, columns: Joints, ids: EnvIndex | None, seconds: float | None = None
    ) -> Floats:
        """Return controls (n, k) to be written, and store those of drives as their targets.

        Position targets of drives of `drive_pros` are clamped to the joints' limits.

        Args:
            control: In the actuators' units.
            columns: (k,) columns in ``ctrl``.
            ids: The environments.
            seconds: If given, `max_velocity` limits the targets (see `within_rate`).
        """
        drives = np.flatnonzero(self._joint_of_control[columns] >= 0)
        if not len(drives):
            return control
        joints = self._joint_of_control[columns[drives]]
        out = control.astype(np.float64)
        where = _at(ids, joints)
        drive_control = out[:, drives]
        has_stiffness = self.stiffness[where] > 0
        asked = drive_control / self._scale[joints]
        target = asked
        if seconds is not None:
            fastest = self.max_velocity[where]
            position = self.within_rate(target, joints, seconds, ids)
            velocity = np.minimum(np.maximum(target, -fastest), fastest)
            target = np.where(has_stiffness, position, velocity)
        if self._mixes:
            self.target_qvel[where] = np.where(has_stiffness, 0.0, target)
            self._note_velocities()
        clamped = self.limits.clamp(target, joints, ids)
        target = np.where(has_stiffness & self.parsed.driven[joints], clamped, target)
        changed = target * self._scale[joints]
        # Those that are as asked for stay exact: a factor and its inverse would round them.
        out[:, drives] = np.where(target == asked, drive_control, changed)
        return out

    def clear(self, ids: EnvIndex | None) -> None:
        """Clear velocity targets after a reset, which has set the compiled controls."""
        self._forget_velocities(ids)
        self.cut_effort[slice(None) if ids is None else ids] = 0.0
        joints = self._switched
        if not len(joints):
            return
        where = _at(ids, joints)
        columns = self.columns(joints)
        stiffness = self.stiffness[where]
        home = np.broadcast_to(self.parsed.init_qpos[joints], stiffness.shape)
        control = self._control(home, where)
        if self._arrays.on_device:  # all drives may be switched: others keep their controls
            present = self._handle.engine.state("ctrl")[where[0], columns]
            is_switched = (stiffness > 0) != (self.parsed.stiffness[joints] > 0)
            control = np.where(is_switched, control, present)
        self._handle.engine.write("ctrl", control, ids, columns)

    def _forget_velocities(self, ids: EnvIndex | None) -> None:
        if self.has_velocity_target:
            self.target_qvel[slice(None) if ids is None else ids] = 0.0
            self._note_velocities()

    def _note_velocities(self) -> None:
        # On a device it is not known without waiting: once one is set, it counts as set.
        self.has_velocity_target = self._arrays.on_device or bool(self.target_qvel.any())

    def _note_gains(self) -> None:
        if self._arrays.on_device:  # not known without waiting: results are the same
            self._rated = True
            self._springless = True
            self._switched = self.joints
            return
        self._note(self.stiffness, self.max_velocity)

    def _note(self, stiffness: Floats, fastest: Floats) -> None:
        self._rated = bool((fastest < NO_LIMIT).any())
        has_stiffness = stiffness[:, self.joints] > 0
        self._springless = not has_stiffness.all()
        is_switched = has_stiffness != (self.parsed.stiffness[self.joints] > 0)
        self._switched = self.joints[is_switched.any(axis=0)]

    # -- gains -----------------------------------------------------------------------------------

    def write(self, name: str, values: Floats, ids: EnvIndex | None, joints: Joints) -> None:
        """Set an attribute, by name, to non-negative values (n, k).

        A `max_effort` of `NO_LIMIT` or more means no limit.

        Raises:
            ValueError: If a joint has no drive.
        """
        engine = self._handle.engine
        index = self._handle.index
        driven = index.actuator_ids[joints] >= 0
        if name == "damping" and not driven.all():
            # The damping of a joint without a drive is passive.
            self.write("joint_damping", values[:, ~driven], ids, joints[~driven])
            joints = joints[driven]
            values = values[:, driven]
            if not len(joints):
                return
        where = _at(ids, joints)
        getattr(self, name)[where] = values
        if name in _JOINT_FIELDS:
            dofs = columns_of(index.dof_adr[joints])
            engine.write_model(_JOINT_FIELDS[name], values, ids, dofs)
            if name == "armature":
                engine.set_const_later(ids)
            elif name == "joint_damping" and not driven.all():
                self.damping[_at(ids, joints[~driven])] = values[:, ~driven]
        elif name == "max_velocity":  # used by actions only: MuJoCo has no velocity limit
            self._note_gains()
            engine.version += 1  # other targets
        else:
            self.columns(joints)
            if name != "max_effort":
                self._note_gains()
                self._write_gains(index.actuator_ids[joints], where, ids)
            if name in ("max_effort", "strength"):
                changes = name == "max_effort"
                self._write_efforts(index.actuator_ids[joints], where, ids, changes)

    def _write_gains(self, actuators: Joints, where: Any, ids: EnvIndex | None) -> None:
        engine = self._handle.engine
        model = engine.model
        _, joints = where
        spring = self.stiffness[where] * self.strength[where]
        damper = self.damping[where] * self.strength[where]
        gear = self._gear[joints]
        scale = self._scale[joints]
        gain = np.where(spring > 0, spring, damper) / (gear * scale)
        columns = actuators * model.actuator_gainprm.shape[1]
        engine.write_model("actuator_gainprm", gain, ids, columns_of(columns))
        columns = actuators * model.actuator_biasprm.shape[1]
        engine.write_model("actuator_biasprm", -(spring / gear**2), ids, columns_of(columns + 1))
        # Joints that mimic this one carry part of its damping.
        damper = np.maximum(damper - self.parsed.carried_damping[joints], 0.0)
        engine.write_model("actuator_biasprm", -(damper / gear**2), ids, columns_of(columns + 2))

    def _write_efforts(
        self, actuators: Joints, where: Any, ids: EnvIndex | None, changes: bool
    ) -> None:
        """Write force ranges; `changes` is whether other joints may be limited than before."""
        engine = self._handle.engine
        _, joints = where
        limit = self.max_effort[where]
        is_limited = limit < NO_LIMIT
        was_limited = engine.model.actuator_forcelimited[actuators] != 0
        if is_host(is_limited):
            changes = bool((is_limited != was_limited).any())
        # On a device it is not known without waiting; a strength changes no flag.
        if changes:
            self._limits_vary = True
        if self._limits_vary:
            flags = is_limited.astype(np.float64)
            engine.write_model("actuator_forcelimited", flags, ids, columns_of(actuators))
        elif not was_limited.any():
            return
        effort = np.where(is_limited, limit * self.strength[where], 0.0)
        force = effort / np.abs(self._gear[joints])
        low, high = self._shares[joints].T  # a file's force range may be asymmetric
        lower = columns_of(2 * actuators)
        upper = columns_of(2 * actuators + 1)
        engine.write_model("actuator_forcerange", -force * low, ids, lower)
        engine.write_model("actuator_forcerange", force * high, ids, upper)

    def write_limit(
        self, side: Literal[0, 1], values: Floats, ids: EnvIndex | None, joints: Joints
    ) -> None:
        """Set lower (0) or upper (1) position limits (n, k) of joints that have limits."""
        engine = self._handle.engine
        self.limits.set(side, values, joints, ids)
        model_joints = engine.model.dof_jntid[self._handle.index.dof_adr[joints]].astype(np.int64)
        engine.write_model("jnt_range", values, ids, columns_of(2 * model_joints + side))

    # -- whole simulations -------------------------------------------------------------------------

    def load_fields(self, ids: EnvIndex | None, fields: Mapping[str, NDArray[Any]]) -> None:
        """Read gains and limits, not targets, from model fields that were loaded.

        Where gains and effort limit of a drive have the same factor, or there is only a limit,
        `strength` is that factor; else it is 1.

        Args:
            ids: The environments.
            fields: The loaded fields, (size,) each, equal in these environments; others are as
                compiled.
        """
        model = self._handle.engine.model
        index = self._handle.index
        parsed = self.parsed
        driven = self.joints

        def read(name: str, columns: Joints, declared: Any, unit: Any = 1.0) -> Floats:
            """(k,) columns of a field times ``unit``; ``declared`` where they are as compiled."""
            loaded, compiled = field_values(model, fields, name, columns)
            return np.where(loaded == compiled, declared, loaded * unit)

        # Of all joints: passive properties and position limits.
        all_joints = np.arange(len(index.dof_adr))
        for name, field in _JOINT_FIELDS.items():
            values = read(field, index.dof_adr, getattr(parsed, name))
            getattr(self, name)[_at(ids, all_joints)] = values
        model_joints = model.dof_jntid[index.dof_adr].astype(np.int64)
        lower = read("jnt_range", 2 * model_joints, parsed.qpos_limits[:, 0])
        upper = read("jnt_range", 2 * model_joints + 1, parsed.qpos_limits[:, 1])
        self.limits.set(0, lower, all_joints, ids)
        self.limits.set(1, upper, all_joints, ids)

        # Of drives: gains and limits of effort, with their strength in them.
        actuators = index.actuator_ids[driven]
        gear = self._gear[driven]
        bias = model.actuator_biasprm.shape[1] * actuators
        declared_stiffness = parsed.stiffness[driven]
        stiffness = read("actuator_biasprm", bias + 1, declared_stiffness, -(gear**2))
        declared_damping = parsed.damping[driven]
        carried = parsed.carried_damping[driven]
        compiled_damping = (declared_damping - carried).clip(min=0.0)
        damping = read("actuator_biasprm", bias + 2, compiled_damping, -(gear**2)) + carried
        is_declared = damping == compiled_damping + carried
        damping = np.where(is_declared, declared_damping, damping)
        declared_effort = parsed.max_effort[driven]
        low, high = self._shares[driven].T
        larger = 2 * actuators + np.where(high >= low, 1, 0)  # the side with the larger limit
        effort = np.abs(read("actuator_forcerange", larger, declared_effort, gear))
        is_unlimited = read("actuator_forcelimited", actuators, -1.0) == 0
        effort = np.where(is_unlimited, 10 * NO_LIMIT, effort)

        # The strength, where all of them have the same factor.
        is_finite = (declared_effort > 0) & (declared_effort < NO_LIMIT)
        strength = np.divide(
            effort, declared_effort, out=np.ones_like(declared_effort), where=is_finite
        )
        is_common = _is_ratio(strength, stiffness, declared_stiffness)
        is_common &= _is_ratio(strength, damping, declared_damping)
        where = _at(ids, driven)
        self.strength[where] = np.where(is_common, strength, 1.0)
        self.stiffness[where] = np.where(is_common, declared_stiffness, stiffness)
        self.damping[where] = np.where(is_common, declared_damping, damping)
        self.max_effort[where] = np.where(is_common, declared_effort, effort)
        without_drive = _at(ids, np.flatnonzero(index.actuator_ids < 0))
        self.damping[without_drive] = self.joint_damping[without_drive]
        self._limits_vary = True
        self._note_gains()
        self._forget_velocities(ids)

    def state_dict(self) -> dict[str, Floats]:
        """Targets and gains (copies)."""
        state: dict[str, Floats] = {name: getattr(self, name).copy() for name in _SAVED}
        state["limits"] = self.limits.values.copy()
        return state

    def load_state_dict(self, state: dict[str, Floats]) -> None:
        """Continue exactly where `state_dict` was taken; the engine restores model fields."""
        for name in _SAVED:
            getattr(self, name)[...] = state[name]
        self.limits.restore(state["limits"])
        self._limits_vary = True
        self._note_gains()
        self._note_velocities()


def _at(ids: EnvIndex | None, joints: Joints) -> tuple[Any, Joints]:
    """Numpy index of joints (k,) in (N, D) arrays, for environments (n,) or all (None)."""
    if ids is None:
        return slice(None), joints
    return ids[:, None], joints


def _is_ratio(ratio: Floats, values: Floats, declared: Floats) -> NDArray[np.bool_]:
    """(k,) whether values have this ratio to those declared, or these are 0."""
    actual = np.divide(values, declared, out=ratio.copy(), where=declared > 0)
    return np.isclose(ratio, actual, rtol=1e-9, atol=0.0)
