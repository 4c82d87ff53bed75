"""Actions that move a robot's tool: to a pose, or from where it is.

`EefTerm` takes one step of differential inverse kinematics a control step; `EefPose` and
`EefDeltaPose` compute its target.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Arm, Box3, UnitInterval
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import ActionMeaning
from embodichain.lab.gym.envs.managers.terms.per_name import JointClip, PerJoint, per_joint
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.gym.envs.mdp._tools import (
    JointRange,
    arm_solver,
    moving_joints,
    tool_orientation,
    usual_speeds,
)
from embodichain.lab.gym.envs.mdp.actions._tool_poses import (
    AbsolutePose,
    MotionColumns,
    in_axes,
    meaning_of_motions,
    meaning_of_poses,
    motion_between,
)
from embodichain.lab.gym.envs.mdp.actions.joint_action import JointTerm
from embodichain.lab.sim.solvers.chain import matmul
from embodichain.lab.sim.solvers.least_squares import IkTargets, pose_error
from embodichain.utils.arrays import contiguous, precise
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import (
    quat_conjugate,
    quat_to_matrix,
    rotvec_to_quat,
)

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.objects.arms.arm_solver import ArmSolver
    from embodichain.lab.sim.solvers.chain import Frames
    from embodichain.utils.array_types import Floats

__all__ = ["EefDeltaPose", "EefPose", "EefTerm"]

_POSITION_TOLERANCE = 1e-3
"""Error in metres above which a target is out of reach, where joints cannot come nearer."""
_ROTATION_TOLERANCE = 1e-2
"""Error in rad, likewise."""


class EefTerm(JointTerm):
    """An action term that moves a tool by one step of damped least squares a control step.

    The step starts at the drives' position targets, not at the measured positions: a robot that
    sags under gravity does not sink. It is scaled so that no joint exceeds its speed.

    Args:
        env: The environment.
        entity: The robot; picked joints move, the picked link is the tool.
        max_velocity: rad/s or m/s of joints; None is the file's limit, else pi rad/s or 1 m/s.
        posture_gain: The part of the way to the initial joint positions that a step takes in the
            null space of a redundant arm.

    Raises:
        ConfigError: If there is no tool, no joint that moves it, or a joint has no position drive.
    """

    def __init__(
        self,
        env: TermContext,
        entity: ResolvedEntity,
        max_velocity: PerJoint | None,
        posture_gain: float,
    ) -> None:
        self._solver = arm_solver(entity)
        super().__init__(env, moving_joints(entity, self._solver))
        self._count = env.num_envs
        self._largest_change: Floats = self._joint_speeds(max_velocity) * env.step_dt
        self._posture_gain = posture_gain
        self._measures: dict[str, Floats] = {}

    def _joint_speeds(self, max_velocity: PerJoint | None) -> Floats:
        """(k,) largest speeds of the joints."""
        if max_velocity is None:
            return usual_speeds(self._asset, self._ids, self._solver)
        speeds = per_joint(max_velocity, self.names, "max_velocity", named_by=self._named_by)
        if not (speeds > 0).all():
            raise ConfigError([Problem("max_velocity", "must be positive")])
        return speeds

    def _commanded(self) -> Floats:
        """(N, D) joint positions with the moving joints at their targets."""
        qpos: Floats = precise(self._asset.read_qpos().copy())
        qpos[:, self._ids] = self._targets()
        return qpos

    def _follow(self, commanded: Floats, frames: Frames, error: Floats) -> None:
        """Move targets by an error of the pose, (6, N) or (3, N), in the axes of the root."""
        step = self._solver.approach(
            commanded,
            frames,
            error,
            largest=self._largest_change,
            position_tolerance=_POSITION_TOLERANCE,
            rotation_tolerance=_ROTATION_TOLERANCE,
            posture=self._default if self._posture_gain else None,
            gain=self._posture_gain,
        )
        self._write_targets(commanded[:, self._ids] + step.change)
        self._measures = {
            "position_error": step.distance,
            "rotation_error": step.angle,
            "unreachable": step.is_out_of_reach.astype(np.float64),
        }
        if len(error) == 3:
            del self._measures["rotation_error"]

    def tool_pose(self) -> tuple[Floats, Floats]:
        """Measured position (N, 3) and orientation (N, 4) of the tool, in the environment."""
        return self._solver.forward(self._asset.read_qpos())

    def target_pose(self) -> tuple[Floats, Floats]:
        """The pose that a motion is added to, (N, 3) and (N, 4), in the environment."""
        return self._solver.forward(self._commanded())

    @property
    def solver(self) -> ArmSolver:
        """The kinematics of the tool."""
        return self._solver

    @property
    def joint_speeds(self) -> Floats:
        """(k,) largest speeds of the joints, rad/s or m/s, from root to tool."""
        return self._largest_change / self._period

    @property
    def joint_range(self) -> JointRange | None:
        """None: the joints' limits are the only bounds."""
        return None

    def action_for(self, shift: Floats, turn: Floats) -> Floats:
        """(N, A) the actions that move the tool, as far as their bounds allow.

        Args:
            shift: (N, 3) metres from `target_pose`, in the environment's axes.
            turn: (N, 3) rotation vectors, likewise.
        """
        raise NotImplementedError

    def action_towards(self, pos: Floats, quat: Floats, qpos: Floats) -> Floats:
        """(N, A) the action that moves the tool to a pose; see `MovesTool`."""
        return self.action_for(*motion_between(self.target_pose(), pos, quat))

    def metrics(self) -> Mapping[str, Floats]:
        """Errors in m and rad that the last step leaves, and whether the pose is out of reach."""
        return self._measures


