"""Rewards of EmbodiChain under their own names and with its parameters.

They are rewards and metrics. Most are a quantity with a fixed shape; docs/compatibility.md gives
the general form.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from embodichain.compat.terms._targets import joints_of, target_position, tool_of
from embodichain.lab.gym.envs.managers.param_types import Body, NonNegative, Positive
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.terms.registry import quantity
from embodichain.lab.gym.envs.mdp._rows import norm, total
from embodichain.lab.gym.envs.mdp.quantities.pairs import distance
from embodichain.lab.gym.envs.mdp.shapes import Rate, tanh_kernel
from embodichain.utils.arrays import contiguous
from embodichain.utils.math import quat_conjugate, quat_multiply

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.utils.array_types import Floats

__all__ = [
    "IncrementalDistanceToTarget",
    "JointLimitPenalty",
    "ReachingBehindObject",
    "distance_between_objects",
    "distance_to_target",
    "object_goal_distance",
    "orientation_alignment",
]


def _closeness(d: Floats, exponential: bool, sigma: float) -> Floats:
    """A value that grows as distances shrink: a Gaussian of them, or their negative."""
    if not exponential:
        return -d
    return np.exp(contiguous(d * d * (-0.5 / (sigma * sigma))))


@quantity("reward", "metric")
def distance_between_objects(
    env: TermContext,
    source_entity_cfg: Body,
    target_entity_cfg: Body,
    exponential: bool = False,
    sigma: Positive = 1.0,
    use_xy_only: bool = False,
) -> Floats:
    """-d, or exp(-d^2 / (2 sigma^2)), with d the distance in metres between two entities.

    Args:
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.
        exponential: Whether to use the second formula, whose values are in (0, 1].
        sigma: Its width in metres.
        use_xy_only: Whether heights are ignored.

    Example:
        ``{func: distance_between_objects, weight: 1.0, params: {from: {uid: ur10,
        link_names: [ee_link]}, to: {uid: cube}}}``
    """
    d = distance(env, source_entity_cfg, target_entity_cfg, use_xy_only)
    return _closeness(d, exponential, sigma)


def _distance_to_target(env: TermContext, source: Body, key: str, use_xy_only: bool) -> Floats:
    """(N,) distance in metres of an entity to a position that an event stores."""
    delta = target_position(env, key) - source.position()
    if use_xy_only:
        delta = delta[:, :2]
    return norm(delta)


@quantity("reward", "metric")
def distance_to_target(
    env: TermContext,
    source_entity_cfg: Body,
    target_pose_key: str = "target_pose",
    exponential: bool = False,
    sigma: Positive = 1.0,
    use_xy_only: bool = False,
) -> Floats:
    """-d, or exp(-d^2 / (2 sigma^2)), with d the distance in metres to a pose that an event stores.

    Args:
        source_entity_cfg: An entity, or a link of one.
        target_pose_key: The attribute of the environment with the poses, (N, 4, 4).
        exponential: Whether to use the second formula, whose values are in (0, 1].
        sigma: Its width in metres.
        use_xy_only: Whether heights are ignored.

    Example:
        ``{func: distance_to_target, weight: 1.0, params: {from: {uid: cube},
        exponential: true, sigma: 0.2}}``
    """
    d = _distance_to_target(env, source_entity_cfg, target_pose_key, use_xy_only)
    return _closeness(d, exponential, sigma)


@quantity("reward", "metric", name="incremental_distance_to_target")
class IncrementalDistanceToTarget(Rate):
    """w tanh(tanh_scale (d_before - d)): positive for coming closer; 0 in an episode's first step.

    d is the distance in metres to a pose that an event stores, w one of two weights.

    Args:
        source_entity_cfg: An entity, or a link of one.
        target_pose_key: The attribute of the environment with the poses, (N, 4, 4).
        tanh_scale: 1/m.
        positive_weight: w of a step that came closer.
        negative_weight: w of a step that went away.
        use_xy_only: Whether heights are ignored.

    Example:
        ``{func: incremental_distance_to_target, weight: 1.0, params: {from: {uid:
        cube}, negative_weight: 2.0}}``
    """

    def __init__(
        self,
        env: TermContext,
        source_entity_cfg: Body,
        target_pose_key: str = "target_pose",
        tanh_scale: Positive = 10.0,
        positive_weight: NonNegative = 1.0,
        negative_weight: NonNegative = 1.0,
        use_xy_only: bool = False,
    ) -> None:
        super().__init__(env, "step")
        self._env = env
        self._source = source_entity_cfg
        self._key = target_pose_key
        self._use_xy_only = use_xy_only
        self._scale = tanh_scale
        self._positive_weight = positive_weight
        self._negative_weight = negative_weight

    def __call__(self, values: Floats | None = None) -> Floats:
        """(N,) in (-negative_weight, positive_weight)."""
        if values is None:
            values = _distance_to_target(self._env, self._source, self._key, self._use_xy_only)
        progress = np.tanh(self._scale * -super().__call__(values))
        weights = np.where(progress > 0.0, self._positive_weight, self._negative_weight)
        return weights * progress


@quantity("reward", "metric", name="reaching_behind_object")
class ReachingBehindObject:
    """1 - tanh(distance_scale d), d the tool's distance to a point behind the object to push.

    The point is ``object - behind_offset u + (0, 0, height_offset)`` with u the unit vector from
    the object to its target (0 where they coincide).

    Args:
        object_cfg: The object to push.
        target_pose_key: The attribute of the environment with the target poses, (N, 4, 4).
        behind_offset: Metres.
        height_offset: Metres.
        distance_scale: 1/m.
        part_name: A control part of the task's robot: its tool is the tool point that the robot's
            `solver_cfg` gives it, else the link farthest from the base that all its joints move.
            None is the whole robot.
        end_effector_cfg: The tool's link, instead (ours).

    Example:
        ``{func: reaching_behind_object, weight: 0.1, params: {object_cfg: {uid: cube},
        target_pose_key: target_pose}}``
    """

    def __init__(
        self,
        env: TermContext,
        object_cfg: Body,
        target_pose_key: str = "goal_pose",
        behind_offset: float = 0.015,
        height_offset: float = 0.015,
        distance_scale: Positive = 5.0,
        part_name: str | None = None,
        end_effector_cfg: Body | None = None,
    ) -> None:
        self._env = env
        self._object = object_cfg
        self._key = target_pose_key
        self._tool = tool_of(env, end_effector_cfg, part_name)
        self._behind = behind_offset
        self._up = np.array([0.0, 0.0, height_offset])
        self._scale = distance_scale

    def __call__(self) -> Floats:
        """(N,) in (0, 1]."""
        position = self._object.position()
        to_target = target_position(self._env, self._key) - position
        distance = norm(to_target)[:, None]
        direction = to_target / np.where(distance == 0.0, 1.0, distance)
        point_behind = position - self._behind * direction + self._up
        return tanh_kernel(norm(self._tool.position() - point_behind), 1.0 / self._scale)


@quantity("reward", "metric")
def object_goal_distance(
    env: TermContext, object_cfg: Body, goal_cfg: Body, std: Positive, minimal_height: float
) -> Floats:
    """1 - tanh(d / std) where the object is higher than `minimal_height`, else 0.

    Isaac Lab's reward of the same name, with an entity in place of a command as the goal. The
    general form is `product_of` `height` and `distance`.

    Args:
        object_cfg: The object.
        goal_cfg: The goal.
        std: Metres: where the value has fallen to 0.24.
        minimal_height: Metres above z = 0 of the object's origin.

    Example:
        ``{func: object_goal_distance, weight: 16.0, params: {object_cfg: {uid: cube}, goal_cfg:
        {uid: goal}, std: 0.3, minimal_height: 0.1}}``
    """
    kernel = tanh_kernel(distance(env, object_cfg, goal_cfg), std)
    return np.where(object_cfg.position()[:, 2] <= minimal_height, 0.0, kernel)


@quantity("reward", "metric")
def orientation_alignment(
    env: TermContext, source_entity_cfg: Body, target_entity_cfg: Body
) -> Floats:
    """(tr(Rs Rt^T) - 1) / 2, the cosine of the angle between two orientations, in [-1, 1].

    Args:
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.

    Example:
        ``{func: orientation_alignment, weight: 0.5, params: {from: {uid: ur10,
        link_names: [ee_link]}, to: {uid: goal}}}``
    """
    inverse = quat_conjugate(source_entity_cfg.orientation())
    w = quat_multiply(inverse, target_entity_cfg.orientation())[:, 0]
    return 2.0 * w * w - 1.0  # the trace of a rotation is 4 w^2 - 1


@quantity("reward", "metric", name="joint_limit_penalty")
class JointLimitPenalty:
    """-sum max(0, margin - x), x the distance to the nearer limit as a share of the range.

    Joints without two limits count 0.

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
        self._joints = joints_of(env, robot_uid, joint_ids, entity_cfg=entity_cfg)
        self._margin = margin
        self._joints.qpos_limits()

    def __call__(self) -> Floats:
        """(N,), not positive."""
        qpos = self._joints.qpos()
        low, high = self._joints.qpos_limits()
        is_limited = np.isfinite(low) & np.isfinite(high)
        width = np.subtract(high, low, where=is_limited, out=np.ones_like(low))
        share = np.minimum(qpos - low, high - qpos) / width
        return -total(np.where(is_limited, np.maximum(self._margin - share, 0.0), 0.0))
