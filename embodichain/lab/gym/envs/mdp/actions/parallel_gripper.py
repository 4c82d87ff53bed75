"""The action that opens and closes a parallel gripper with one number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import TYPE_CHECKING, Any, Literal

import lazy_loader
import numpy as np

from embodichain.lab.gym.envs.cfg import Names
from embodichain.lab.gym.envs.managers.param_types import Positive, Range, Vec3, Whole
from embodichain.lab.gym.envs.managers.term import ActionMeaning, finite_limits, joint_units
from embodichain.lab.gym.envs.managers.terms.per_name import PerJoint, per_joint
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.gym.envs.mdp.actions.actuator_ctrl import picked_controls
from embodichain.lab.gym.envs.mdp.actions.joint_action import JointTerm
from embodichain.lab.sim.compiler.names import NamedBy
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import mujoco
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
    from embodichain.lab.sim.configs.robot_names_cfg import GripperCfg
    from embodichain.utils.array_types import Floats
else:
    mujoco = lazy_loader.load("mujoco")

__all__ = ["ParallelGripper"]


@register_term("action", name="parallel_gripper")
class ParallelGripper(JointTerm):
    """One number for all fingers of a gripper, as position targets or controls.

    ``continuous``: target = lower + (upper - lower) x share; lower and upper are the limits of the
    joints or controls, or `lower_command` and `upper_command`; share = (action + 1) / 2, or that of
    `width`. ``binary``: below 0 the targets are `close_command`, else `open_command`, as in Isaac
    Lab's BinaryJointPositionAction. EmbodiChain 0.3's ParallelGripperAction.

    Joints that mimic another follow it; a gripper of an MJCF file, whose fingers move by a tendon,
    is moved by the control of its actuator.

    Where the robot's config says how this gripper opens and closes (`grippers`), `open_command`,
    `close_command`, `force` and `actuator_names` are taken from there unless given; without control
    parts or joints in `of`, the gripper is the only one that the robot has.

    Example:
        ``{func: parallel_gripper, params: {of: {uid: panda, joint_names: panda_finger_joint1}}}``

    Args:
        entity_cfg: The robot and the joints of its gripper.
        command_mode: ``continuous`` or ``binary``.
        use_joint_limits: Whether lower and upper are the limits; false (or null where commands are
            given) takes the commands.
        lower_command: rad or m at action -1: a number, a list per joint, or {joint regex: number};
            with `actuator_names`, units of ctrl.
        upper_command: At action +1, likewise.
        open_command: rad or m, likewise; binary mode needs it.
        close_command: Likewise.
        actuator_names: Regexes over the names of controls, in place of joints.
        width: Openings in metres at the lower and the upper command: actions are openings then, not
            numbers from -1 to 1; the opening is linear in the command.
        force: Largest force in N, of hinges in N m, that a finger presses with. At the start of a
            control step the target is never further ahead than force / stiffness of the servo.
        speed: Largest speed of the target, in units of the command a second.
        finger_axis: ``x``, ``y`` or a vector in the frame of the arm's tool: the line along which
            the fingers move, to which steps of an expert align. None reads it from the model.

    Raises:
        ConfigError: If commands of the mode are missing, commands of the other mode are given, both
            ends are the same, a regex matches no control, `finger_axis` is along the tool's z axis,
            or `force` is given for an actuator that is not a position servo of joints or of a fixed
            tendon.
    """

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Whole,
        command_mode: Literal["continuous", "binary"] = "continuous",
        use_joint_limits: bool | None = None,
        lower_command: PerJoint | None = None,
        upper_command: PerJoint | None = None,
        open_command: PerJoint | None = None,
        close_command: PerJoint | None = None,
        actuator_names: Names | None = None,
        width: Range | None = None,
        force: Positive | None = None,
        speed: Positive | None = None,
        finger_axis: Literal["x", "y"] | Vec3 | None = None,
    ) -> None:
        is_binary = command_mode == "binary"
        gripper = _gripper_of(entity_cfg)
        self.filled_in: dict[str, Any] = {}
        if gripper is not None:
            entity_cfg = gripper.joints
            given = {
                "actuator_names": actuator_names,
                "open_command": open_command,
                "close_command": close_command,
                "force": force,
            }
            self.filled_in = gripper.missing(given, is_binary=is_binary)
            values = {**given, **self.filled_in}
            actuator_names = values["actuator_names"]
            open_command = values["open_command"]
            close_command = values["close_command"]
            force = values["force"]
        super().__init__(env, entity_cfg, driven=actuator_names is None)
        self._controls: _Controls | None = None
        if actuator_names is not None:
            self._controls = _Controls(self._asset, actuator_names, force is not None)
            self.names = self._controls.names
            self._default = self._controls.initial

        # Each map from the command at the lower end to the one at the upper end.
        limit_commands = {"lower_command": lower_command, "upper_command": upper_command}
        state_commands = {"close_command": close_command, "open_command": open_command}
        self._is_binary = is_binary
        if self._is_binary:
            commands = state_commands
            unused: dict[str, Any] = {
                **limit_commands,
                "use_joint_limits": use_joint_limits or None,
                "width": width,
            }
        else:
            commands = limit_commands
            unused = state_commands
        contradictions = [name for name, value in unused.items() if value is not None]
        if contradictions:
            message = f"has no meaning in mode {command_mode}"
            raise ConfigError([Problem(name, message) for name in contradictions])
        if use_joint_limits is None:
            use_joint_limits = not self._is_binary and lower_command is upper_command is None
        if use_joint_limits:
            self._low, self._high = self._read_limits(commands)
        else:
            self._low, self._high = self._read_commands(commands)
        self._span: Floats = self._high - self._low
        if not self._span.any():
            raise ConfigError([Problem(next(iter(commands)), "both ends are the same")])

        self._ends = (-1.0, 1.0) if width is None else (float(width[0]), float(width[1]))
        if self._ends[0] == self._ends[1]:
            raise ConfigError([Problem("width", "both ends are the same")])
        self._force = force
        self.finger_axis: Floats | None = _read_direction(finger_axis)
        self._step: float | None = None if speed is None else speed * env.step_dt
        self.low: NDArray[np.float32] = np.full(1, self._ends[0], np.float32)
        self.high: NDArray[np.float32] = np.full(1, self._ends[1], np.float32)
        self.names = ("gripper",)

    def _read_limits(self, commands: Mapping[str, Any]) -> tuple[Floats, Floats]:
        """(A,) each: the limits of the joints or controls, in place of commands."""
        contradictions = [name for name, value in commands.items() if value is not None]
        if contradictions:
            message = "contradicts use_joint_limits: true"
            raise ConfigError([Problem(name, message) for name in contradictions])
        if self._controls is None:
            kind = "joints"
            limits = np.asarray(self._asset.parsed.qpos_limits, np.float64)[self._ids]
        else:
            kind = "controls"
            limits = self._controls.limits
        if not np.isfinite(limits).all():
            message = f"{kind} {list(self.names)} need limits, or give lower_ and upper_command"
            raise ConfigError([Problem("use_joint_limits", message)])
        return finite_limits(limits, np.arange(len(limits)))

    def _read_commands(self, commands: Mapping[str, Any]) -> tuple[Floats, Floats]:
        """(A,) each: the commands at the lower and the upper end."""
        missing = [name for name, value in commands.items() if value is None]
        if missing:
            raise ConfigError([Problem(name, "missing; this mode needs it") for name in missing])
        named_by = self._named_by
        kind = "joint"
        if self._controls is not None:
            named_by = self._controls.named_by
            kind = "actuator"
        low, high = (
            per_joint(value, self.names, name, kind, named_by) for name, value in commands.items()
        )
        return low, high

    def apply(self, action: torch.Tensor) -> None:
        """Write the targets of (N, 1) actions."""
        value = self._arrays.of(action).astype(np.float64)
        value = np.minimum(np.maximum(value, self.low), self.high)
        if self._is_binary:
            target = np.where(value < 0.0, self._low, self._high)
        else:
            start, end = self._ends
            target = self._low + self._span * ((value - start) / (end - start))
        if self._step is not None:
            current = self._current_command()
            target = np.minimum(np.maximum(target, current - self._step), current + self._step)
        if self._force is not None:
            rest, reach = self._reach(self._force)
            target = np.minimum(np.maximum(target, rest - reach), rest + reach)
        if self._controls is None:
            self._write_targets(target)
        else:
            self._asset.write_ctrl(target, self._controls.which)

    def _current_command(self) -> Floats:
        """(N, A) present targets or controls."""
        if self._controls is None:
            return self._targets()
        return self._asset.read_ctrl()[:, self._controls.which]

    def _reach(self, force: float) -> tuple[Floats, Floats]:
        """(N, A) targets at which servos have no force, and how far ahead they have `force`."""
        if self._controls is not None:
            return self._controls.reach(self._asset.read_qpos(), force)
        stiffness = self._asset.drives.stiffness[:, self._ids]
        return self._qpos(), force / np.where(stiffness > 0.0, stiffness, np.inf)

    def _action_at(self, position: Floats) -> Floats:
        """(..., 1) the action nearest to positions (..., A): the mean over the joints that move."""
        start, end = self._ends
        value: Floats = start + (end - start) * self._share(position)
        value = np.clip(value, start, end)
        if self._is_binary:
            value = np.where(value < 0.0, -1.0, 1.0)
        return value[..., None]

    def opening(self) -> Floats | None:
        """(N,) measured share of the way from closed (0) to open (1); None if it is unknown.

        It is that of joints, or of an actuator that is a position servo.
        """
        position = self._qpos() if self._controls is None else self._controls.at_rest(self._asset)
        if position is None:
            return None
        return self._share(position)

    def opening_force(self, data: mujoco.MjData) -> Floats:
        """(nv,) generalized forces that open the gripper, of any size.

        Args:
            data: A state with the moments of actuators.
        """
        model: mujoco.MjModel = self._asset.engine.model
        if self._controls is not None:
            return self._controls.force(self._asset, model, data, np.sign(self._span))
        force = np.zeros(model.nv)
        force[np.asarray(self._asset.entity.dof_adr)[self._ids]] = np.sign(self._span)
        return force

    def _share(self, position: Floats) -> Floats:
        """Share of the way from low to high of positions (..., A): the mean of those that move."""
        moving = np.flatnonzero(self._span)
        shares = ((position - self._low)[..., moving] / self._span[moving]).T
        # One after the other, so that rounding does not depend on the number of environments.
        total: Floats = reduce(np.add, shares)
        return total / len(moving)

    def centre_and_scale(self) -> tuple[Sequence[float | str], Sequence[float | str]]:
        """Of the fingers' commands: a number, or one for each finger where they differ."""
        if self._is_binary:
            return [f"below 0: {_in_words(self._low)}; else {_in_words(self._high)}"], [""]
        scale = self._span / (self._ends[1] - self._ends[0])
        centre = self._low - self._ends[0] * scale
        if (centre == centre[0]).all() and (scale == scale[0]).all():
            return [float(centre[0])], [float(scale[0])]
        return [_in_words(centre)], [_in_words(scale)]

    def meaning(self) -> ActionMeaning:
        """The command of all fingers: positions of joints, or controls of actuators."""
        if self._controls is not None:
            return ActionMeaning(quantity="gripper control", mode="absolute")
        units = set(joint_units(self._asset, self._ids))
        return ActionMeaning(
            quantity="gripper position",
            mode="absolute",
            units=units.pop() if len(units) == 1 else "",
        )

    def home(self) -> Floats:
        """(1,) the action nearest to the initial state."""
        return self._action_at(self._default)

    def hold(self) -> Floats:
        """(N, 1) the action nearest to the present targets."""
        return self._action_at(self._current_command())


