"""The action that moves joints: positions, velocities or efforts, affine in the action.

`Affine` computes values and bounds; `JointTerm`, `VelocityTargets` and `Efforts` write them.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
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
from embodichain.lab.gym.envs.mdp._tools import arm_solver, usual_speeds
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
    from embodichain.lab.gym.envs.mdp._tools import Orientation
    from embodichain.lab.sim.compiler.names import NamedBy
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
        count, put = env.num_envs, env.arrays.put
        self._of = env.arrays.of
        self._scale: Floats = per_joint(scale, names, "scale", what, named_by)
        if (self._scale == 0).any():
            raise ConfigError([Problem("scale", "must not be 0")])
        self._centre: Floats = per_joint(offset, names, "offset", what, named_by) + centre
        self._clips = clip is not None
        rest: tuple[Floats, Floats] | None = None
        if limits is not None:
            ends = (np.asarray(limits, np.float64) - self._centre) / self._scale
            rest = np.minimum(*ends), np.maximum(*ends)
        if not bounded:
            self._most = np.full(len(names), np.inf)
            self._least = -self._most
        elif clip is not None:
            self._least, self._most = joint_clip(clip, names, "clip", what, named_by, rest)
        else:
            self._most = np.ones(len(names))
            self._least = -self._most
            if rest is not None:
                self._least, self._most = rest
        self.low: NDArray[np.float32] = self._least.astype(np.float32)
        self.high: NDArray[np.float32] = self._most.astype(np.float32)
        self._plain = bool((self._scale == 1).all() and not self._centre.any())
        # With a row for every environment: broadcasting one row takes four times as long.
        self._bounds = [put(np.tile(bound, (count, 1))) for bound in (self.low, self.high)]
        self._line = [put(np.tile(part, (count, 1))) for part in (self._centre, self._scale)]

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
        given: Floats = self._of(action)
        if self._clips:
            low, high = self._bounds
            given = np.minimum(np.maximum(given, low), high)  # float32: no conversion
        centre, scale = self._line
        return given if self._plain else centre + scale * given.astype(np.float64)

    def value_of(self, action: NDArray[np.float32]) -> Floats:
        """(A,) the value of one action within the bounds."""
        return self._centre + self._scale * action

    def action_for(self, value: Floats | float) -> Floats:
        """(A,) or (N, A) the action for a value, clamped to the bounds."""
        return np.clip((value - self._centre) / self._scale, self._least, self._most)


logger = logging.getLogger(__name__)


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
        self._period, self._arrays = env.step_dt, env.arrays
        asset = entity.asset
        if not hasattr(asset, "parsed"):
            raise ConfigError([Problem("entity_cfg.uid", f"{entity.uid!r} has no joints")])
        if not entity.joint_ids:
            raise ConfigError([Problem("entity_cfg", f"{entity.uid!r} has no active joint")])
        self.names = entity.joint_names
        self._asset: Any = asset
        self._ids: NDArray[np.int64] = np.asarray(entity.joint_ids, np.int64)
        self._joints = None if entity.all_joints else self._ids
        self._named_by = entity.joints_by
        actuators = np.asarray(asset.entity.actuator_ids)[self._ids]
        undriven = [n for n, a in zip(self.names, actuators, strict=True) if a < 0]
        if driven and undriven:
            message = (
                f"joints {undriven} have no drive and no position servo (drive_type none, mimics, "
                "or joints of an MJCF that its actuators or drive_pros leave alone)"
            )
            own = [name for name in asset.parsed.control_names if name not in self.names]
            there = [n for n in own if n not in asset.parsed.joint_names]
            hint = f"Its file's actuators move them: {', '.join(there)}" if there else ""
            raise ConfigError([Problem("entity_cfg", message, hint)])
        parsed = asset.parsed
        speeds = (parsed.servos.drive >= 0) & ~parsed.driven & (parsed.stiffness == 0)
        fast = [n for n, i in zip(self.names, self._ids, strict=True) if speeds[i]]
        if driven and positions and fast:
            names = ", ".join(map(repr, fast))
            message = f"joints {names} take velocity targets only: use joint_velocity"
            raise ConfigError([Problem("entity_cfg", message)])
        self._default: Floats = np.asarray(asset.parsed.init_qpos, np.float64)[self._ids]

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

    def __init__(self, asset: Any, joints: NDArray[np.int64], period: float) -> None:
        self._asset, self._joints, self._period = asset, joints, period
        drives = asset.drives
        gains = (asset.host.arrays.host(v) for v in (drives.stiffness, drives.damping))
        stiff, damping = (v[0, joints] > 0 for v in gains)
        lame = [asset.parsed.joint_names[j] for j in joints[~(stiff | damping)]]
        if lame:
            message = f"joints {lame} have neither stiffness nor damping: nothing drives them"
            raise ConfigError([Problem("entity_cfg", message)])
        self._stiff: NDArray[np.int64] = np.flatnonzero(stiff)
        self._free: NDArray[np.int64] = np.flatnonzero(~stiff)

    def write(self, velocity: Floats) -> None:
        """Set velocities (N, A), rad/s or m/s, within the drives' `max_velocity`."""
        most = self._asset.drives.max_velocity[:, self._joints]
        target = np.minimum(np.maximum(velocity.astype(np.float64), -most), most)
        if len(self._stiff):
            self._move(target[:, self._stiff])
        if len(self._free):
            joints = self._joints[self._free]
            self._asset.drives.write_target_qvel(target[:, self._free], joints, None)

    def _move(self, velocity: Floats) -> None:
        """Move the position targets of stiff drives, only as far ahead as the drives can pull."""
        joints, asset = self._joints[self._stiff], self._asset
        drives = asset.drives
        target = drives.read_target_qpos()[:, joints] + velocity * self._period
        reach = drives.max_effort[:, joints] / drives.stiffness[:, joints]
        qpos = asset.read_qpos()[:, joints]
        target = np.minimum(np.maximum(target, qpos - reach), qpos + reach)
        drives.target_qvel[:, joints] = velocity
        drives.has_velocity_target = True
        asset.write_target(target, joints)


