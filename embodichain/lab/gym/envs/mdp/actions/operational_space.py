"""The action that moves a robot's tool by joint efforts: impedance control in operational space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Arm, Box3, NonNegative, Positive
from embodichain.lab.gym.envs.managers.term import ActionMeaning
from embodichain.lab.gym.envs.managers.terms.per_name import JointClip, PerJoint, per_joint
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.gym.envs.mdp._tools import (
    arm_solver,
    moving_joints,
    tool_orientation,
    usual_speeds,
)
from embodichain.lab.gym.envs.mdp.actions._tool_poses import (
    AbsolutePose,
    RelativePose,
    meaning_of_motions,
    meaning_of_poses,
    motion_between,
)
from embodichain.lab.gym.envs.mdp.actions.joint_action import Efforts, JointTerm
from embodichain.lab.sim.objects.arms.arm_dynamics import ArmDynamics
from embodichain.lab.sim.objects.arms.impedance import Impedance
from embodichain.utils.arrays import contiguous
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import F64, EnvIndex
    from embodichain.lab.sim.objects.arms.arm_solver import ArmSolver

__all__ = ["OperationalSpace"]

_AXES = ("x", "y", "z", "rx", "ry", "rz")
Rotation = Literal["command", "quat", "rpy", "keep", "free"]


@register_term("action", name="operational_space")
class OperationalSpace(JointTerm):
    """Moves a robot's tool by joint efforts: a spring and a damper between the tool and a pose.

    Before every physics step, with the tool's Jacobian J, the mass matrix M of the joints, the
    error e of the pose and the velocity v of the tool: tau = J^T L (K e - D v - J a) + M a + b,
    where L = (J M^-1 J^T)^-1 is the tool's apparent mass, D = 2 r sqrt(K) with the damping ratio
    r, a the posture's accelerations, and b balances gravity, Coriolis and centrifugal forces.
    Khatib, "A unified approach for motion and force control of robot manipulators: the operational
    space formulation", IEEE Journal of Robotics and Automation 3(1), 1987; as robosuite's OSC_POSE
    and Isaac Lab's OperationalSpaceControllerAction. What the robot carries is not balanced.

    ``info["metrics"]`` has ``TERM/position_error`` (m), ``TERM/rotation_error`` (rad), before the
    last physics step, and ``TERM/saturated``: 1 where an effort limit was reached in the step.

    The joints' drives must be off: ``drive_pros: {stiffness: {JOINTS: 0}, damping: {JOINTS: 0},
    max_effort: file}``; `max_effort` limits the efforts.

    Args:
        entity_cfg: The robot; control parts or joint names pick the joints that move, a link, site
            or geom is the tool (else the part's tool point in `solver_cfg`, else the farthest
            link).
        command: ``delta``, columns as of `eef_delta_pose`, or ``pose``, as of `eef_pose`.
        frame: Of the command and of the axes of stiffness: ``base``, the robot's root, ``world``,
            the environment, or, of ``delta``, ``tool``.
        rotation: ``command`` (of ``delta`` a rotation vector, of ``pose`` a quaternion), ``keep`` or
            ``free``; of ``pose`` also ``quat`` or ``rpy``.
        reference: The pose to which ``delta`` is added: ``qpos``, the measured one, or ``target``,
            the previous one, which bears loads but can run away from a tool that is blocked.
        scale: As of `eef_delta_pose`; of ``delta`` only.
        clip: As of `eef_delta_pose`; of ``delta`` only.
        position_range: As of `eef_pose`; of ``pose`` only.
        stiffness: Of the axes x, y, z, rx, ry, rz: a number, a list, or {axis regex: number}; 0 is
            a free axis. With `decoupling` in 1/s^2, None is 150; without in N/m and N m/rad, None
            is 1000 and 50.
        damping_ratio: r, likewise; 1 is critical, and that of axes that are not in a map.
        max_position_error: m: the spring pulls no more than at this error, so that the tool approaches
            a far pose at about max_position_error sqrt(K) / (2 r), and contact forces are bounded.
        max_rotation_error: rad, likewise.
        decoupling: Whether L shapes the forces, so that the axes do not disturb each other. Without
            it, the force of the spring is K e, and the damper is critical at r = 1 with L as mass.
        posture_stiffness: 1/s^2 towards the posture, critically damped, in the null space of arms
            with more joints than the pose needs.
        posture: rad or m: a number, a list per joint, or {joint regex: number}; None is the initial
            positions.

    Raises:
        ConfigError: If the tool is not unique, a joint has a drive that is on, or a parameter is of
            the other command.

    Example:
        ``{func: operational_space, params: {of: {uid: panda, joint_names: "panda_joint.*"}, stiffness: {"[xyz]": 200, "r[xyz]": 100}}}``
    """  # noqa: E501  (an example is one line)

    saved: ClassVar[tuple[str, ...]] = ("_pos", "_quat", "_begins")

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Arm,
        command: Literal["delta", "pose"] = "delta",
        frame: Literal["base", "world", "tool"] = "base",
        rotation: Rotation = "command",
        reference: Literal["target", "qpos"] = "qpos",
        scale: PerJoint | None = None,
        clip: JointClip | None = None,
        position_range: Box3 | None = None,
        stiffness: PerJoint | None = None,
        damping_ratio: PerJoint = 1.0,
        max_position_error: Positive = 0.1,
        max_rotation_error: Positive = 0.5,
        decoupling: bool = True,
        posture_stiffness: NonNegative = 10.0,
        posture: PerJoint | None = None,
    ) -> None:
        solver = arm_solver(entity_cfg)
        super().__init__(env, moving_joints(entity_cfg, solver), driven=False)
        self._refuse_drives()
        count, joints = env.num_envs, self.names
        if not decoupling:
            env.arrays.require_host("the modes of its dampers", "decoupling")
        given = {"scale": scale, "clip": clip, "position_range": position_range}
        poses: AbsolutePose | RelativePose
        if command == "pose":
            _refuse(given, ("scale", "clip"), "pose")
            if frame == "tool":
                raise ConfigError([Problem("frame", "of a pose it is base or world")])
            turned = "quat" if rotation == "command" else rotation
            poses = AbsolutePose(self._asset, solver, env, frame, turned, position_range)
        else:
            _refuse(given, ("position_range",), "delta")
            if rotation == "quat" or rotation == "rpy":
                raise ConfigError([Problem("rotation", f"{rotation} is for command: pose")])
            poses = RelativePose(solver, env, frame, rotation, scale, clip)
        self._poses, self.names, self.low, self.high = poses, poses.names, poses.low, poses.high
        self._solver, self._frame = solver, frame
        self._measured, self._keeps = reference == "qpos", rotation == "keep"
        axes = _AXES[:3] if rotation == "free" else _AXES
        if stiffness is None:
            stiffness = 150.0 if decoupling else [1000.0] * 3 + [50.0] * (len(axes) - 3)
        gains = _gains(stiffness, axes, "stiffness"), _gains(damping_ratio, axes, "damping_ratio")
        target = self._default
        if posture is not None:
            target = per_joint(posture, joints, "posture", named_by=self._named_by)
        pull = posture_stiffness if len(joints) > len(axes) else 0.0
        self._dynamics = ArmDynamics(self._asset, self._ids.tolist(), solver.chain.tool)
        most = max_position_error, max_rotation_error
        self._impedance = Impedance(self._dynamics, *gains, most, decoupling, target, pull)
        self._efforts = Efforts(self._asset, self._ids)
        full = env.arrays.full
        self._pos: F64 = full((count, 3), 0.0)
        self._quat: F64 = env.arrays.put(np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)))
        self._begins = full(count, True, np.bool_)  # no pose was asked for in this episode
        self._free = rotation == "free"
        self.orientation = tool_orientation(rotation)
        self.tool_speeds = self._largest_speeds(most, *gains, decoupling)
        self._error: F64 = full((len(axes), count), 0.0)
        self._saturated = full(count, False, np.bool_)

    def _largest_speeds(
        self, most: tuple[float, float], stiffness: F64, ratio: F64, decoupling: bool
    ) -> tuple[float, float]:
        """Speeds in m/s and rad/s at which the spring pulls the tool behind a target."""
        if not decoupling:  # then the rate depends on the mass: that of the default is taken
            stiffness, ratio = np.full(6, 150.0), np.ones(6)
        rate = np.sqrt(stiffness) / (2.0 * np.maximum(ratio, 0.1))
        ahead = most
        if isinstance(self._poses, RelativePose):
            step = self._poses.largest(1.0)
            ahead = min(most[0], step[0]), min(most[1], step[1])
        return ahead[0] * float(rate[:3].max()), ahead[1] * float(rate[3:].max(initial=0.0))

    @property
    def solver(self) -> ArmSolver:
        """The kinematics of the tool."""
        return self._solver

    @property
    def joint_speeds(self) -> F64:
        """(k,) largest speeds of the joints, rad/s or m/s, from root to tool."""
        return usual_speeds(self._asset, self._ids, self._solver)

    def action_towards(self, pos: F64, quat: F64, qpos: F64) -> F64:
        """(N, A) the action that moves the tool to a pose; see `MovesTool`."""
        return self.action_for(*motion_between(self.target_pose(), pos, quat))

    def _refuse_drives(self) -> None:
        """Refuse joints with a drive that pulls or damps."""
        drives = self._asset.drives
        driven = np.asarray(self._asset.entity.actuator_ids)[self._ids] >= 0
        gains = (self._arrays.host(g) for g in (drives.stiffness, drives.damping))
        stiff, damped = (g[0, self._ids] > 0 for g in gains)
        on = driven & (stiff | damped)
        if on.any():
            names = [name for name, yes in zip(self.names, on, strict=True) if yes]
            off = f"{{{', '.join(f'{name}: 0' for name in names)}}}"
            message = (
                f"joints {names} have drives, which would act against the efforts of this term; "
                f"switch them off: drive_pros: {{stiffness: {off}, damping: {off}}}, or "
                "drive_pros: {stiffness: 0, damping: 0} for the whole robot"
            )
            raise ConfigError([Problem("entity_cfg", message)])

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Forget the poses asked for in these environments."""
        self._begins[slice(None) if env_ids is None else env_ids] = True

    def apply(self, action: torch.Tensor) -> None:
        """Set the poses that the tool is pulled to, from (N, A) actions."""
        (now, asked), poses = self._poses_now(), self._poses
        if isinstance(poses, AbsolutePose):
            frame = poses.in_frame
            pos, quat = poses.in_world(*poses.asked(action, lambda: frame(*asked)[1]))
        else:
            start, turn = now if self._measured else asked
            pos, quat = poses.asked(action, start, asked[1] if self._keeps else turn)
        self._pos[:] = pos
        self._quat[:] = asked[1] if quat is None else quat
        self._begins[:] = False
        self._saturated[:] = False

    def _poses_now(self) -> tuple[tuple[F64, F64], tuple[F64, F64]]:
        """Position (N, 3) and orientation (N, 4) measured, and asked for; the same at first."""
        pose, new = self._dynamics.pose(), self._begins[:, None]
        pos, quat = pose[:, :3], pose[:, 3:]
        return (pos, quat), (np.where(new, pos, self._pos), np.where(new, quat, self._quat))

    def tool_pose(self) -> tuple[F64, F64]:
        """Measured position (N, 3) and orientation (N, 4) of the tool, in the environment."""
        return self._poses_now()[0]

    def target_pose(self) -> tuple[F64, F64]:
        """The pose that a motion is added to, (N, 3) and (N, 4), in the environment."""
        now, asked = self._poses_now()
        measured = self._measured and not isinstance(self._poses, AbsolutePose)
        return now if measured else asked

    def action_for(self, shift: F64, turn: F64) -> F64:
        """(N, A) the actions that move the tool; arguments as of `EefTerm.action_for`."""
        poses, (pos, quat) = self._poses, self.target_pose()
        if isinstance(poses, AbsolutePose):
            return poses.action_for(pos, quat, shift, turn)
        return poses.motion_for(quat, shift, turn)

    def before_physics(self) -> None:
        """Apply the efforts for the current state."""
        quat = None if self._free else self._quat
        self._error = self._impedance.error(self._pos, quat)
        axes: F64 | None = None
        if self._frame == "base":
            axes = self._solver.root_pose()[1]
        elif self._frame == "tool":
            axes = self._dynamics.pose()[:, 3:]
        wanted = contiguous(self._impedance.efforts(self._error, axes).T)
        self._saturated |= (self._efforts.write(wanted) != wanted).any(axis=1)

    def metrics(self) -> Mapping[str, F64]:
        """Errors in m and rad before the last physics step; whether an effort limit was reached."""
        squares = self._error * self._error
        found = {
            "position_error": np.sqrt(squares[0] + squares[1] + squares[2]),
            "saturated": self._saturated.astype(np.float64),
        }
        if len(squares) > 3:
            found["rotation_error"] = np.sqrt(squares[3] + squares[4] + squares[5])
        return found

    def centre_and_scale(self) -> tuple[Sequence[float | str], Sequence[float | str]]:
        """Of ``delta``, about the measured or the previous pose; of ``pose`` the pose itself."""
        if isinstance(self._poses, AbsolutePose):
            return [0.0] * self.action_dim, [1.0] * self.action_dim
        about = "qpos" if self._measured else "target"
        return [about] * self.action_dim, self._poses.scale.tolist()

    def meaning(self) -> ActionMeaning:
        """Poses of the tool in `frame`, or motions along and about its axes."""
        if isinstance(self._poses, AbsolutePose):
            return meaning_of_poses(self.names, self._frame)
        return meaning_of_motions(self.names, self._frame, "qpos" if self._measured else "target")

    def home(self) -> F64:
        """(A,) the action for the tool's initial pose; of ``delta``, no motion."""
        poses = self._poses
        return poses.home if isinstance(poses, AbsolutePose) else super().home()

    def hold(self) -> F64:
        """(N, A) the action for the pose that was asked for; of ``delta``, (A,), no motion."""
        poses = self._poses
        if not isinstance(poses, AbsolutePose):
            return self.home()
        return poses.action_at(*poses.in_frame(*self._poses_now()[1]))


def _refuse(given: Mapping[str, object], names: tuple[str, ...], command: str) -> None:
    """Refuse parameters that the command does not have."""
    strange = [name for name in names if given[name] is not None]
    if strange:
        raise ConfigError([Problem(n, f"has no meaning with command: {command}") for n in strange])


def _gains(value: PerJoint, axes: tuple[str, ...], name: str) -> F64:
    """(6 or 3,) gains of the axes."""
    if name == "damping_ratio" and isinstance(value, dict):
        value = {".*": 1.0, **value}
    found = per_joint(value, axes, name, "column")
    if (found < 0).any():
        raise ConfigError([Problem(name, "must not be negative")])
    return found