@dataclass(frozen=True, eq=False)
class _Gripper:
    """A gripper that the robot's config describes.

    Attributes:
        joints: The robot and the joints of the gripper.
        cfg: How it opens and closes.
    """

    joints: ResolvedEntity
    cfg: GripperCfg

    def missing(self, given: Mapping[str, Any], *, is_binary: bool) -> dict[str, Any]:
        """Return the parameters of the action that are not given and that the config has."""
        cfg = self.cfg
        of_config: dict[str, Any] = {"actuator_names": cfg.actuators, "force": cfg.force}
        if is_binary:
            of_config |= {"open_command": cfg.open, "close_command": cfg.close}
        return {
            name: value
            for name, value in of_config.items()
            if value is not None and given[name] is None
        }


def _gripper_of(entity: ResolvedEntity) -> _Gripper | None:
    """The gripper that a reference names, if the robot's config describes it."""
    if not hasattr(entity.asset, "parsed"):
        return None
    parsed: Any = entity.asset.parsed
    grippers: Mapping[str, GripperCfg] = getattr(parsed.cfg, "grippers", {})
    if entity.control_parts:
        parts = [part for part in entity.control_parts if part in grippers]
        if len(entity.control_parts) == 1 and parts:
            return _Gripper(entity, grippers[parts[0]])
        return None
    if entity.joints_by or len(grippers) != 1:
        return None
    part, cfg = next(iter(grippers.items()))
    mimics = parsed.mimic_ids
    ids = tuple(sorted(i for i in parsed.control_parts[part] if i not in mimics))
    names = tuple(parsed.joint_names[i] for i in ids)
    joints = replace(
        entity,
        joint_ids=ids,
        joint_names=names,
        control_parts=(part,),
        joints_by=(NamedBy("control_parts", part, names),),
        all_joints=len(ids) == len(parsed.joint_names),
    )
    return _Gripper(joints, cfg)


