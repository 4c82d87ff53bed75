"""Yes-or-no terms: they pay 1 or 0 as rewards, measure success as metrics, and end episodes.

Thresholds on distances, orientations, heights, joints and speeds. How several of them are joined
or held for some time is in `joined`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Angle, Bounds, Positive
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _body, _spatial
from embodichain.lab.gym.envs.mdp._joints import Joints, wrapped
from embodichain.lab.gym.envs.mdp._judge import Judge, any_column
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.context import TermContext

    Mask = NDArray[np.bool_]

__all__ = [
    "AtRest",
    "HeightAbove",
    "HeightBelow",
    "JointVelWithin",
    "JointWithin",
    "WithinOrientation",
    "WithinPose",
    "within_distance",
]


@register_term("reward", "metric", "termination")
def within_distance(
    env: TermContext,
    obs: Any,
    action: Any,
    info: dict[str, Any],
    source_entity_cfg: ResolvedEntity,
    target_entity_cfg: ResolvedEntity,
    threshold: Positive,
    use_xy_only: bool = False,
) -> torch.Tensor:
    """1 (true) where two entities are closer than a threshold, else 0.

    Args:
        env: The environment.
        obs: Unused.
        action: Unused.
        info: Unused.
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.
        threshold: Metres.
        use_xy_only: Whether heights are ignored.

    Example:
        ``{func: within_distance, params: {source_entity_cfg: {uid: cube}, target_entity_cfg: {uid: goal}, threshold: 0.05}}``
    """  # noqa: E501  (an example is one line)
    d = _spatial.distance(source_entity_cfg, target_entity_cfg, use_xy_only)
    return _spatial.tensor(d < threshold)


@register_term("reward", "metric", "termination", name="within_orientation")
class WithinOrientation(Judge):
    """True where two entities are turned against each other by less than a threshold.

    Args:
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.
        threshold: Radians, of the one rotation that takes the first into the second.

    Example:
        ``{func: within_orientation, params: {source_entity_cfg: {uid: cube}, target_entity_cfg: {uid: goal}, threshold: 0.1}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        source_entity_cfg: ResolvedEntity,
        target_entity_cfg: ResolvedEntity,
        threshold: Angle,
    ) -> None:
        self._pair, self._threshold = (source_entity_cfg, target_entity_cfg), threshold

    def value(self) -> Mask:
        """(N,) bool."""
        return _body.angle_between(*map(_body.orientation, self._pair)) < self._threshold


@register_term("reward", "metric", "termination", name="within_pose")
class WithinPose(Judge):
    """True where two entities are closer than one threshold and turned by less than another.

    Args:
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.
        position_threshold: Metres.
        orientation_threshold: Radians, of the one rotation that takes the first into the second.

    Example:
        ``{func: within_pose, params: {source_entity_cfg: {uid: cube}, target_entity_cfg: {uid: goal}, position_threshold: 0.05, orientation_threshold: 0.1}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        source_entity_cfg: ResolvedEntity,
        target_entity_cfg: ResolvedEntity,
        position_threshold: Positive,
        orientation_threshold: Angle,
    ) -> None:
        self._pair = source_entity_cfg, target_entity_cfg
        self._metres, self._radians = position_threshold, orientation_threshold

    def value(self) -> Mask:
        """(N,) bool."""
        angle = _body.angle_between(*map(_body.orientation, self._pair))
        return (_spatial.distance(*self._pair) < self._metres) & (angle < self._radians)


@register_term("reward", "metric", "termination", name="height_above")
class HeightAbove(Judge):
    """True where an entity's origin is higher than a threshold: lifted.

    Isaac Lab's `object_is_lifted`.

    Args:
        entity_cfg: The entity, or a link of one.
        threshold: Metres above z = 0.

    Example:
        ``{func: height_above, params: {entity_cfg: {uid: cube}, threshold: 0.1}}``
    """

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity, threshold: float) -> None:
        self._entity, self._threshold = entity_cfg, threshold

    def value(self) -> Mask:
        """(N,) bool."""
        return _spatial.position(self._entity)[:, 2] > self._threshold


@register_term("reward", "metric", "termination", name="height_below")
class HeightBelow(Judge):
    """True where an entity's origin is lower than a threshold: dropped.

    Args:
        entity_cfg: The entity, or a link of one.
        threshold: Metres above z = 0.

    Example:
        ``{func: height_below, params: {entity_cfg: {uid: cube}, threshold: -0.05}}``
    """

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity, threshold: float) -> None:
        self._entity, self._threshold = entity_cfg, threshold

    def value(self) -> Mask:
        """(N,) bool."""
        return _spatial.position(self._entity)[:, 2] < self._threshold


@register_term("reward", "metric", "termination", name="joint_within")
class JointWithin(Judge):
    """True where every picked joint is within bounds, the bounds included.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        bounds: [low, high] in rad or m; either may be infinite.
        periodic: Whether positions are angles that are brought into [-pi, pi) first.
        relative: Whether the bounds are around each joint's initial position.

    Example:
        ``{func: joint_within, params: {entity_cfg: {uid: ur10, joint_names: [Joint1]}, bounds: [-0.2, 0.2]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        bounds: Bounds,
        periodic: bool = False,
        relative: bool = False,
    ) -> None:
        self._joints, self._periodic = Joints(entity_cfg), periodic
        self._low, self._high = bounds
        self._centre = self._joints.home if relative else None

    def value(self) -> Mask:
        """(N,) bool."""
        qpos = self._joints.qpos()
        if self._centre is not None:
            qpos = qpos - self._centre
        if self._periodic:
            qpos = wrapped(qpos)
        # Not "none outside": a position that is no number is not within.
        return ~any_column(~((qpos >= self._low) & (qpos <= self._high)))


@register_term("reward", "metric", "termination", name="joint_vel_within")
class JointVelWithin(Judge):
    """True where every picked joint is slower than a threshold: the robot stands still.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        threshold: rad/s or m/s.

    Example:
        ``{func: joint_vel_within, params: {entity_cfg: {uid: ur10}, threshold: 0.05}}``
    """

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity, threshold: Positive) -> None:
        self._joints, self._threshold = Joints(entity_cfg), threshold

    def value(self) -> Mask:
        """(N,) bool."""
        return ~any_column(~(np.abs(self._joints.qvel()) < self._threshold))


@register_term("reward", "metric", "termination", name="at_rest")
class AtRest(Judge):
    """True where an entity moves and turns slower than two thresholds.

    Args:
        entity_cfg: The entity, or a link of one.
        linear_threshold: m/s; None is any.
        angular_threshold: rad/s; None is any.

    Example:
        ``{func: at_rest, params: {entity_cfg: {uid: cube}, linear_threshold: 0.01, angular_threshold: 0.1}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        linear_threshold: Positive | None = None,
        angular_threshold: Positive | None = None,
    ) -> None:
        if linear_threshold is None and angular_threshold is None:
            raise ConfigError([Problem("", "give linear_threshold, angular_threshold or both")])
        self._entity = entity_cfg
        limits = linear_threshold, angular_threshold
        self._limits = tuple(np.inf if limit is None else limit for limit in limits)

    def value(self) -> Mask:
        """(N,) bool."""
        linear, angular = map(_spatial.norm, _body.velocity(self._entity))
        return (linear < self._limits[0]) & (angular < self._limits[1])
