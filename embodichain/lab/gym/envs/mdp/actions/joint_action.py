"""The action that moves joints: positions, velocities or efforts, affine in the action.

`Affine` computes values and bounds; `JointTerm`, `VelocityTargets` and `Efforts` write them.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Arm, Range
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import (
    ActionMeaning,
    ActionTerm,
    finite_limits,
    joint_units,
)
from embodichain.lab.gym.envs.managers.terms.per_name import (
    JointClip,
    PerJoint,
    joint_clip,
    per_joint,
)
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.gym.envs.mdp._tools import JointRange, arm_solver, usual_speeds
from embodichain.lab.sim.compiler.names import exact_pattern
from embodichain.utils.arrays import columns_of
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
    from embodichain.lab.gym.envs.mdp._tools import Orientation
    from embodichain.lab.sim.compiler.names import NamedBy
    from embodichain.lab.sim.objects.arms.arm_dynamics import ArmDynamics
    from embodichain.lab.sim.objects.arms.arm_solver import ArmSolver
    from embodichain.lab.sim.objects.articulation import Articulation
    from embodichain.utils.array_types import Floats

__all__ = [
    "Affine",
    "Efforts",
    "JointAction",
    "JointTerm",
    "VelocityTargets",
]

logger = logging.getLogger(__name__)


class Affine:
    """The affine map from an action to values, in float64, and the bounds of the action.

    Args:
        names: Names of the A columns.
        env: The environment.
        scale: `PerJoint`, not 0.
        offset: `PerJoint`.
        clip: `JointClip`. Bounds of names that are not in a map, or of all if it is None, follow
            from `limits`; without `limits` a map must have all names.
        centre: (A,) added to the offset.
        limits: Low and high of the value, (A,) each; None bounds the action by -1 and 1.
        bounded: Whether the action has bounds; without them nothing is clamped.
        what: The kind of the names, for messages.
        named_by: The entries of the reference that name the columns; see `in_columns`.

    Attributes:
        low, high: (A,) float32 bounds of the action.
    """

    def __init__(
        self,
        names: Sequence[str],
        env: TermContext,
        scale: Any,
        offset: Any,
        clip: Any,
        centre: Floats | float = 0.0,
        limits: tuple[Any, Any] | None = None,
        what: str = "joint",
        named_by: Sequence[NamedBy] = (),
        bounded: bool = True,
    ) -> None:
        self._of = env.arrays.of
        self._scale: Floats = per_joint(scale, names, "scale", what, named_by)
        if (self._scale == 0).any():
            raise ConfigError([Problem("scale", "must not be 0")])
        self._centre: Floats = per_joint(offset, names, "offset", what, named_by) + centre
        self._is_clipped = clip is not None
        self._is_identity = bool((self._scale == 1).all() and not self._centre.any())

        by_limits: tuple[Floats, Floats] | None = None
        if limits is not None:
            ends = (np.asarray(limits, np.float64) - self._centre) / self._scale
            by_limits = np.minimum(*ends), np.maximum(*ends)  # a scale may be negative
        # In float64, so that `action_for` does not round; the action space has them in float32.
        self._lower: Floats
        self._upper: Floats
        if not bounded:
            self._upper = np.full(len(names), np.inf)
            self._lower = -self._upper
        elif clip is not None:
            self._lower, self._upper = joint_clip(clip, names, "clip", what, named_by, by_limits)
        elif by_limits is not None:
            self._lower, self._upper = by_limits
        else:
            self._upper = np.ones(len(names))
            self._lower = -self._upper
        self.low: NDArray[np.float32] = self._lower.astype(np.float32)
        self.high: NDArray[np.float32] = self._upper.astype(np.float32)

        def tile(row: NDArray[Any]) -> Any:
            return env.arrays.put(np.tile(row, (env.num_envs, 1)))

        # With a row for every environment: broadcasting one row takes four times as long.
        self._low_rows = tile(self.low)
        self._high_rows = tile(self.high)
        self._centre_rows = tile(self._centre)
        self._scale_rows = tile(self._scale)

    @property
    def centre(self) -> Floats:
        """(A,) the value of the action 0."""
        return self._centre

    @property
    def scale(self) -> Floats:
        """(A,) change of the value per unit of action."""
        return self._scale

    def value(self, action: torch.Tensor) -> Floats:
        """(N, A) the value of an action."""
        value: Floats = self._of(action)
        if self._is_clipped:
            # Bounds are float32 as the action is: nothing is converted.
            value = np.minimum(np.maximum(value, self._low_rows), self._high_rows)
        if self._is_identity:
            return value
        scaled = self._scale_rows * value.astype(np.float64)
        return np.add(self._centre_rows, scaled, out=scaled)

    def value_of(self, action: NDArray[np.float32]) -> Floats:
        """(A,) the value of one action within the bounds."""
        return self._centre + self._scale * action

    def action_for(self, value: Floats | float) -> Floats:
        """(A,) or (N, A) the action for a value, clamped to the bounds."""
        return np.clip((value - self._centre) / self._scale, self._lower, self._upper)


class JointTerm(ActionTerm):
    """An action term of the picked joints.

    Args:
        env: The environment.
        entity: The robot and its picked joints.
        driven: Whether every joint must have a drive.
        positions: Whether the drives must take position targets.

    Raises:
        ConfigError: If there is no joint, or one without such a drive.
    """

    def __init__(
        self,
        env: TermContext,
        entity: ResolvedEntity,
        driven: bool = True,
        positions: bool = True,
    ) -> None:
        asset = entity.articulation
        if not entity.is_articulation:
            raise ConfigError([Problem("entity_cfg.uid", f"{entity.uid!r} has no joints")])
        if not entity.joint_ids:
            raise ConfigError([Problem("entity_cfg", f"{entity.uid!r} has no active joint")])
        self.names = entity.joint_names
        self._asset = asset
        self._ids: NDArray[np.int64] = np.asarray(entity.joint_ids, np.int64)
        self._joints = None if entity.all_joints else self._ids
        self._joint_columns = columns_of(self._ids)
        self._named_by = entity.joints_by
        self._period = env.step_dt
        self._arrays = env.arrays
        self._default: Floats = np.asarray(asset.parsed.init_qpos, np.float64)[self._ids]
        if driven:
            self._check_drives()
            if positions:
                self._check_position_drives()

    def _check_drives(self) -> None:
        """Refuse joints without a drive; name the actuators that move them instead."""
        parsed = self._asset.parsed
        has_drive = np.asarray(self._asset.index.actuator_ids)[self._ids] >= 0
        undriven = [self.names[i] for i in np.flatnonzero(~has_drive)]
        if not undriven:
            return
        message = (
            f"joints {undriven} have no drive and no position servo (drive_type none, mimics, "
            "or joints of an MJCF that its actuators or drive_pros leave alone)"
        )
        joint_names = {*self.names, *parsed.joint_names}
        actuators = [name for name in parsed.control_names if name not in joint_names]
        hint = f"Its file's actuators move them: {', '.join(actuators)}" if actuators else ""
        raise ConfigError([Problem("entity_cfg", message, hint)])

    def _check_position_drives(self) -> None:
        """Refuse joints that a velocity servo of the file drives."""
        parsed = self._asset.parsed
        has_velocity_servo = (
            (parsed.servos.drive >= 0) & ~parsed.driven & (parsed.stiffness == 0)
        )[self._ids]
        if has_velocity_servo.any():
            names = ", ".join(repr(self.names[i]) for i in np.flatnonzero(has_velocity_servo))
            message = f"joints {names} take velocity targets only: use joint_velocity"
            raise ConfigError([Problem("entity_cfg", message)])

    @property
    def asset(self) -> Articulation:
        """The robot."""
        return self._asset

    def _write_targets(self, target: Floats) -> None:
        """Set the drives' position targets (N, A), clamped to the joints' limits.

        In a control step they move by at most the drives' `max_velocity` times its period.
        """
        moved = self._asset.drives.within_rate(target, self._ids, self._period)
        self._asset.write_target(moved, self._joints)

    @property
    def robot_uid(self) -> str:
        """Uid of the robot that it moves."""
        return self._asset.uid

    def _targets(self) -> Floats:
        """(N, A) current position targets of the drives."""
        return self._asset.drives.read_target_qpos()[:, self._ids]

    def _qpos(self) -> Floats:
        """(N, A) measured positions; do not write to it or store it."""
        qpos: Floats = self._asset.read_qpos()
        return qpos if self._joints is None else qpos[:, self._ids]


class VelocityTargets:
    """Writes velocity targets, of stiff drives as a moving position target.

    Args:
        asset: The articulation.
        joints: (A,) indices of its joints.
        period: Seconds of a control step.

    Raises:
        ConfigError: If a joint has neither stiffness nor damping.
    """

    def __init__(self, asset: Articulation, joints: NDArray[np.int64], period: float) -> None:
        self._asset = asset
        self._joints = joints
        self._period = period
        to_host = asset.sim.arrays.host
        has_stiffness = to_host(asset.drives.stiffness)[0, joints] > 0
        has_damping = to_host(asset.drives.damping)[0, joints] > 0
        undriven = [asset.parsed.joint_names[j] for j in joints[~(has_stiffness | has_damping)]]
        if undriven:
            message = f"joints {undriven} have neither stiffness nor damping: nothing drives them"
            raise ConfigError([Problem("entity_cfg", message)])
        # Columns of the velocities.
        self._with_stiffness: NDArray[np.int64] = np.flatnonzero(has_stiffness)
        self._without_stiffness: NDArray[np.int64] = np.flatnonzero(~has_stiffness)

    def write(self, velocity: Floats) -> None:
        """Set velocities (N, A), rad/s or m/s, within the drives' `max_velocity`."""
        largest = self._asset.drives.max_velocity[:, self._joints]
        target = np.minimum(np.maximum(velocity.astype(np.float64), -largest), largest)
        if len(self._with_stiffness):
            self._move_position_targets(target[:, self._with_stiffness])
        if len(self._without_stiffness):
            joints = self._joints[self._without_stiffness]
            self._asset.drives.write_target_qvel(target[:, self._without_stiffness], joints, None)

    def _move_position_targets(self, velocity: Floats) -> None:
        """Move the position targets of stiff drives, only as far ahead as the drives can pull."""
        joints = self._joints[self._with_stiffness]
        drives = self._asset.drives
        target = drives.read_target_qpos()[:, joints] + velocity * self._period
        reach = drives.max_effort[:, joints] / drives.stiffness[:, joints]
        qpos = self._asset.read_qpos()[:, joints]
        target = np.minimum(np.maximum(target, qpos - reach), qpos + reach)
        drives.target_qvel[:, joints] = velocity
        drives.has_velocity_target = True
        self._asset.write_target(target, joints)