class _Controls:
    """Controls of a gripper's actuators.

    Args:
        asset: The robot.
        patterns: Regexes over the names of controls.
        forced: Whether they must be position servos of joints or fixed tendons, as `reach` needs.

    Attributes:
        which: (A,) columns of the controls.
        names: Their names.
        named_by: The regexes, and what each matches.
        limits: (A, 2), infinite where there are none.
        initial: (A,) initial controls.
    """

    def __init__(self, asset: Any, patterns: Names, forced: bool) -> None:
        parsed = asset.parsed
        self.which, self.named_by = picked_controls(patterns, parsed.control_names)
        self.names = tuple(parsed.control_names[i] for i in self.which)
        self.limits: Floats = np.asarray(parsed.ctrl_limits, np.float64)[self.which]
        self.initial: Floats = np.asarray(parsed.init_ctrl, np.float64)[self.which]
        self._are_servos = True
        try:
            servos = [_read_servo(parsed, name) for name in self.names]
        except ConfigError:
            if forced:
                raise
            self._are_servos = False
            return
        self._gain: Floats = np.array([servo.gain for servo in servos])
        self._bias: Floats = np.array([servo.bias for servo in servos])
        levers = np.array([servo.levers for servo in servos])
        moving = np.flatnonzero(levers.any(axis=0)).tolist()
        self._levers = [(joint, levers[:, joint]) for joint in moving]

    def force(
        self, asset: Any, model: mujoco.MjModel, data: mujoco.MjData, signs: Floats
    ) -> Floats:
        """(nv,) generalized forces of controls that are raised (1) or lowered (-1), (A,)."""
        columns = np.asarray(asset.entity.own_ctrl_ids)[self.which]
        force: Floats = np.zeros(model.nv)
        for actuator in range(model.nu):
            first = model.actuator_ctrladr[actuator]
            is_of_actuator = columns >= first
            is_of_actuator &= columns < first + model.actuator_ctrlnum[actuator]
            if not is_of_actuator.any():
                continue
            has_fixed_gain = model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
            is_reversed = has_fixed_gain and model.actuator_gainprm[actuator, 0] < 0
            sign = (-1.0 if is_reversed else 1.0) * signs[is_of_actuator].sum()
            first_output = model.actuator_outadr[actuator]
            for row in range(first_output, first_output + model.actuator_outnum[actuator]):
                start = data.moment_rowadr[row]
                entries = slice(start, start + data.moment_rownnz[row])
                force[data.moment_colind[entries]] += sign * data.actuator_moment[entries]
        return force

    def at_rest(self, asset: Any) -> Floats | None:
        """Controls (N, A) at which servos have no force; None if they are not servos."""
        if not self._are_servos:
            return None
        rest, _ = self.reach(asset.read_qpos(), 0.0)
        return rest

    def reach(self, qpos: Floats, force: float) -> tuple[Floats, Floats]:
        """Controls (N, A) without force at positions (N, D), and the distance (A,) to `force`."""
        length = 0.0 * qpos[:, :1] * np.ones(len(self.names))
        for joint, lever in self._levers:  # in a fixed order
            length += qpos[:, joint, None] * lever
        free: Floats = -(self._bias[:, 0] + self._bias[:, 1] * length) / self._gain
        return free, force / np.abs(self._gain)


