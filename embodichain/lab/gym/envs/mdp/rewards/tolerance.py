"""dm_control's `tolerance` as terms: 1 within bounds, a sigmoid of the excess beyond them.

Of distances, heights, orientations, velocities, joints and actions. The kernels are in
`mdp/_kernels.py`. dm_control multiplies such terms: `product_of`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from embodichain.lab.gym.envs.managers.param_types import Bounds, NonNegative, Vec3
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _body, _spatial
from embodichain.lab.gym.envs.mdp._joints import Joints, wrapped
from embodichain.lab.gym.envs.mdp._judge import Judge, action_rows, mean, total
from embodichain.lab.gym.envs.mdp._kernels import Sigmoid, Tolerance
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import quat_conjugate, quat_rotate

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = [
    "ToleranceAction",
    "ToleranceDistance",
    "ToleranceHeight",
    "ToleranceJointPosition",
    "ToleranceJointVelocity",
    "ToleranceOrientation",
    "ToleranceVelocity",
]

AtMargin = Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)]
NOTHING = (0.0, 0.0)


@register_term("reward", "metric", name="tolerance_distance")
class ToleranceDistance(Judge):
    """Tolerance of the distance between two entities.

    Args:
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.
        bounds: [low, high] in metres, either may be infinite: where the value is 1.
        margin: Metres outside of the bounds where it has fallen to `value_at_margin`; 0 is a step.
        sigmoid: The shape of the fall: gaussian, linear, hyperbolic, long_tail, cosine,
            tanh_squared, quadratic or reciprocal.
        value_at_margin: In (0, 1); linear, cosine and quadratic may take 0.
        use_xy_only: Whether heights are ignored.

    Example:
        ``{func: tolerance_distance, weight: 1.0, params: {source_entity_cfg: {uid: cube}, target_entity_cfg: {uid: goal}, bounds: [0, 0.05], margin: 0.3}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        source_entity_cfg: ResolvedEntity,
        target_entity_cfg: ResolvedEntity,
        bounds: Bounds = NOTHING,
        margin: NonNegative = 0.0,
        sigmoid: Sigmoid = "gaussian",
        value_at_margin: AtMargin = 0.1,
        use_xy_only: bool = False,
    ) -> None:
        self._pair, self._xy = (source_entity_cfg, target_entity_cfg), use_xy_only
        self._tolerance = Tolerance(bounds, margin, sigmoid, value_at_margin)

    def value(self) -> F64:
        """(N,) in [0, 1]."""
        return self._tolerance(_spatial.distance(*self._pair, self._xy))


