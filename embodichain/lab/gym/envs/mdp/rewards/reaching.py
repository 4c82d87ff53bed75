"""Rewards for bringing one thing to another: distances, their kernels, and progress.

Values are (N,); the reward manager multiplies them by their weight, never by dt. All of them can be
metrics as well. Thresholds are in `predicates`, orientations in `orientation`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np

from embodichain.lab.gym.envs.managers.param_types import NonNegative, Positive
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _kernels, _spatial, _targets
from embodichain.lab.gym.envs.mdp._judge import Judge, Recalling

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64
else:
    torch = lazy_loader.load("torch")

__all__ = [
    "DistanceTanh",
    "IncrementalDistanceToTarget",
    "ObjectGoalDistance",
    "ReachingBehindObject",
    "distance_between_objects",
    "distance_to_target",
]


@register_term("reward", "metric")
def distance_between_objects(
    env: TermContext,
    obs: Any,
    action: Any,
    info: dict[str, Any],
    source_entity_cfg: ResolvedEntity,
    target_entity_cfg: ResolvedEntity,
    exponential: bool = False,
    sigma: Positive = 1.0,
    use_xy_only: bool = False,
) -> torch.Tensor:
    """-d, or exp(-d^2 / (2 sigma^2)), with d the distance in metres between two entities.

    EmbodiChain's reward of the same name; `use_xy_only` is ours.

    Args:
        env: The environment.
        obs: Unused.
        action: Unused.
        info: Unused.
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.
        exponential: Whether to use the second formula, which lies in (0, 1].
        sigma: Its width in metres.
        use_xy_only: Whether heights are ignored.

    Example:
        ``{func: distance_between_objects, weight: 1.0, params: {source_entity_cfg: {uid: ur10, link_names: [ee_link]}, target_entity_cfg: {uid: cube}}}``
    """  # noqa: E501  (an example is one line)
    d = _spatial.distance(source_entity_cfg, target_entity_cfg, use_xy_only)
    return _closeness(d, exponential, sigma)


@register_term("reward", "metric")
def distance_to_target(
    env: TermContext,
    obs: Any,
    action: Any,
    info: dict[str, Any],
    source_entity_cfg: ResolvedEntity,
    target_pose_key: str = "target_pose",
    exponential: bool = False,
    sigma: Positive = 1.0,
    use_xy_only: bool = False,
) -> torch.Tensor:
    """-d, or exp(-d^2 / (2 sigma^2)), with d the distance in metres to a pose an event keeps.

    EmbodiChain's reward of the same name.

    Args:
        env: The environment.
        obs: Unused.
        action: Unused.
        info: Unused.
        source_entity_cfg: An entity, or a link of one.
        target_pose_key: The attribute of the environment with the poses, (N, 4, 4).
        exponential: Whether to use the second formula, which lies in (0, 1].
        sigma: Its width in metres.
        use_xy_only: Whether heights are ignored.

    Example:
        ``{func: distance_to_target, weight: 1.0, params: {source_entity_cfg: {uid: cube}, exponential: true, sigma: 0.2}}``
    """  # noqa: E501  (an example is one line)
    target = _targets.target_position(env, target_pose_key)
    d = _targets.distance_to(_spatial.position(source_entity_cfg), target, use_xy_only)
    return _closeness(d, exponential, sigma)


def _closeness(d: F64, exponential: bool, sigma: float) -> torch.Tensor:
    if not exponential:
        return _spatial.tensor(-d)
    return torch.exp(_spatial.tensor(d * d * (-0.5 / (sigma * sigma))))


@register_term("reward", "metric", name="incremental_distance_to_target")
class IncrementalDistanceToTarget(Recalling):
    """w tanh(tanh_scale (d_before - d)): positive for coming closer; 0 in an episode's first step.

    d is the distance in metres to a pose an event keeps, w one of two weights. EmbodiChain's reward
    of the same name, whose memory survives resets and pays for the jump; this one forgets.

    Args:
        source_entity_cfg: An entity, or a link of one.
        target_pose_key: The attribute of the environment with the poses, (N, 4, 4).
        tanh_scale: 1/m.
        positive_weight: w of a step that came closer.
        negative_weight: w of a step that went away.
        use_xy_only: Whether heights are ignored.

    Example:
        ``{func: incremental_distance_to_target, weight: 1.0, params: {source_entity_cfg: {uid: cube}, negative_weight: 2.0}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        source_entity_cfg: ResolvedEntity,
        target_pose_key: str = "target_pose",
        tanh_scale: Positive = 10.0,
        positive_weight: NonNegative = 1.0,
        negative_weight: NonNegative = 1.0,
        use_xy_only: bool = False,
    ) -> None:
        super().__init__(env.num_envs)
        self._env, self._source, self._key = env, source_entity_cfg, target_pose_key
        self._scale, self._xy = tanh_scale, use_xy_only
        self._weights = positive_weight, negative_weight

    def value(self) -> F64:
        """(N,) in (-negative_weight, positive_weight)."""
        target = _targets.target_position(self._env, self._key)
        d = _targets.distance_to(_spatial.position(self._source), target, self._xy)
        before = self.recall(d[:, None])[0][:, 0]
        progress = np.tanh(self._scale * np.where(self.calls > 1, before - d, 0.0))
        return np.where(progress > 0.0, *self._weights) * progress