def _in_words(values: Floats) -> str:
    """One number if all are the same, else all."""
    shown = values[:1] if (values == values[0]).all() else values
    return ", ".join(f"{value:g}" for value in shown)


_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0)}


def _read_direction(axis: str | Sequence[float] | None) -> Floats | None:
    """(3,) a direction in the tool's frame."""
    if axis is None:
        return None
    direction: Floats = np.asarray(_AXES[axis] if isinstance(axis, str) else axis, np.float64)
    if np.hypot(direction[0], direction[1]) <= 0.1 * np.abs(direction[2]):
        message = "must be across the tool's z axis, which points out of a gripper"
        raise ConfigError([Problem("finger_axis", f"{message}, got {direction.tolist()}")])
    return direction


@dataclass(frozen=True)
class _Servo:
    """A position servo: force = gain x ctrl + bias[0] + bias[1] x length.

    Attributes:
        gain: Not 0.
        bias: (2,); the second is negative.
        levers: (D,) length per position of each joint.
    """

    gain: float
    bias: Floats
    levers: Floats


def _read_servo(parsed: Any, name: str) -> _Servo:
    """Read an actuator of a robot's file.

    Raises:
        ConfigError: If it is not a position servo of joints or of a fixed tendon.
    """
    model: mujoco.MjModel = parsed.model
    actuator = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
    levers = _read_levers(parsed, actuator)
    if levers.any() and model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED:
        levers *= model.actuator_gear[model.actuator_outadr[actuator], 0]
        gain = float(model.actuator_gainprm[actuator, 0])
        bias = model.actuator_biasprm[actuator, :2]
        if gain != 0.0 and bias[1] < 0.0:
            return _Servo(gain, bias, levers)
    message = f"{name!r} is not a position servo of joints or of a fixed tendon"
    raise ConfigError([Problem("force", message)])


def _read_levers(parsed: Any, actuator: int) -> Floats:
    """(D,) length of an actuator's transmission per position of each joint, without its gear.

    It is 0 where an actuator does not exist, has a state of its own, or has another transmission.
    """
    model: mujoco.MjModel = parsed.model
    levers: Floats = np.zeros(len(parsed.joint_names))
    if actuator < 0 or model.actuator_dyntype[actuator] != mujoco.mjtDyn.mjDYN_NONE:
        return levers
    joint_numbers = {model.joint(joint).id: i for i, joint in enumerate(parsed.joint_names)}
    transmission = int(model.actuator_trntype[actuator])
    target = int(model.actuator_trnid[actuator, 0])
    if transmission == mujoco.mjtTrn.mjTRN_JOINT and target in joint_numbers:
        levers[joint_numbers[target]] = 1.0
    elif transmission == mujoco.mjtTrn.mjTRN_TENDON:
        first = int(model.tendon_adr[target])
        for i in range(first, first + int(model.tendon_num[target])):
            if model.wrap_type[i] == mujoco.mjtWrap.mjWRAP_JOINT:
                levers[joint_numbers[int(model.wrap_objid[i])]] = model.wrap_prm[i]
    return levers
