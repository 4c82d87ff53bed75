"""Built-in terminations of time and place. Predicates such as `within_distance` serve as well.

`kind` in the config says what an end means; the time limit `max_episode_steps` needs no term.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Angle, Box3, Positive
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _body, _spatial
from embodichain.lab.gym.envs.mdp._judge import Judge, any_column

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.context import TermContext

    Mask = NDArray[np.bool_]

__all__ = ["BadOrientation", "OutOfBounds", "RootHeightBelowMinimum", "time_out"]


@register_term("termination", "metric")
def time_out(
    env: TermContext, obs: Any, action: Any, info: dict[str, Any], time_limit_s: Positive
) -> torch.Tensor:
    """True once an episode has lasted so long, this step included.

    Args:
        env: The environment.
        obs: Unused.
        action: Unused.
        info: Unused.
        time_limit_s: Seconds of simulated time, rounded to control steps.

    Example:
        ``{func: time_out, kind: time_out, params: {time_limit_s: 5.0}}``
    """
    steps = max(1, round(time_limit_s / env.step_dt))
    over: torch.Tensor = env.elapsed_steps + 1 >= steps
    return over


@register_term("termination", "metric", name="out_of_bounds")
class OutOfBounds(Judge):
    """True where an entity is outside a box: an object that fell, or was thrown away.

    Args:
        entity_cfg: The entity, or a link of one.
        bounds: [[x, y, z] low, [x, y, z] high] in metres, environment's frame.

    Example:
        ``{func: out_of_bounds, kind: fail, params: {entity_cfg: {uid: cube}, bounds: [[-1, -1, -0.1], [1, 1, 1]]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity, bounds: Box3) -> None:
        self._entity = entity_cfg
        self._low, self._high = np.asarray(bounds, np.float64)

    def value(self) -> Mask:
        """(N,) bool."""
        position = _spatial.position(self._entity)
        return any_column((position < self._low) | (position > self._high))


@register_term("termination", "metric", name="bad_orientation")
class BadOrientation(Judge):
    """True where an entity's z axis is tilted from the vertical by more than an angle: fallen over.

    Isaac Lab's termination of the same name.

    Args:
        entity_cfg: The entity, or a link of one.
        limit_angle: Radians.

    Example:
        ``{func: bad_orientation, kind: fail, params: {entity_cfg: {uid: go}, limit_angle: 1.0}}``
    """

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity, limit_angle: Angle) -> None:
        self._entity, self._least = entity_cfg, float(np.cos(limit_angle))

    def value(self) -> Mask:
        """(N,) bool."""
        return _body.cos_tilt(self._entity) < self._least


@register_term("termination", "metric", name="root_height_below_minimum")
class RootHeightBelowMinimum(Judge):
    """True where an entity's origin is lower than a minimum: a robot that fell, an object dropped.

    Isaac Lab's termination of the same name.

    Args:
        entity_cfg: The entity, or a link of one.
        minimum_height: Metres above z = 0.

    Example:
        ``{func: root_height_below_minimum, kind: fail, params: {entity_cfg: {uid: cube}, minimum_height: -0.05}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity, minimum_height: float) -> None:
        self._entity, self._minimum = entity_cfg, minimum_height

    def value(self) -> Mask:
        """(N,) bool."""
        return _spatial.position(self._entity)[:, 2] < self._minimum
