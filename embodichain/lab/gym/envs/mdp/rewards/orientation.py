"""Rewards for how an entity is turned: towards another, or upright.

Orientations are compared by the one rotation that takes the first into the second.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Positive
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _body, _kernels, _spatial
from embodichain.lab.gym.envs.mdp._judge import Judge, total
from embodichain.utils.math import quat_conjugate, quat_multiply

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = [
    "FlatOrientationL2",
    "OrientationError",
    "OrientationTanh",
    "Upright",
    "orientation_alignment",
]


@register_term("reward", "metric")
def orientation_alignment(
    env: TermContext,
    obs: Any,
    action: Any,
    info: dict[str, Any],
    source_entity_cfg: ResolvedEntity,
    target_entity_cfg: ResolvedEntity,
) -> torch.Tensor:
    """(tr(Rs Rt^T) - 1) / 2, the cosine of the angle between two orientations, in [-1, 1].

    EmbodiChain's reward of the same name.

    Args:
        env: The environment.
        obs: Unused.
        action: Unused.
        info: Unused.
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.

    Example:
        ``{func: orientation_alignment, weight: 0.5, params: {source_entity_cfg: {uid: ur10, link_names: [ee_link]}, target_entity_cfg: {uid: goal}}}``
    """  # noqa: E501  (an example is one line)
    source, target = map(_body.orientation, (source_entity_cfg, target_entity_cfg))
    w = quat_multiply(quat_conjugate(source), target)[:, 0]
    return _spatial.tensor(2.0 * w * w - 1.0)  # the trace of a rotation is 4 w^2 - 1


@register_term("reward", "metric", name="orientation_error")
class OrientationError(Judge):
    """The angle in radians, [0, pi], between two orientations: give it a negative weight.

    Args:
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.

    Example:
        ``{func: orientation_error, weight: -0.1, params: {source_entity_cfg: {uid: ur10, link_names: [ee_link]}, target_entity_cfg: {uid: goal}}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        source_entity_cfg: ResolvedEntity,
        target_entity_cfg: ResolvedEntity,
    ) -> None:
        self._pair = source_entity_cfg, target_entity_cfg

    def value(self) -> F64:
        """(N,) rad."""
        return _body.angle_between(*map(_body.orientation, self._pair))


@register_term("reward", "metric", name="orientation_tanh")
class OrientationTanh(Judge):
    """1 - tanh(angle / std), with the angle in radians between two orientations.

    Args:
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.
        std: Radians: where the value has fallen to 0.24.

    Example:
        ``{func: orientation_tanh, weight: 0.5, params: {source_entity_cfg: {uid: ur10, link_names: [ee_link]}, target_entity_cfg: {uid: goal}, std: 0.5}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        source_entity_cfg: ResolvedEntity,
        target_entity_cfg: ResolvedEntity,
        std: Positive,
    ) -> None:
        self._pair, self._std = (source_entity_cfg, target_entity_cfg), std

    def value(self) -> F64:
        """(N,) in (0, 1]."""
        angle = _body.angle_between(*map(_body.orientation, self._pair))
        return _kernels.tanh_kernel(angle, self._std)


@register_term("reward", "metric", name="flat_orientation_l2")
class FlatOrientationL2(Judge):
    """Sum of squares of the x and y parts of gravity's direction in the body's axes: sin^2(tilt).

    Isaac Lab's reward of the same name: give it a negative weight.

    Args:
        entity_cfg: The entity, or a link of one.

    Example:
        ``{func: flat_orientation_l2, weight: -5.0, params: {entity_cfg: {uid: go}}}``
    """

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity) -> None:
        self._entity = entity_cfg

    def value(self) -> F64:
        """(N,) in [0, 1]."""
        down = _body.projected_gravity(self._entity)[:, :2]
        return total(down * down)


@register_term("reward", "metric", name="upright")
class Upright(Judge):
    """How far the body's z axis points up: (1 + cos(tilt)) / 2, or exp(-sin^2(tilt) / std^2).

    The second is mjlab's of the same name; it does not tell upright from upside down.

    Args:
        entity_cfg: The entity, or a link of one.
        std: The width of the second formula; None is the first.

    Example:
        ``{func: upright, weight: 1.0, params: {entity_cfg: {uid: go}, std: 0.45}}``
    """

    def __init__(
        self, env: TermContext, entity_cfg: ResolvedEntity, std: Positive | None = None
    ) -> None:
        self._entity, self._std = entity_cfg, std

    def value(self) -> F64:
        """(N,) in [0, 1]."""
        if self._std is None:
            return 0.5 * (1.0 + _body.cos_tilt(self._entity))
        down = _body.projected_gravity(self._entity)[:, :2]
        return _kernels.gaussian(np.ascontiguousarray(total(down * down)), self._std)
