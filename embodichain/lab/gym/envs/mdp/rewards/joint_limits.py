"""Penalties on joints near or beyond the limits of position, velocity and effort.

Joints without a limit count 0; if none of those picked has one, that is an error. Values are
positive unless said otherwise: give them negative weights.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from embodichain.lab.gym.envs.managers.param_types import Fraction
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp._joints import Joints, pick_joints
from embodichain.lab.gym.envs.mdp._judge import Judge, total

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = ["AppliedTorqueLimits", "JointLimitPenalty", "JointPosLimits", "JointVelLimits"]


@register_term("reward", "metric", name="joint_limit_penalty")
class JointLimitPenalty(Judge):
    """-sum max(0, margin - x), x the distance to the nearer limit as a share of the range.

    EmbodiChain's reward of the same name. Joints without two limits count 0.

    Args:
        robot_uid: The robot; None is the task's own.
        joint_ids: Its joints; None is all active ones.
        margin: Share of the range at either end that is penalised.
        entity_cfg: Robot and joints by name, instead of both (ours).

    Example:
        ``{func: joint_limit_penalty, weight: 0.1, params: {robot_uid: ur10, margin: 0.05}}``
    """

    def __init__(
        self,
        env: TermContext,
        robot_uid: str | None = None,
        joint_ids: list[int] | None = None,
        margin: Annotated[float, Field(gt=0, le=0.5)] = 0.1,
        entity_cfg: ResolvedEntity | None = None,
    ) -> None:
        self._joints = pick_joints(env, entity_cfg, robot_uid, joint_ids)
        self._margin = margin
        self._joints.position_limits()

    def value(self) -> F64:
        """(N,), not positive."""
        qpos = self._joints.qpos()
        low, high = self._joints.position_limits()
        limited = np.isfinite(low) & np.isfinite(high)
        width = np.subtract(high, low, where=limited, out=np.ones_like(low))
        near = np.minimum(qpos - low, high - qpos) / width
        return -total(np.where(limited, np.maximum(self._margin - near, 0.0), 0.0))


@register_term("reward", "metric", name="joint_pos_limits")
class JointPosLimits(Judge):
    """Sum over the picked joints of how far they are beyond their limits, rad or m.

    Isaac Lab's reward of the same name.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        soft_ratio: Share of the range, around its middle, that is allowed.

    Example:
        ``{func: joint_pos_limits, weight: -10.0, params: {entity_cfg: {uid: ur10}, soft_ratio: 0.9}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self, env: TermContext, entity_cfg: ResolvedEntity, soft_ratio: Fraction = 1.0
    ) -> None:
        self._joints, self._ratio = Joints(entity_cfg), soft_ratio
        self._joints.position_limits()

    def value(self) -> F64:
        """(N,)."""
        qpos = self._joints.qpos()
        low, high = self._joints.position_limits(self._ratio)
        return total(np.maximum(np.maximum(low - qpos, qpos - high), 0.0))


@register_term("reward", "metric", name="joint_vel_limits")
class JointVelLimits(Judge):
    """Sum over the picked joints of how much faster they are than allowed, at most 1 each.

    Isaac Lab's reward of the same name, rad/s or m/s. The limit is the smaller of the drive's
    `max_velocity` and the file's; physics enforces neither.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        soft_ratio: Share of the limit that is allowed.

    Example:
        ``{func: joint_vel_limits, weight: -1.0, params: {entity_cfg: {uid: ur10}, soft_ratio: 0.9}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self, env: TermContext, entity_cfg: ResolvedEntity, soft_ratio: Fraction = 1.0
    ) -> None:
        self._joints, self._ratio = Joints(entity_cfg), soft_ratio
        self._joints.velocity_limits()

    def value(self) -> F64:
        """(N,)."""
        beyond = np.abs(self._joints.qvel()) - self._joints.velocity_limits() * self._ratio
        return total(np.minimum(np.maximum(beyond, 0.0), 1.0))


@register_term("reward", "metric", name="applied_torque_limits")
class AppliedTorqueLimits(Judge):
    """Sum over the picked joints of effort beyond what is allowed, N m or N.

    Effort as in `joint_torques_l2`. The limit is the smaller of the drive's `max_effort` and the
    file's. A drive with a finite `max_effort` is cut off there: use a `soft_ratio` below 1. Isaac
    Lab's reward of this name counts what is cut off.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        soft_ratio: Share of the limit that is allowed.

    Example:
        ``{func: applied_torque_limits, weight: -0.01, params: {entity_cfg: {uid: ur10}, soft_ratio: 0.8}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self, env: TermContext, entity_cfg: ResolvedEntity, soft_ratio: Fraction = 1.0
    ) -> None:
        self._joints, self._ratio = Joints(entity_cfg), soft_ratio
        self._joints.effort_limits()

    def value(self) -> F64:
        """(N,)."""
        beyond = np.abs(self._joints.effort()) - self._joints.effort_limits() * self._ratio
        return total(np.maximum(beyond, 0.0))