class Efforts:
    """Applies efforts to joints, constant over a control step.

    Args:
        asset: The articulation.
        joints: (A,) indices of its joints.
    """

    def __init__(self, asset: Articulation, joints: NDArray[np.int64]) -> None:
        self._asset = asset
        self._joints = joints
        self._dofs = np.asarray(asset.index.dof_adr, np.int64)[joints]
        has_stiffness = asset.sim.arrays.host(asset.drives.stiffness)[0, joints] > 0
        if has_stiffness.any():
            logger.warning(
                "joint_effort: joints %s have a drive with stiffness that keeps its own target "
                "beside the effort; drive_pros: {stiffness: 0, damping: 0} leaves the effort alone",
                ", ".join(asset.parsed.joint_names[j] for j in joints[has_stiffness]),
            )

    def write(self, effort: Floats) -> Floats:
        """Apply (N, A) efforts, N m or N, within `max_effort`, times the drives' strength.

        Returns:
            (N, A) efforts within `max_effort`.
        """
        drives = self._asset.drives
        largest = drives.max_effort[:, self._joints]
        limited: Floats = np.minimum(np.maximum(effort, -largest), largest)
        strength = drives.strength[:, self._joints]
        applied = limited * strength
        drives.cut_effort[:, self._joints] = (effort - limited) * strength
        self._asset.engine.write("qfrc_applied", applied, None, self._dofs)
        return limited


