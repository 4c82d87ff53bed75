"""Whether a velocity command is being followed: yes or no, for success and curricula."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Positive
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _body, _spatial
from embodichain.lab.gym.envs.mdp._commands import columns
from embodichain.lab.gym.envs.mdp._judge import Judge

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.context import TermContext

__all__ = ["FollowsVelocity"]


@register_term("reward", "metric", "termination", name="follows_velocity")
class FollowsVelocity(Judge):
    """True where velocity in the heading's frame and turning rate are close to a command.

    Args:
        entity_cfg: The robot, or a link of it.
        command_name: A command whose columns are vx, vy (m/s) and wz (rad/s).
        linear_threshold: m/s, of the distance in the plane.
        angular_threshold: rad/s about the vertical; None does not look at it.

    Example:
        ``{func: follows_velocity, params: {entity_cfg: {uid: go}, command_name: velocity, linear_threshold: 0.3}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        command_name: str,
        linear_threshold: Positive,
        angular_threshold: Positive | None = None,
    ) -> None:
        self._entity = entity_cfg
        self._linear, self._angular = linear_threshold, angular_threshold
        self._command = columns(env, command_name, 3)

    def value(self) -> NDArray[np.bool_]:
        """(N,) bool."""
        command = self._command()
        error = _body.heading_velocity(self._entity)[:, :2] - command[:, :2]
        close: NDArray[np.bool_] = _spatial.norm(error) < self._linear
        if self._angular is not None:
            turning = _body.velocity(self._entity)[1][:, 2] - command[:, 2]
            close = close & (np.abs(turning) < self._angular)
        return close
