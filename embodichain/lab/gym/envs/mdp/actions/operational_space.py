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
    JointRange,
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
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.objects.arms.arm_solver import ArmSolver
    from embodichain.utils.array_types import Floats

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
        max_position_error: Error in metres beyond which the spring pulls no more, so that the tool
            approaches a far pose at about max_position_error sqrt(K) / (2 r), and contact forces are
            bounded.
        max_rotation_error: Error in rad, likewise.
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
        joint_names = self.names
        if not decoupling:
            env.arrays.require_host("the modes of its dampers", "decoupling")

        poses: AbsolutePose | RelativePose
        if command == "pose":
            _refuse_params(command, scale=scale, clip=clip)
            if frame == "tool":
                raise ConfigError([Problem("frame", "of a pose it is base or world")])
            columns = "quat" if rotation == "command" else rotation
            poses = AbsolutePose(
                asset=self._asset,
                solver=solver,
                env=env,
                frame=frame,
                rotation=columns,
                position_range=position_range,
            )
        else:
            _refuse_params(command, position_range=position_range)
            if rotation == "quat" or rotation == "rpy":
                raise ConfigError([Problem("rotation", f"{rotation} is for command: pose")])
            poses = RelativePose(
                solver=solver, env=env, frame=frame, rotation=rotation, scale=scale, clip=clip
            )
        self._poses = poses
        self.names = poses.names
        self.low = poses.low
        self.high = poses.high
        self._solver = solver
        self._frame = frame
        self._measured = reference == "qpos"
        self._keeps_orientation = rotation == "keep"
        self._is_rotation_free = rotation == "free"
        self.orientation = tool_orientation(rotation)

        axes = _AXES[:3] if rotation == "free" else _AXES
        if stiffness is None:
            stiffness = 150.0 if decoupling else [1000.0] * 3 + [50.0] * (len(axes) - 3)
        gains = _gains(stiffness, axes, "stiffness")
        ratios = _gains(damping_ratio, axes, "damping_ratio")
        if posture is None:
            posture_qpos = self._default
        else:
            posture_qpos = per_joint(posture, joint_names, "posture", named_by=self._named_by)
        is_redundant = len(joint_names) > len(axes)
        max_errors = (max_position_error, max_rotation_error)
        self._dynamics = ArmDynamics(self._asset, self._ids.tolist(), solver.chain.tool)
        self._impedance = Impedance(
            dynamics=self._dynamics,
            stiffness=gains,
            ratio=ratios,
            most=max_errors,
            decoupling=decoupling,
            posture=posture_qpos,
            pull=posture_stiffness if is_redundant else 0.0,
        )
        self._efforts = Efforts(self._asset, self._ids)
        if not decoupling:
            # The rate at which the spring pulls depends on the mass then: the default's is taken.
            gains = np.full(6, 150.0)
            ratios = np.ones(6)
        self.tool_speeds = self._largest_speeds(max_errors, gains, ratios)

        count = env.num_envs
        full = env.arrays.full
        self._pos: Floats = full((count, 3), 0.0)
        self._quat: Floats = env.arrays.put(np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)))
        self._begins = full(count, True, np.bool_)  # no pose was asked for in this episode
        self._error: Floats = full((len(axes), count), 0.0)
        self._saturated = full(count, False, np.bool_)

    def _largest_speeds(
        self, max_errors: tuple[float, float], stiffness: Floats, ratio: Floats
    ) -> tuple[float, float]:
        """Speeds in m/s and rad/s at which the spring pulls the tool behind a target."""
        rate = np.sqrt(stiffness) / (2.0 * np.maximum(ratio, 0.1))
        distance, angle = max_errors
        if isinstance(self._poses, RelativePose):
            # A target that is set anew in each step is no farther ahead than one motion.
            longest_shift, longest_turn = self._poses.largest(1.0)
            distance = min(distance, longest_shift)
            angle = min(angle, longest_turn)
        return distance * float(rate[:3].max()), angle * float(rate[3:].max(initial=0.0))

    @property
    def solver(self) -> ArmSolver:
        """The kinematics of the tool."""
        return self._solver

    @property
    def joint_speeds(self) -> Floats:
        """(k,) largest speeds of the joints, rad/s or m/s, from root to tool."""
        return usual_speeds(self._asset, self._ids, self._solver)

    @property
    def joint_range(self) -> JointRange | None:
        """None: the joints' limits are the only bounds."""
        return None

    def action_towards(self, pos: Floats, quat: Floats, qpos: Floats) -> Floats:
        """(N, A) the action that moves the tool to a pose; see `MovesTool`."""
        return self.action_for(*motion_between(self.target_pose(), pos, quat))

    def _refuse_drives(self) -> None:
        """Refuse joints with a drive that pulls or damps."""
        drives = self._asset.drives
        has_drive = np.asarray(self._asset.index.actuator_ids)[self._ids] >= 0
        has_stiffness = self._arrays.host(drives.stiffness)[0, self._ids] > 0
        has_damping = self._arrays.host(drives.damping)[0, self._ids] > 0
        acts = has_drive & (has_stiffness | has_damping)
        if not acts.any():
            return
        names = [self.names[i] for i in np.flatnonzero(acts)]
        off = ", ".join(f"{name}: 0" for name in names)
        message = (
            f"joints {names} have drives, which would act against the efforts of this term; "
            f"switch them off: drive_pros: {{stiffness: {{{off}}}, damping: {{{off}}}}}, or "
            "drive_pros: {stiffness: 0, damping: 0} for the whole robot"
        )
        raise ConfigError([Problem("entity_cfg", message)])

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Forget the poses asked for in these environments."""
        self._begins[slice(None) if env_ids is None else env_ids] = True

    def apply(self, action: torch.Tensor) -> None:
        """Set the poses that the tool is pulled to, from (N, A) actions."""
        pose = self.tool_pose()
        requested_pos, requested_quat = self._requested_pose(pose)
        poses = self._poses
        if isinstance(poses, AbsolutePose):
            in_frame = poses.in_frame
            asked_pose = poses.asked(action, lambda: in_frame(requested_pos, requested_quat)[1])
            pos, quat = poses.in_world(*asked_pose)
        else:
            start_pos, start_quat = pose if self._measured else (requested_pos, requested_quat)
            if self._keeps_orientation:
                start_quat = requested_quat
            pos, quat = poses.asked(action, start_pos, start_quat)
        self._pos[:] = pos
        self._quat[:] = requested_quat if quat is None else quat
        self._begins[:] = False
        self._saturated[:] = False

    def tool_pose(self) -> tuple[Floats, Floats]:
        """Measured position (N, 3) and orientation (N, 4) of the tool, in the environment."""
        pose = self._dynamics.pose()
        return pose[:, :3], pose[:, 3:]

    def _requested_pose(self, tool_pose: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
        """The pose that actions last asked for, (N, 3) and (N, 4); at first the measured one."""
        pos, quat = tool_pose
        begins = self._begins[:, None]
        return np.where(begins, pos, self._pos), np.where(begins, quat, self._quat)

    def target_pose(self) -> tuple[Floats, Floats]:
        """The pose that a motion is added to, (N, 3) and (N, 4), in the environment."""
        pose = self.tool_pose()
        if self._measured and isinstance(self._poses, RelativePose):
            return pose
        return self._requested_pose(pose)

    def action_for(self, shift: Floats, turn: Floats) -> Floats:
        """(N, A) the actions that move the tool; arguments as of `EefTerm.action_for`."""
        pos, quat = self.target_pose()
        if isinstance(self._poses, AbsolutePose):
            return self._poses.action_for(pos, quat, shift, turn)
        return self._poses.motion_for(quat, shift, turn)

    def before_physics(self) -> None:
        """Apply the efforts for the current state."""
        quat = None if self._is_rotation_free else self._quat
        self._error = self._impedance.error(self._pos, quat)
        axes: Floats | None = None
        if self._frame == "base":
            _, axes = self._solver.root_pose()
        elif self._frame == "tool":
            _, axes = self.tool_pose()
        efforts = contiguous(self._impedance.efforts(self._error, axes).T)
        applied = self._efforts.write(efforts)
        self._saturated |= (applied != efforts).any(axis=1)

    def metrics(self) -> Mapping[str, Floats]:
        """Errors in m and rad before the last physics step; whether an effort limit was reached."""
        squares = self._error * self._error
        metrics = {
            "position_error": np.sqrt(squares[0] + squares[1] + squares[2]),
            "saturated": self._saturated.astype(np.float64),
        }
        if len(squares) > 3:
            metrics["rotation_error"] = np.sqrt(squares[3] + squares[4] + squares[5])
        return metrics

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
        reference = "qpos" if self._measured else "target"
        return meaning_of_motions(self.names, self._frame, reference)

    def home(self) -> Floats:
        """(A,) the action for the tool's initial pose; of ``delta``, no motion."""
        if isinstance(self._poses, AbsolutePose):
            return self._poses.home
        return super().home()

    def hold(self) -> Floats:
        """(N, A) the action for the pose that was asked for; of ``delta``, (A,), no motion."""
        poses = self._poses
        if isinstance(poses, RelativePose):
            return self.home()
        pos, quat = self._requested_pose(self.tool_pose())
        return poses.action_at(*poses.in_frame(pos, quat))


def _refuse_params(command: str, **params: object) -> None:
    """Refuse parameters that the command does not have, where they are set."""
    names = [name for name, value in params.items() if value is not None]
    if names:
        message = f"has no meaning with command: {command}"
        raise ConfigError([Problem(name, message) for name in names])


def _gains(value: PerJoint, axes: tuple[str, ...], name: str) -> Floats:
    """(6 or 3,) gains of the axes."""
    if name == "damping_ratio" and isinstance(value, dict):
        # Axes that are not in a map are critically damped; a later key of a map wins.
        value = {".*": 1.0, **value}
    gains = per_joint(value, axes, name, "column")
    if (gains < 0).any():
        raise ConfigError([Problem(name, "must not be negative")])
    return gains