class Efforts:
    """Applies efforts to joints, constant over a control step.

    Args:
        asset: The articulation.
        joints: (A,) indices of its joints.
    """

    def __init__(self, asset: Any, joints: NDArray[np.int64]) -> None:
        self._asset, self._joints = asset, joints
        self._dofs = np.asarray(asset.entity.dof_adr, np.int64)[joints]
        stiff = joints[asset.host.arrays.host(asset.drives.stiffness)[0, joints] > 0]
        if len(stiff):
            logger.warning(
                "joint_effort: joints %s have a drive with stiffness that keeps its own target "
                "beside the effort; drive_pros: {stiffness: 0, damping: 0} leaves the effort alone",
                ", ".join(asset.parsed.joint_names[j] for j in stiff),
            )

    def write(self, effort: Floats) -> Floats:
        """Apply (N, A) efforts, N m or N, within `max_effort`, times the drives' strength.

        Returns:
            (N, A) efforts within `max_effort`.
        """
        drives = self._asset.drives
        most = drives.max_effort[:, self._joints]
        within: Floats = np.minimum(np.maximum(effort, -most), most)
        strength = drives.strength[:, self._joints]
        applied = within * strength
        drives.cut_effort[:, self._joints] = (effort - within) * strength
        self._asset.engine.write("qfrc_applied", applied, None, self._dofs)
        return within


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
        scale: Units per unit of action: a number, a list per joint, or {joint regex: number}.
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
        super().__init__(env, entity_cfg, control != "effort", control == "position")
        self._entity, self._control = entity_cfg, control
        if control != "position" and centre != "zero":
            raise ConfigError([Problem("centre", f"{centre} has a meaning for positions only")])
        if range[0] == range[1]:
            raise ConfigError([Problem("range", f"low equals high in {list(range)}")])
        bounded = bounds is not None
        if clip is not None and not bounded:
            message = "bounds: null leaves the action without bounds: leave one of them out"
            raise ConfigError([Problem("clip", message)])
        low, high = finite_limits(self._asset.parsed.qpos_limits, entity_cfg.joint_ids)
        ends = tuple(np.full(len(self._ids), float(end)) for end in range)
        limits: tuple[Floats, Floats] | None = None
        if centre == "limits":
            limits = ends[0], ends[1]
        elif control == "position" and centre == "zero":
            limits = low, high
        elif clip is None and bounded:
            clip = [-1.0, 1.0]
        home = self._default if centre == "home" else 0.0
        affine = Affine(
            *(self.names, env, scale, offset, clip, home, limits),
            named_by=self._named_by,
            bounded=bounded,
        )
        self.low, self.high = affine.low, affine.high
        self.named_by = self._named_by
        self._centres, self._scales, self._from = affine.centre, affine.scale, centre
        self._value, self._action_for = affine.value, affine.action_for
        self._value_of = affine.value_of
        self._start, self._end, self._joint_low = *ends, low
        self._slope: Floats = (high - low) / (ends[1] - ends[0])
        self._moves = control != "position" or centre in ("qpos", "target")
        self._maps = centre == "limits"
        self._write: Callable[[Floats], Any] = self._write_read
        self._reference = self._qpos if centre == "qpos" else self._targets
        if control == "velocity":
            self._write = VelocityTargets(self._asset, self._ids, env.step_dt).write
        elif control == "effort":
            self._write = Efforts(self._asset, self._ids).write
        elif centre in ("qpos", "target"):
            self._write = self._write_relative
        elif centre == "limits":
            self._write = self._write_mapped

    def apply(self, action: torch.Tensor) -> None:
        """Write the targets or efforts of (N, A) actions."""
        self._write(self._value(action))

    def centre_and_scale(self) -> tuple[Sequence[float | str], Sequence[float | str]]:
        """Of targets in rad, m, rad/s or m/s, or of efforts; ``qpos`` or ``target`` in words."""
        centres, scales = self._centres, self._scales
        if self._maps:
            centres = self._joint_low + (centres - self._start) * self._slope
            scales = scales * self._slope
        if self._from in ("qpos", "target"):
            words = [f"{self._from} + {c:g}" if c else self._from for c in centres]
            return words, scales.tolist()
        return centres.tolist(), scales.tolist()

    def _write_read(self, value: Floats) -> None:
        """Write targets for what encoders read; the joints go there less their `encoder_bias`."""
        self._write_targets(value - self._asset.drives.encoder_bias[:, self._ids])

    def meaning(self) -> ActionMeaning:
        """Positions, velocities or efforts of joints; about ``qpos`` and ``target`` changes."""
        moves = self._from in ("qpos", "target")
        return ActionMeaning(
            quantity=f"joint {self._control}",
            mode="delta" if moves else "absolute",
            reference=self._from if moves else "",
            units=joint_units(self._asset, self._ids, self._control),
        )

    def _write_relative(self, value: Floats) -> None:
        self._write_targets(self._reference() + value)

    def _write_mapped(self, value: Floats) -> None:
        within = np.minimum(np.maximum(value, self._start), self._end)
        self._write_read(self._joint_low + (within - self._start) * self._slope)

    def _action_at(self, position: Floats) -> Floats:
        """The action for position targets, clamped to the bounds."""
        if self._maps:
            position = self._start + (position - self._joint_low) / self._slope
        return self._action_for(position)

    def home(self) -> Floats:
        """(A,) the action that goes to the initial position, or that causes no motion."""
        return self._action_for(0.0) if self._moves else self._action_at(self._default)

    def hold(self) -> Floats:
        """(N, A) or (A,) the action that keeps the present targets, or that causes no motion."""
        return self.home() if self._moves else self._action_at(self._targets())

    # -- as `MovesTool`, for position targets ----------------------------------------------------

    orientation: ClassVar[Orientation] = "any"
    tool_speeds: ClassVar[tuple[float, float]] = (math.inf, math.inf)

    @cached_property
    def solver(self) -> ArmSolver:
        """The kinematics of the tool that the joints move.

        Raises:
            ConfigError: If there is no such tool, or more than one, or it is no position control.
        """
        if self._control != "position":
            message = f"targets are positions, not {self._control}, where a tool follows a path"
            raise ConfigError([Problem("control", message)])
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
        if self._reference == self._targets and self._moves:
            ends = np.abs([self._value_of(self.low), self._value_of(self.high)]).min(axis=0)
            speeds = np.minimum(speeds, ends[columns] / self._period)
        return speeds

    def action_towards(self, pos: Floats, quat: Floats, qpos: Floats) -> Floats:
        """(N, A) the action for joint positions; see `MovesTool`."""
        now = self._reference() if self._moves else self._targets()
        target = now.copy()
        target[:, self._moving[0]] = qpos
        return self._action_for(target - now) if self._moves else self._action_at(target)
