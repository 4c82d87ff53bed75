"""Penalties on joints: speed, acceleration, effort, power, and distance from the initial pose.

Values are positive unless said otherwise: give them negative weights. Limits are in `joint_limits`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import NonNegative
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _spatial
from embodichain.lab.gym.envs.mdp._joints import Joints, pick_joints
from embodichain.lab.gym.envs.mdp._judge import Judge, Recalling, total

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = [
    "JointAccL2",
    "JointDeviationL1",
    "JointPower",
    "JointTargetError",
    "JointTorquesL2",
    "JointVelL1",
    "JointVelL2",
    "JointVelocityPenalty",
    "StandStill",
]


@register_term("reward", "metric", name="joint_velocity_penalty")
class JointVelocityPenalty(Judge):
    """-|qvel|, the Euclidean norm over the picked joints, rad/s. EmbodiChain's of the same name.

    Args:
        robot_uid: The robot; None is the task's own.
        joint_ids: Its joints; None is all active ones.
        part_name: One of its control parts, instead of `joint_ids`.
        entity_cfg: Robot and joints by name, instead of all three (ours).

    Example:
        ``{func: joint_velocity_penalty, weight: 0.01, params: {robot_uid: ur10}}``
    """

    def __init__(
        self,
        env: TermContext,
        robot_uid: str | None = None,
        joint_ids: list[int] | None = None,
        part_name: str | None = None,
        entity_cfg: ResolvedEntity | None = None,
    ) -> None:
        self._joints = pick_joints(env, entity_cfg, robot_uid, joint_ids, part_name)

    def value(self) -> F64:
        """(N,), not positive."""
        return -_spatial.norm(self._joints.qvel())


@register_term("reward", "metric", name="joint_vel_l1")
class JointVelL1(Judge):
    """Sum of |qvel| over the picked joints, rad/s or m/s. Isaac Lab's of the same name.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.

    Example:
        ``{func: joint_vel_l1, weight: -0.01, params: {entity_cfg: {uid: ur10}}}``
    """

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity) -> None:
        self._joints = Joints(entity_cfg)

    def value(self) -> F64:
        """(N,)."""
        return total(np.abs(self._joints.qvel()))


@register_term("reward", "metric", name="joint_vel_l2")
class JointVelL2(Judge):
    """Sum of qvel^2 over the picked joints, (rad/s)^2 or (m/s)^2. Isaac Lab's of the same name.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.

    Example:
        ``{func: joint_vel_l2, weight: -0.001, params: {entity_cfg: {uid: ur10}}}``
    """

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity) -> None:
        self._joints = Joints(entity_cfg)

    def value(self) -> F64:
        """(N,)."""
        qvel = self._joints.qvel()
        return total(qvel * qvel)


@register_term("reward", "metric", name="joint_target_error")
class JointTargetError(Judge):
    """Mean of |target - qpos| over the picked joints: how far they are behind their targets.

    rad or m; 0 for joints without a drive.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.

    Example:
        ``{func: joint_target_error, weight: -0.1, params: {entity_cfg: {uid: ur10}}}``
    """

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity) -> None:
        self._joints = Joints(entity_cfg)

    def value(self) -> F64:
        """(N,), not negative."""
        targets = self._joints.asset.drives.read_target_qpos()[:, self._joints.ids]
        return total(np.abs(targets - self._joints.qpos())) / len(self._joints.ids)


@register_term("reward", "metric", name="joint_acc_l2")
class JointAccL2(Recalling):
    """Sum of squared joint accelerations, (rad/s^2)^2; 0 in an episode's first step.

    The acceleration is the mean one over the control step, (qvel - qvel_before) / dt. MuJoCo's own
    `qacc` is that before implicit integration, and with stiff, damped drives far from what joints
    do. Isaac Lab's of the same name takes the last physics step.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.

    Example:
        ``{func: joint_acc_l2, weight: -2.5e-7, params: {entity_cfg: {uid: ur10}}}``
    """

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity) -> None:
        super().__init__(env.num_envs)
        self._joints, self._dt = Joints(entity_cfg), env.step_dt

    def value(self) -> F64:
        """(N,)."""
        qvel = self._joints.qvel()
        qacc = (qvel - self.recall(qvel)[0]) / self._dt
        return np.where(self.calls > 1, total(qacc * qacc), 0.0)


@register_term("reward", "metric", name="joint_torques_l2")
class JointTorquesL2(Judge):
    """Sum of squared joint efforts, (N m)^2 or N^2, of the last physics step.

    Efforts are those of drives, their dampers, and efforts applied beside them. Isaac Lab's of the
    same name.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.

    Example:
        ``{func: joint_torques_l2, weight: -1.0e-5, params: {entity_cfg: {uid: ur10}}}``
    """

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity) -> None:
        self._joints = Joints(entity_cfg)

    def value(self) -> F64:
        """(N,)."""
        effort = self._joints.effort()
        return total(effort * effort)


@register_term("reward", "metric", name="joint_power")
class JointPower(Judge):
    """Sum of |effort x qvel| over the picked joints, W: times the time step, energy.

    Efforts as in `joint_torques_l2`, of the last physics step; velocities after it. mjlab's
    `electrical_power_cost` counts only what motors give: `positive_only`.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        positive_only: Whether joints that are braked count 0.

    Example:
        ``{func: joint_power, weight: -0.001, params: {entity_cfg: {uid: ur10}}}``
    """

    def __init__(
        self, env: TermContext, entity_cfg: ResolvedEntity, positive_only: bool = False
    ) -> None:
        self._joints, self._positive = Joints(entity_cfg), positive_only

    def value(self) -> F64:
        """(N,) W."""
        power = self._joints.effort() * self._joints.qvel()
        return total(np.maximum(power, 0.0) if self._positive else np.abs(power))


@register_term("reward", "metric", name="joint_deviation_l1")
class JointDeviationL1(Judge):
    """Sum of |qpos - initial qpos| over the picked joints, rad or m. Isaac Lab's of the same name.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.

    Example:
        ``{func: joint_deviation_l1, weight: -0.1, params: {entity_cfg: {uid: ur10, joint_names: ["Joint[456]"]}}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity) -> None:
        self._joints = Joints(entity_cfg)

    def value(self) -> F64:
        """(N,)."""
        return total(np.abs(self._joints.qpos() - self._joints.home))


@register_term("reward", "metric", name="stand_still")
class StandStill(Judge):
    """`joint_deviation_l1` where the command is nearly zero, else 0.

    Isaac Lab's `stand_still_joint_deviation_l1`, over all columns of the command.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        command_name: A velocity command.
        command_threshold: Euclidean norm below which the command counts as zero, in its units.

    Example:
        ``{func: stand_still, weight: -0.5, params: {entity_cfg: {uid: go}, command_name: velocity}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        command_name: str,
        command_threshold: NonNegative = 0.06,
    ) -> None:
        self._commands = env.command_manager
        self._name = self._commands.require(command_name, "command_name")
        self._joints, self._threshold = Joints(entity_cfg), command_threshold

    def value(self) -> F64:
        """(N,)."""
        deviation = total(np.abs(self._joints.qpos() - self._joints.home))
        speed = _spatial.norm(self._commands.values(self._name))
        return np.where(speed < self._threshold, deviation, 0.0)