Centre = Literal["zero", "home", "qpos", "target", "limits"]


@register_term("action", name="joint_action")
class JointAction(JointTerm):
    """Joint targets or efforts: value = centre + offset + scale x clamp(action, clip).

    Computed in float64. Position targets are clamped to the joints' limits and move by at most
    ``max_velocity`` times the control period. With stiffness 0 a velocity is the drive's target,
    effort = damping x (target - velocity); with stiffness it moves the position target, which
    is never further ahead than the drive can pull (``max_effort`` / stiffness), so that the joint
    is held at velocity 0. Efforts are applied to the joints (MuJoCo's ``qfrc_applied``) in addition
    to those of drives: declare ``drive_pros: {drive_type: none}`` or stiffness and damping 0 for
    pure effort control.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints. A link, site or geom is
            the tool that experts move (by default that of `solver_cfg`).
        control: The quantity of the value: ``position`` (rad or m), ``velocity`` (rad/s or m/s),
            or ``effort`` (N m or N), within +-``max_effort``.
        centre: Of positions: ``zero``; ``home``, the initial position; ``qpos``, the measured
            position; ``target``, the previous target, so that joints do not sag under gravity;
            ``limits`` maps `range` to the joint's declared limits (+-2 pi without any), with
            u = clamp(offset + scale x clamp(action, clip), range), target = low + (high - low) x
            (u - range[0]) / (range[1] - range[0]).
        scale: Units per unit of action: a number, a list per joint, or {joint regex: number}; a
            key may be a control part of the robot.
        offset: Units, likewise.
        clip: Bounds of the action: [low, high], a list of pairs, or {joint regex: [low, high]}.
            None is (limits - offset) / scale with the joints' limits (+-2 pi without any) for
            positions about zero, the same with `range` for ``centre: limits``, else [-1, 1].
        range: [low, high] that ``centre: limits`` maps to the joints' limits.
        bounds: ``clip``: those of `clip` are the bounds of the action. None: the action has no
            bounds and is not clamped, as in Isaac Lab and mjlab; `clip` is then not to be given.
            PPO learns such actions; SAC and others that need bounds refuse them.

    Raises:
        ConfigError: If a joint has no drive for this control.

    Example:
        ``{func: joint_action, params: {of: {uid: ur10}, centre: home, scale: 0.6}}``
    """

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Arm,
        control: Literal["position", "velocity", "effort"] = "position",
        centre: Centre = "zero",
        scale: PerJoint = 1.0,
        offset: PerJoint = 0.0,
        clip: JointClip | None = None,
        range: Range = (-1.0, 1.0),
        bounds: Literal["clip"] | None = "clip",
    ) -> None:
        super().__init__(
            env,
            entity_cfg,
            driven=control != "effort",
            positions=control == "position",
        )
        self.filled_in: dict[str, Any] = {}
        parts = self._asset.parsed.control_parts
        for name, value in (("scale", scale), ("offset", offset)):
            if isinstance(value, Mapping) and not parts.keys().isdisjoint(value):
                by_joint = per_joint(
                    self._by_joint(value), self.names, name, "joint", self._named_by
                )
                self.filled_in[name] = by_joint.tolist()
        scale = self.filled_in.get("scale", scale)
        offset = self.filled_in.get("offset", offset)
        if control != "position" and centre != "zero":
            raise ConfigError([Problem("centre", f"{centre} has a meaning for positions only")])
        if range[0] == range[1]:
            raise ConfigError([Problem("range", f"low equals high in {list(range)}")])
        bounded = bounds is not None
        if clip is not None and not bounded:
            message = "bounds: null leaves the action without bounds: leave one of them out"
            raise ConfigError([Problem("clip", message)])
        self._entity = entity_cfg
        self._control = control
        self._centre = centre
        self.named_by = self._named_by

        # Of `centre: limits`: values from range_low to range_high are mapped to the joints' limits.
        joint_low, joint_high = finite_limits(self._asset.parsed.qpos_limits, entity_cfg.joint_ids)
        self._joint_low = joint_low
        self._range_low: Floats = np.full(len(self._ids), float(range[0]))
        self._range_high: Floats = np.full(len(self._ids), float(range[1]))
        self._slope: Floats = (joint_high - joint_low) / (self._range_high - self._range_low)

        limits: tuple[Floats, Floats] | None = None
        if centre == "limits":
            limits = (self._range_low, self._range_high)
        elif control == "position" and centre == "zero":
            limits = (joint_low, joint_high)
        elif clip is None and bounded:
            clip = [-1.0, 1.0]
        self._affine = Affine(
            names=self.names,
            env=env,
            scale=scale,
            offset=offset,
            clip=clip,
            centre=self._default if centre == "home" else 0.0,
            limits=limits,
            named_by=self._named_by,
            bounded=bounded,
        )
        self.low = self._affine.low
        self.high = self._affine.high

        self._is_relative = centre in ("qpos", "target")
        self._is_motion = control != "position" or self._is_relative
        self._reference = self._qpos if centre == "qpos" else self._targets
        self._write: Callable[[Floats], Any]
        if control == "velocity":
            self._write = VelocityTargets(self._asset, self._ids, env.step_dt).write
        elif control == "effort":
            self._write = Efforts(self._asset, self._ids).write
        elif self._is_relative:
            self._write = self._write_relative
        elif centre == "limits":
            self._write = self._write_mapped
        else:
            self._write = self._write_absolute

    def _by_joint(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return a map by joint regex; a key may be a control part."""
        parsed = self._asset.parsed
        by_joint: dict[str, float] = {}
        for key, value in values.items():
            if key in parsed.control_parts and key not in parsed.joint_names:
                names = [parsed.joint_names[i] for i in parsed.control_parts[key]]
                by_joint |= {exact_pattern(n): value for n in names if n in self.names}
            else:
                by_joint[key] = value
        return by_joint

    def apply(self, action: torch.Tensor) -> None:
        """Write the targets or efforts of (N, A) actions."""
        self._write(self._affine.value(action))

    def centre_and_scale(self) -> tuple[Sequence[float | str], Sequence[float | str]]:
        """Of targets in rad, m, rad/s or m/s, or of efforts; ``qpos`` or ``target`` in words."""
        centres = self._affine.centre
        scales = self._affine.scale
        if self._centre == "limits":
            centres = self._joint_low + (centres - self._range_low) * self._slope
            scales = scales * self._slope
        if self._is_relative:
            words = [f"{self._centre} + {c:g}" if c else self._centre for c in centres]
            return words, scales.tolist()
        return centres.tolist(), scales.tolist()

    def meaning(self) -> ActionMeaning:
        """Positions, velocities or efforts of joints; about ``qpos`` and ``target`` changes."""
        return ActionMeaning(
            quantity=f"joint {self._control}",
            mode="delta" if self._is_relative else "absolute",
            reference=self._centre if self._is_relative else "",
            units=joint_units(self._asset, self._ids, self._control),
        )

    def _write_absolute(self, value: Floats) -> None:
        """Write targets for what encoders read; the joints go there less their `encoder_bias`."""
        self._write_targets(value - self._asset.drives.encoder_bias[:, self._joint_columns])

    def _write_relative(self, value: Floats) -> None:
        """Write targets at a distance from measured positions or previous targets."""
        self._write_targets(self._reference() + value)

    def _write_mapped(self, value: Floats) -> None:
        """Write targets that lie between the joints' limits as values in the range."""
        value = np.minimum(np.maximum(value, self._range_low), self._range_high)
        self._write_absolute(self._joint_low + (value - self._range_low) * self._slope)

    def _action_at(self, position: Floats) -> Floats:
        """The action for position targets, clamped to the bounds."""
        if self._centre == "limits":
            position = self._range_low + (position - self._joint_low) / self._slope
        return self._affine.action_for(position)

    def home(self) -> Floats:
        """(A,) the action that goes to the initial position, or that causes no motion."""
        if self._is_motion:
            return self._affine.action_for(0.0)
        return self._action_at(self._default)

    def hold(self) -> Floats:
        """(N, A) or (A,) the action that keeps the present targets, or that causes no motion."""
        if self._is_motion:
            return self.home()
        return self._action_at(self._targets())

    # -- as `MovesTool`, for position targets ----------------------------------------------------

    orientation: ClassVar[Orientation] = "any"
    tool_speeds: ClassVar[tuple[float, float]] = (math.inf, math.inf)

    @cached_property
    def solver(self) -> ArmSolver:
        """The kinematics of the tool that the joints move.

        Raises:
            ConfigError: If there is no such tool, or more than one, or targets are not positions.
        """
        if self._control != "position":
            message = f"targets are positions, not {self._control}, where a tool follows a path"
            raise ConfigError([Problem("control", message)])
        return self.kinematics

    @cached_property
    def kinematics(self) -> ArmSolver:
        """The same, whether targets are positions, velocities or efforts.

        Raises:
            ConfigError: If there is no such tool, or more than one.
        """
        return arm_solver(self._entity)

    @cached_property
    def _moving(self) -> tuple[list[int], NDArray[np.int64]]:
        """The columns of the joints that move the tool, from root to tool, and these joints."""
        joints = self.solver.moving
        return [self._ids.tolist().index(int(joint)) for joint in joints], joints

    @property
    def joint_speeds(self) -> Floats:
        """(k,) largest speeds of the joints, rad/s or m/s, from root to tool."""
        columns, joints = self._moving
        speeds = usual_speeds(self._asset, joints, self.solver)
        if self._is_motion and self._centre != "qpos":
            # A target moves by no more than the smaller bound in each control step.
            value_of = self._affine.value_of
            changes = np.abs([value_of(self.low), value_of(self.high)]).min(axis=0)
            speeds = np.minimum(speeds, changes[columns] / self._period)
        return speeds

    @property
    def joint_range(self) -> JointRange | None:
        """The positions of the joints, from root to tool; None if targets are moved in steps."""
        if self._is_motion or self._centre == "limits":
            return None
        columns, _ = self._moving
        ends = np.stack([self._affine.value_of(self.low), self._affine.value_of(self.high)])
        return JointRange(ends.min(axis=0)[columns], ends.max(axis=0)[columns])

    def action_towards(self, pos: Floats, quat: Floats, qpos: Floats) -> Floats:
        """(N, A) the action for joint positions; see `MovesTool`.

        Drives that bear the weight of the arm get targets as far ahead as they sag below them.
        """
        columns, joints = self._moving
        reference = self._reference() if self._is_motion else self._targets()
        target = reference.copy()
        target[:, columns] = qpos
        if self._is_motion:
            return self._affine.action_for(target - reference)
        if not self._asset.parsed.cfg.gravcomp:
            target[:, columns] += self._sag(joints)
        return self._action_at(target)

    @cached_property
    def _dynamics(self) -> ArmDynamics:
        """The dynamics of the joints that move the tool."""
        from embodichain.lab.sim.objects.arms.arm_dynamics import ArmDynamics  # for experts only

        return ArmDynamics(self._asset, self.solver.moving.tolist(), self.solver.chain.tool)

    def _sag(self, joints: NDArray[np.int64]) -> Floats:
        """(N, k) how far drives stay behind their targets while they bear the arm, rad or m."""
        stiffness = self._asset.drives.stiffness[:, joints]
        has_drive = stiffness > 0.0
        return np.where(has_drive, self._dynamics.bias().T / np.where(has_drive, stiffness, 1.0), 0)