@register_term("reward", "metric", name="reaching_behind_object")
class ReachingBehindObject(Judge):
    """1 - tanh(distance_scale d), d the tool's distance to a point behind the object to push.

    The point is ``object - behind_offset u + (0, 0, height_offset)`` with u the unit vector from
    the object to its target (0 where they coincide). EmbodiChain's reward of the same name.

    Args:
        object_cfg: What is to be pushed.
        target_pose_key: The attribute of the environment with the target poses, (N, 4, 4).
        behind_offset: Metres.
        height_offset: Metres.
        distance_scale: 1/m.
        part_name: A control part of the task's robot: its tool is the tool point that the robot's
            `solver_cfg` gives it, else the link farthest from the base that all its joints move.
            None is the whole robot.
        end_effector_cfg: The tool's link, instead (ours).

    Example:
        ``{func: reaching_behind_object, weight: 0.1, params: {object_cfg: {uid: cube}, target_pose_key: target_pose}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        object_cfg: ResolvedEntity,
        target_pose_key: str = "goal_pose",
        behind_offset: float = 0.015,
        height_offset: float = 0.015,
        distance_scale: Positive = 5.0,
        part_name: str | None = None,
        end_effector_cfg: ResolvedEntity | None = None,
    ) -> None:
        self._env, self._object, self._key = env, object_cfg, target_pose_key
        self._tool = _targets.tool_of(env, end_effector_cfg, part_name)
        self._behind, self._up = behind_offset, np.array([0.0, 0.0, height_offset])
        self._scale = distance_scale

    def value(self) -> F64:
        """(N,) in (0, 1]."""
        place = _spatial.position(self._object)
        way = _targets.target_position(self._env, self._key) - place
        length = _spatial.norm(way)[:, None]
        direction = way / np.where(length == 0.0, 1.0, length)
        wanted = place - self._behind * direction + self._up
        d = _spatial.norm(_spatial.position(self._tool) - wanted)
        return _kernels.tanh_kernel(d, 1.0 / self._scale)


@register_term("reward", "metric", name="distance_tanh")
class DistanceTanh(Judge):
    """1 - tanh(d / std), with d the distance in metres between two entities.

    The kernel of Isaac Lab's `object_ee_distance` and `position_command_error_tanh`.

    Args:
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.
        std: Metres: where the value has fallen to 0.24.
        use_xy_only: Whether heights are ignored.

    Example:
        ``{func: distance_tanh, weight: 1.0, params: {source_entity_cfg: {uid: ur10, link_names: [ee_link]}, target_entity_cfg: {uid: cube}, std: 0.1}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        source_entity_cfg: ResolvedEntity,
        target_entity_cfg: ResolvedEntity,
        std: Positive,
        use_xy_only: bool = False,
    ) -> None:
        self._pair = source_entity_cfg, target_entity_cfg
        self._std, self._xy = std, use_xy_only

    def value(self) -> F64:
        """(N,) in (0, 1]."""
        return _kernels.tanh_kernel(_spatial.distance(*self._pair, self._xy), self._std)


@register_term("reward", "metric", name="object_goal_distance")
class ObjectGoalDistance(Judge):
    """1 - tanh(d / std) where the object is higher than `minimal_height`, else 0.

    Isaac Lab's reward of the same name, with an entity in place of a command as the goal.

    Args:
        object_cfg: What is carried.
        goal_cfg: Where to.
        std: Metres: where the value has fallen to 0.24.
        minimal_height: Metres above z = 0 of the object's origin.

    Example:
        ``{func: object_goal_distance, weight: 16.0, params: {object_cfg: {uid: cube}, goal_cfg: {uid: goal}, std: 0.3, minimal_height: 0.1}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        object_cfg: ResolvedEntity,
        goal_cfg: ResolvedEntity,
        std: Positive,
        minimal_height: float,
    ) -> None:
        self._object, self._goal = object_cfg, goal_cfg
        self._std, self._height = std, minimal_height

    def value(self) -> F64:
        """(N,) in [0, 1]."""
        kernel = _kernels.tanh_kernel(_spatial.distance(self._object, self._goal), self._std)
        return np.where(_spatial.position(self._object)[:, 2] <= self._height, 0.0, kernel)