@register_term("reward", "metric", name="tolerance_height")
class ToleranceHeight(Judge):
    """Tolerance of the height of an entity's origin above z = 0.

    Args:
        entity_cfg: The entity, or a link of one.
        bounds: [low, high] in metres, either may be infinite: where the value is 1.
        margin: Metres outside of the bounds where it has fallen to `value_at_margin`; 0 is a step.
        sigmoid: The shape of the fall: gaussian, linear, hyperbolic, long_tail, cosine,
            tanh_squared, quadratic or reciprocal.
        value_at_margin: In (0, 1); linear, cosine and quadratic may take 0.

    Example:
        ``{func: tolerance_height, weight: 1.0, params: {entity_cfg: {uid: cube}, bounds: [0.3, .inf], margin: 0.3, sigmoid: linear}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        bounds: Bounds,
        margin: NonNegative = 0.0,
        sigmoid: Sigmoid = "gaussian",
        value_at_margin: AtMargin = 0.1,
    ) -> None:
        self._entity = entity_cfg
        self._tolerance = Tolerance(bounds, margin, sigmoid, value_at_margin)

    def value(self) -> F64:
        """(N,) in [0, 1]."""
        return self._tolerance(_spatial.position(self._entity)[:, 2])


@register_term("reward", "metric", name="tolerance_orientation")
class ToleranceOrientation(Judge):
    """Tolerance of an angle: between two entities, or of an entity's z axis from the vertical.

    Args:
        entity_cfg: The entity, or a link of one.
        target_entity_cfg: What it is compared with; None is the vertical (upright is 0, upside down
            is pi).
        bounds: [low, high] in radians, either may be infinite: where the value is 1.
        margin: Radians outside of the bounds where it has fallen to `value_at_margin`; 0 is a step.
        sigmoid: The shape of the fall: gaussian, linear, hyperbolic, long_tail, cosine,
            tanh_squared, quadratic or reciprocal.
        value_at_margin: In (0, 1); linear, cosine and quadratic may take 0.

    Example:
        ``{func: tolerance_orientation, weight: 1.0, params: {entity_cfg: {uid: cube}, bounds: [0, 0.1], margin: 1.0}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        target_entity_cfg: ResolvedEntity | None = None,
        bounds: Bounds = NOTHING,
        margin: NonNegative = 0.0,
        sigmoid: Sigmoid = "gaussian",
        value_at_margin: AtMargin = 0.1,
    ) -> None:
        self._entity, self._target = entity_cfg, target_entity_cfg
        self._tolerance = Tolerance(bounds, margin, sigmoid, value_at_margin)

    def value(self) -> F64:
        """(N,) in [0, 1]."""
        if self._target is not None:
            pair = _body.orientation(self._entity), _body.orientation(self._target)
            return self._tolerance(_body.angle_between(*pair))
        down = _body.projected_gravity(self._entity)
        # Exact at both ends, where an arc cosine is not.
        return self._tolerance(np.arctan2(_spatial.norm(down[:, :2]), -down[:, 2]))


@register_term("reward", "metric", name="tolerance_velocity")
class ToleranceVelocity(Judge):
    """Tolerance of a linear velocity: its length, or its part along a direction.

    Args:
        entity_cfg: The entity, or a link of one; its origin's velocity.
        bounds: [low, high] in m/s, either may be infinite: where the value is 1.
        margin: M/s outside of the bounds where it has fallen to `value_at_margin`; 0 is a step.
        sigmoid: The shape of the fall: gaussian, linear, hyperbolic, long_tail, cosine,
            tanh_squared, quadratic or reciprocal.
        value_at_margin: In (0, 1); linear, cosine and quadratic may take 0.
        direction: Along which the velocity counts, of any length; None takes its length.
        frame: The axes of `direction`.

    Example:
        ``{func: tolerance_velocity, weight: 1.0, params: {entity_cfg: {uid: go}, bounds: [1.0, .inf], margin: 1.0, sigmoid: linear, value_at_margin: 0.5, direction: [1, 0, 0], frame: body}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        bounds: Bounds,
        margin: NonNegative = 0.0,
        sigmoid: Sigmoid = "gaussian",
        value_at_margin: AtMargin = 0.1,
        direction: Vec3 | None = None,
        frame: Literal["world", "body"] = "world",
    ) -> None:
        self._entity, self._body_axes = entity_cfg, frame == "body"
        self._direction: F64 | None = None
        if direction is not None:
            along = np.asarray(direction, np.float64)
            length = float(_spatial.norm(along[None])[0])
            if length == 0.0:
                raise ConfigError([Problem("direction", "must not be zero")])
            self._direction = along / length
        self._tolerance = Tolerance(bounds, margin, sigmoid, value_at_margin)

    def value(self) -> F64:
        """(N,) in [0, 1]."""
        velocity = _body.linear_velocity(self._entity)
        if self._direction is None:
            return self._tolerance(_spatial.norm(velocity))
        if self._body_axes:
            velocity = quat_rotate(quat_conjugate(_body.orientation(self._entity)), velocity)
        return self._tolerance(total(velocity * self._direction))


@register_term("reward", "metric", name="tolerance_joint_position")
class ToleranceJointPosition(Judge):
    """Mean over the picked joints of the tolerance of their positions.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        bounds: [low, high] in rad or m, either may be infinite: where the value is 1.
        margin: Rad or m outside of the bounds where it has fallen to `value_at_margin`; 0 is a step.
        sigmoid: The shape of the fall: gaussian, linear, hyperbolic, long_tail, cosine,
            tanh_squared, quadratic or reciprocal.
        value_at_margin: In (0, 1); linear, cosine and quadratic may take 0.
        periodic: Whether positions are angles that are brought into [-pi, pi) first.

    Example:
        ``{func: tolerance_joint_position, weight: 1.0, params: {entity_cfg: {uid: ur10, joint_names: [Joint1]}, bounds: [-0.25, 0.25], margin: 1.0}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        bounds: Bounds = NOTHING,
        margin: NonNegative = 0.0,
        sigmoid: Sigmoid = "gaussian",
        value_at_margin: AtMargin = 0.1,
        periodic: bool = False,
    ) -> None:
        self._joints, self._periodic = Joints(entity_cfg), periodic
        self._tolerance = Tolerance(bounds, margin, sigmoid, value_at_margin)

    def value(self) -> F64:
        """(N,) in [0, 1]."""
        qpos = self._joints.qpos()
        found = self._tolerance(wrapped(qpos) if self._periodic else qpos)
        return mean(found)


