"""Terminations of joints beyond their limits, or beyond bounds given.

Joints without a limit never end anything; if none of those picked has one, that is an error.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Bounds, Fraction, Positive
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp._joints import Joints
from embodichain.lab.gym.envs.mdp._judge import Judge, any_column

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

    Mask = NDArray[np.bool_]

__all__ = [
    "JointEffortOutOfLimit",
    "JointPosOutOfLimit",
    "JointPosOutside",
    "JointVelOutOfLimit",
]


@register_term("termination", "metric", name="joint_pos_out_of_limit")
class JointPosOutOfLimit(Judge):
    """True where a picked joint is beyond its position limits. Isaac Lab's of the same name.

    Limits give way a little under load: a `soft_ratio` of 1 may see that.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        soft_ratio: Share of the range, around its middle, that is allowed.

    Example:
        ``{func: joint_pos_out_of_limit, kind: fail, params: {entity_cfg: {uid: ur10}, soft_ratio: 0.95}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self, env: TermContext, entity_cfg: ResolvedEntity, soft_ratio: Fraction = 1.0
    ) -> None:
        self._joints, self._ratio = Joints(entity_cfg), soft_ratio
        self._joints.position_limits()

    def value(self) -> Mask:
        """(N,) bool."""
        return _any_outside(self._joints.qpos(), *self._joints.position_limits(self._ratio))


@register_term("termination", "metric", name="joint_pos_outside")
class JointPosOutside(Judge):
    """True where a picked joint is outside bounds. Isaac Lab's `joint_pos_out_of_manual_limit`.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        bounds: [low, high] in rad or m; either may be infinite.

    Example:
        ``{func: joint_pos_outside, kind: fail, params: {entity_cfg: {uid: ur10, joint_names: [Joint1]}, bounds: [-3, 3]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity, bounds: Bounds) -> None:
        self._joints = Joints(entity_cfg)
        self._low, self._high = bounds

    def value(self) -> Mask:
        """(N,) bool."""
        return _any_outside(self._joints.qpos(), self._low, self._high)


def _any_outside(values: F64, low: F64 | float, high: F64 | float) -> Mask:
    return any_column((values < low) | (values > high))


@register_term("termination", "metric", name="joint_vel_out_of_limit")
class JointVelOutOfLimit(Judge):
    """True where a picked joint is faster than allowed. Isaac Lab's of the same name.

    With `max_velocity` its `joint_vel_out_of_manual_limit`.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        max_velocity: rad/s or m/s; None is the smaller of the drive's `max_velocity` and the file's
            limit.

    Example:
        ``{func: joint_vel_out_of_limit, kind: fail, params: {entity_cfg: {uid: ur10}, max_velocity: 6.0}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self, env: TermContext, entity_cfg: ResolvedEntity, max_velocity: Positive | None = None
    ) -> None:
        self._joints, self._max = Joints(entity_cfg), max_velocity
        if max_velocity is None:
            self._joints.velocity_limits()

    def value(self) -> Mask:
        """(N,) bool."""
        most = self._joints.velocity_limits() if self._max is None else self._max
        return any_column(np.abs(self._joints.qvel()) > most)


@register_term("termination", "metric", name="joint_effort_out_of_limit")
class JointEffortOutOfLimit(Judge):
    """True where the effort of a picked joint reaches its limit. Isaac Lab's of the same name.

    Effort as in `joint_torques_l2`, of the last physics step; the limit is the smaller of the
    drive's `max_effort`, at which it is cut off, and the file's.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        soft_ratio: Share of the limit that is allowed.

    Example:
        ``{func: joint_effort_out_of_limit, kind: fail, params: {entity_cfg: {uid: ur10}, soft_ratio: 0.95}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self, env: TermContext, entity_cfg: ResolvedEntity, soft_ratio: Fraction = 1.0
    ) -> None:
        self._joints, self._ratio = Joints(entity_cfg), soft_ratio
        self._joints.effort_limits()

    def value(self) -> Mask:
        """(N,) bool."""
        most = self._joints.effort_limits() * self._ratio
        return any_column(np.abs(self._joints.effort()) >= most)