@register_term("action", name="eef_pose")
class EefPose(EefTerm):
    """Moves a robot's tool towards a pose, by inverse kinematics, as fast as its joints may.

    Each control step the position targets of the joints move by one step of damped least squares.
    ``info["metrics"]`` has ``TERM/position_error`` (m), ``TERM/rotation_error`` (rad) and
    ``TERM/unreachable``: 1 where the pose is out of reach; the tool then goes as near as it can.

    Args:
        entity_cfg: The robot; control parts or joint names pick the joints that move, a link, site
            or geom is the tool (else the part's tool point in `solver_cfg`, else the farthest
            link).
        frame: Of the pose: ``base``, the robot's root, or ``world``, the environment.
        rotation: ``quat`` (qw, qx, qy, qz, normalized; 0 keeps the orientation), ``rpy`` (roll,
            pitch, yaw in rad about fixed axes, R = Rz Ry Rx), ``keep`` (the initial orientation in
            `frame`) or ``free``; the last two have no columns.
        position_range: [[x, y, z] low, [x, y, z] high] in metres, the bounds of the position; None
            is a box around all that the links could reach.
        max_velocity: rad/s or m/s of the joints: a number, a list per joint, or {joint regex:
            number}. None is the limit of the file or the drive, else pi rad/s or 1 m/s.
        posture_gain: In [0, 1]: the part of the way to the initial joint positions that a step
            takes in the null space, for arms with more joints than the pose needs.

    Raises:
        ConfigError: If the tool is not unique, or a joint has no drive with position targets.

    Example:
        ``{func: eef_pose, params: {of: {uid: ur10}, rotation: keep, position_range: [[0.3, -0.4, 0.1], [0.8, 0.4, 0.6]]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Arm,
        frame: Literal["base", "world"] = "base",
        rotation: Literal["quat", "rpy", "keep", "free"] = "quat",
        position_range: Box3 | None = None,
        max_velocity: PerJoint | None = None,
        posture_gain: UnitInterval = 0.0,
    ) -> None:
        super().__init__(env, entity_cfg, max_velocity, posture_gain)
        self._is_world = frame == "world"
        self._poses = AbsolutePose(
            asset=self._asset,
            solver=self._solver,
            env=env,
            frame=frame,
            rotation=rotation,
            position_range=position_range,
        )
        self.names = self._poses.names
        self.low = self._poses.low
        self.high = self._poses.high
        self.orientation = tool_orientation(rotation)
        self.tool_speeds = (np.inf, np.inf)

    def apply(self, action: torch.Tensor) -> None:
        """Move the targets towards the poses of (N, A) actions."""
        commanded = self._commanded()
        pos, quat = self._poses.asked(action, lambda: self._pose(commanded)[1])
        target = self._solver.to_root(pos, quat) if self._is_world else IkTargets.of(pos, quat)
        frames = self._solver.frames(commanded)
        self._follow(commanded, frames, pose_error(frames, target))

    def action_for(self, shift: Floats, turn: Floats) -> Floats:
        """(N, A) the actions that move the tool; arguments as of `EefTerm.action_for`."""
        return self._poses.action_for(*self.target_pose(), shift, turn)

    def _pose(self, qpos: Floats) -> tuple[Floats, Floats]:
        """The tool's pose in `frame` at joint positions (N, D)."""
        if self._is_world:
            return self._solver.forward(qpos)
        return self._solver.forward_in_root(qpos)

    def centre_and_scale(self) -> tuple[Sequence[float | str], Sequence[float | str]]:
        """Of the pose itself, in m and as of `rotation`."""
        return [0.0] * self.action_dim, [1.0] * self.action_dim

    def meaning(self) -> ActionMeaning:
        """Poses of the tool in `frame`."""
        return meaning_of_poses(self.names, "world" if self._is_world else "base")

    def home(self) -> Floats:
        """(A,) the action that goes to the tool's initial pose."""
        return self._poses.home

    def hold(self) -> Floats:
        """(N, A) the action that keeps the present targets."""
        return self._poses.action_at(*self._pose(self._commanded()))