@register_term("reward", "metric", name="tolerance_joint_velocity")
class ToleranceJointVelocity(Judge):
    """Mean over the picked joints of the tolerance of their velocities.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        bounds: [low, high] in rad/s or m/s, either may be infinite: where the value is 1.
        margin: Rad/s or m/s outside of the bounds where it has fallen to `value_at_margin`; 0 is a step.
        sigmoid: The shape of the fall: gaussian, linear, hyperbolic, long_tail, cosine,
            tanh_squared, quadratic or reciprocal.
        value_at_margin: In (0, 1); linear, cosine and quadratic may take 0.

    Example:
        ``{func: tolerance_joint_velocity, weight: 1.0, params: {entity_cfg: {uid: ur10}, margin: 5.0}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        bounds: Bounds = NOTHING,
        margin: NonNegative = 0.0,
        sigmoid: Sigmoid = "gaussian",
        value_at_margin: AtMargin = 0.1,
    ) -> None:
        self._joints = Joints(entity_cfg)
        self._tolerance = Tolerance(bounds, margin, sigmoid, value_at_margin)

    def value(self) -> F64:
        """(N,) in [0, 1]."""
        found = self._tolerance(self._joints.qvel())
        return mean(found)


@register_term("reward", "metric", name="tolerance_action")
class ToleranceAction(Judge):
    """Mean over the action's entries of their tolerance: dm_control's `small_control`.

    Args:
        bounds: [low, high] in units of the action, either may be infinite: where the value is 1.
        margin: Units of the action outside of the bounds where it has fallen to `value_at_margin`; 0 is a step.
        sigmoid: The shape of the fall: gaussian, linear, hyperbolic, long_tail, cosine,
            tanh_squared, quadratic or reciprocal.
        value_at_margin: In (0, 1); linear, cosine and quadratic may take 0.

    Example:
        ``{func: tolerance_action, weight: 0.1, params: {margin: 1.0, sigmoid: quadratic, value_at_margin: 0}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        bounds: Bounds = NOTHING,
        margin: NonNegative = 0.0,
        sigmoid: Sigmoid = "gaussian",
        value_at_margin: AtMargin = 0.1,
    ) -> None:
        self._tolerance = Tolerance(bounds, margin, sigmoid, value_at_margin)

    def __call__(
        self, env: TermContext, obs: Any, action: Any, info: dict[str, Any]
    ) -> torch.Tensor:
        """(N,) float32 in [0, 1]."""
        found = self._tolerance(action_rows(action))
        return _spatial.tensor(mean(found))
