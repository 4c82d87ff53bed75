"""Observations of a target as seen from a source: both are entities, or links of entities."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _body, _spatial
from embodichain.lab.gym.envs.mdp._rotations import Rotation, as_rotation, pose_matrix
from embodichain.lab.gym.envs.mdp.observations._computed import Computed
from embodichain.utils.math import quat_conjugate, quat_multiply, quat_rotate

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = [
    "Distance",
    "RelativeOrientation",
    "RelativePose",
    "RelativePosition",
    "RelativeVelocity",
]


class _Pair(Computed):
    """A source and a target."""

    _source: ResolvedEntity
    _target: ResolvedEntity

    def _inverse(self) -> F64:
        """(N, 4) the rotation from world axes to the source's."""
        return quat_conjugate(_body.orientation(self._source))

    def _delta(self) -> F64:
        """(N, 3) from source to target, world axes."""
        return _spatial.position(self._target) - _spatial.position(self._source)


@register_term("observation", name="relative_position")
class RelativePosition(_Pair):
    """(N, 3) position of the target minus that of the source, m.

    Example:
        ``{func: relative_position, params: {source_entity_cfg: {uid: ur10, link_names:
        [ee_link]}, target_entity_cfg: {uid: goal}}}``

    Args:
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.
        in_source_frame: Whether it is given in the source's axes, instead of the environment's.
    """

    def __init__(
        self,
        env: TermContext,
        source_entity_cfg: ResolvedEntity,
        target_entity_cfg: ResolvedEntity,
        in_source_frame: bool = False,
    ) -> None:
        self._source, self._target = source_entity_cfg, target_entity_cfg
        self._rotated = in_source_frame

    def value(self) -> F64:
        """(N, 3)."""
        delta = self._delta()
        return quat_rotate(self._inverse(), delta) if self._rotated else delta


@register_term("observation", name="relative_orientation")
class RelativeOrientation(_Pair):
    """Orientation of the target in the source's frame: conj(q_source) q_target.

    Example:
        ``{func: relative_orientation, params: {source_entity_cfg: {uid: cube}, target_entity_cfg:
        {uid: goal}}}``

    Args:
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.
        representation: ``quat`` (N, 4) wxyz with w >= 0; ``matrix`` (N, 3, 3); ``rot6d`` (N, 6),
            the matrix's first column, then its second (Zhou et al., CVPR 2019).
    """

    def __init__(
        self,
        env: TermContext,
        source_entity_cfg: ResolvedEntity,
        target_entity_cfg: ResolvedEntity,
        representation: Rotation = "quat",
    ) -> None:
        self._source, self._target = source_entity_cfg, target_entity_cfg
        self._kind = representation

    def value(self) -> F64:
        """Float64 orientations."""
        quat = quat_multiply(self._inverse(), _body.orientation(self._target))
        return as_rotation(quat, self._kind)


@register_term("observation", name="relative_pose")
class RelativePose(_Pair):
    """Pose of the target in the source's frame: position in m, then orientation.

    Example:
        ``{func: relative_pose, params: {source_entity_cfg: {uid: cube}, target_entity_cfg: {uid:
        goal}, representation: rot6d}}``

    Args:
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.
        representation: ``quat`` gives (N, 7), wxyz with w >= 0; ``rot6d`` (N, 9); ``matrix``
            (N, 4, 4).
    """

    def __init__(
        self,
        env: TermContext,
        source_entity_cfg: ResolvedEntity,
        target_entity_cfg: ResolvedEntity,
        representation: Rotation = "quat",
    ) -> None:
        self._source, self._target = source_entity_cfg, target_entity_cfg
        self._kind = representation

    def value(self) -> F64:
        """Float64 poses."""
        inverse = self._inverse()
        position = quat_rotate(inverse, self._delta())
        quat = quat_multiply(inverse, _body.orientation(self._target))
        if self._kind == "matrix":
            return pose_matrix(position, quat)
        return np.concatenate([position, as_rotation(quat, self._kind)], axis=1)


@register_term("observation", name="relative_velocity")
class RelativeVelocity(_Pair):
    """(N, 6) velocity of the target minus that of the source: linear m/s, then angular rad/s.

    The plain difference of the two origins' velocities; the source's own turning is not taken out.

    Example:
        ``{func: relative_velocity, params: {source_entity_cfg: {uid: ur10, link_names:
        [ee_link]}, target_entity_cfg: {uid: cube}}}``

    Args:
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.
        in_source_frame: Whether it is given in the source's axes, instead of the world's.
    """

    def __init__(
        self,
        env: TermContext,
        source_entity_cfg: ResolvedEntity,
        target_entity_cfg: ResolvedEntity,
        in_source_frame: bool = False,
    ) -> None:
        self._source, self._target = source_entity_cfg, target_entity_cfg
        self._rotated = in_source_frame

    def value(self) -> F64:
        """(N, 6)."""
        pairs = zip(_body.velocity(self._target), _body.velocity(self._source), strict=True)
        parts = [target - source for target, source in pairs]
        if self._rotated:
            inverse = self._inverse()
            parts = [quat_rotate(inverse, part) for part in parts]
        return np.concatenate(parts, axis=1)


@register_term("observation", name="distance")
class Distance(_Pair):
    """(N, 1) distance between the origins of source and target, m.

    Example:
        ``{func: distance, params: {source_entity_cfg: {uid: cube}, target_entity_cfg: {uid:
        goal}, use_xy_only: true}}``

    Args:
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.
        use_xy_only: Whether heights are ignored.
    """

    def __init__(
        self,
        env: TermContext,
        source_entity_cfg: ResolvedEntity,
        target_entity_cfg: ResolvedEntity,
        use_xy_only: bool = False,
    ) -> None:
        self._source, self._target = source_entity_cfg, target_entity_cfg
        self._flat = use_xy_only

    def value(self) -> F64:
        """(N, 1)."""
        return _spatial.distance(self._source, self._target, self._flat)[:, None]