@register_term("action", name="eef_delta_pose")
class EefDeltaPose(EefTerm):
    """Moves a robot's tool from where it is, by scale x clamp(action, clip) each control step.

    The first three columns move it, the others rotate it by a rotation vector. Inverse kinematics
    and metrics are those of `eef_pose`; a step that is out of reach is done as far as it can be.

    Args:
        entity_cfg: The robot, as of `eef_pose`.
        frame: Of the motion: ``base``, the axes of the robot's root, ``world``, those of the
            environment, or ``tool``, the tool's own.
        rotation: ``command``, or ``keep`` (the orientation does not change) or ``free``; the last
            two have no columns.
        reference: The pose to which the motion is added: ``target``, that of the drives' targets,
            so that the tool does not sink under gravity; ``qpos``, the measured one.
        scale: m and rad per unit of action: a number, a list per column, or {column regex: number};
            columns are x, y, z, rx, ry, rz. None is 0.02 m and 0.1 rad.
        clip: Bounds of the action: [low, high], a list of pairs, or {column regex: [low, high]};
            None is [-1, 1].
        max_velocity: As of `eef_pose`.
        posture_gain: As of `eef_pose`.

    Raises:
        ConfigError: If the tool is not unique, or a joint has no drive with position targets.

    Example:
        ``{func: eef_delta_pose, params: {of: {uid: ur10}, frame: tool, scale: {"[xyz]": 0.01, "r[xyz]": 0.05}}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Arm,
        frame: Literal["base", "world", "tool"] = "base",
        rotation: Literal["command", "keep", "free"] = "command",
        reference: Literal["target", "qpos"] = "target",
        scale: PerJoint | None = None,
        clip: JointClip | None = None,
        max_velocity: PerJoint | None = None,
        posture_gain: UnitInterval = 0.0,
    ) -> None:
        super().__init__(env, entity_cfg, max_velocity, posture_gain)
        self._frame = frame
        self._rotation = rotation
        self._measured = reference == "qpos"
        self._columns = MotionColumns(env, rotation, scale, clip)
        self.names = self._columns.names
        self.low = self._columns.low
        self.high = self._columns.high
        self.orientation = tool_orientation(rotation)
        self.tool_speeds = self._columns.largest(1.0 / env.step_dt)

    def target_pose(self) -> tuple[Floats, Floats]:
        """The pose that a motion is added to, (N, 3) and (N, 4), in the environment."""
        if self._measured:
            return self.tool_pose()
        return super().target_pose()

    def action_for(self, shift: Floats, turn: Floats) -> Floats:
        """(N, A) the actions that move the tool; see `EefTerm.action_for`."""
        _, quat = self.target_pose()
        shift, turn = in_axes(self._solver, self._frame, quat, shift, turn)
        return self._columns.action_for(shift, turn)

    def centre_and_scale(self) -> tuple[Sequence[float | str], Sequence[float | str]]:
        """About the pose measured or targeted, in m and rad."""
        reference = "qpos" if self._measured else "target"
        return [reference] * self.action_dim, self._columns.scale.tolist()

    def meaning(self) -> ActionMeaning:
        """Motions of the tool along and about the axes of `frame`."""
        reference = "qpos" if self._measured else "target"
        return meaning_of_motions(self.names, self._frame, reference)

    def apply(self, action: torch.Tensor) -> None:
        """Move the targets by (N, A) actions."""
        value = contiguous(self._columns.value(action).T, np.float64)
        commanded = self._commanded()
        frames = self._solver.frames(commanded)
        reference = frames
        if self._measured:
            reference = self._solver.frames(self._asset.read_qpos())
        motion = self._in_root(value.reshape(-1, 3, self._count), reference)
        if self._rotation == "keep":
            motion = np.concatenate([motion, np.zeros_like(motion)])
        if self._measured:
            error = pose_error(frames, _move(reference, motion))
        else:
            # The targets' own pose plus the motion: their difference is the motion.
            error = motion.reshape(-1, self._count)
        self._follow(commanded, frames, error)

    def _in_root(self, vectors: Floats, reference: Frames) -> Floats:
        """Vectors (v, 3, N) of `frame` in the axes of the root."""
        if self._frame == "base":
            return vectors
        axes = reference.rotation
        if self._frame == "world":
            _, root_quat = self._solver.root_pose()
            axes = np.moveaxis(quat_to_matrix(quat_conjugate(root_quat)), 0, -1)
        return np.stack([matmul(axes, vector) for vector in vectors])


def _move(reference: Frames, motion: Floats) -> IkTargets:
    """The pose of the tool, translated and, if there is one, rotated by a rotation vector."""
    if len(motion) == 1:
        return IkTargets(reference.position + motion[0], None)
    turn = np.moveaxis(quat_to_matrix(rotvec_to_quat(motion[1].T)), 0, -1)
    return IkTargets(reference.position + motion[0], matmul(turn, reference.rotation))
