"""Rewards for things that move: tracking a velocity command, height, and unwanted motion.

They work on any entity and on the picked link, robots' bases above all. Penalties are positive:
give them negative weights. Being upright is in `orientation`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Positive
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _body, _kernels, _spatial
from embodichain.lab.gym.envs.mdp._commands import columns
from embodichain.lab.gym.envs.mdp._judge import Judge, Recalling, total

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = [
    "AngVelXyL2",
    "BaseHeightL2",
    "BodyLinAccL2",
    "LinVelZL2",
    "ObjectHeight",
    "TrackAngVelZExp",
    "TrackLinVelXyExp",
]


@register_term("reward", "metric", name="track_lin_vel_xy_exp")
class TrackLinVelXyExp(Judge):
    """exp(-|v_xy - command_xy|^2 / std^2): following a commanded velocity in the plane.

    Isaac Lab's reward of the same name; with ``frame: yaw`` its `track_lin_vel_xy_yaw_frame_exp`.

    Args:
        entity_cfg: The robot, or a link of it.
        command_name: A command whose first two columns are vx and vy, m/s.
        std: m/s.
        frame: Where v is measured: in the ``body``'s own axes, or in its heading's (``yaw``), which
            stay level. ``world`` is the environment's axes.

    Example:
        ``{func: track_lin_vel_xy_exp, weight: 1.0, params: {entity_cfg: {uid: go}, command_name: velocity, std: 0.5}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        command_name: str,
        std: Positive,
        frame: Literal["body", "yaw", "world"] = "body",
    ) -> None:
        self._entity, self._std, self._frame = entity_cfg, std, frame
        self._command = columns(env, command_name, 2)

    def value(self) -> F64:
        """(N,) in [0, 1]."""
        if self._frame == "yaw":
            velocity = _body.heading_velocity(self._entity)
        elif self._frame == "body":
            velocity = _body.body_linear_velocity(self._entity)
        else:
            velocity = _body.linear_velocity(self._entity)
        error = velocity[:, :2] - self._command()[:, :2]
        return _kernels.gaussian(total(error * error), self._std)


@register_term("reward", "metric", name="track_ang_vel_z_exp")
class TrackAngVelZExp(Judge):
    """exp(-(w_z - command)^2 / std^2): following a commanded turning rate.

    Isaac Lab's reward of the same name; with ``frame: world`` its `track_ang_vel_z_world_exp`.

    Args:
        entity_cfg: The robot, or a link of it.
        command_name: A command whose third column is wz, rad/s.
        std: rad/s.
        frame: About which z axis w is measured: the ``body``'s, or the ``world``'s.

    Example:
        ``{func: track_ang_vel_z_exp, weight: 0.5, params: {entity_cfg: {uid: go}, command_name: velocity, std: 0.5}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        command_name: str,
        std: Positive,
        frame: Literal["body", "world"] = "body",
    ) -> None:
        self._entity, self._std, self._frame = entity_cfg, std, frame
        self._command = columns(env, command_name, 3)

    def value(self) -> F64:
        """(N,) in [0, 1]."""
        in_body = self._frame == "body"
        read = _body.body_angular_velocity if in_body else _body.angular_velocity
        error = read(self._entity)[:, 2] - self._command()[:, 2]
        return _kernels.gaussian(error * error, self._std)


@register_term("reward", "metric", name="lin_vel_z_l2")
class LinVelZL2(Judge):
    """Square of the velocity along the body's z axis, (m/s)^2. Isaac Lab's of the same name.

    Args:
        entity_cfg: The robot, or a link of it.

    Example:
        ``{func: lin_vel_z_l2, weight: -2.0, params: {entity_cfg: {uid: go}}}``
    """

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity) -> None:
        self._entity = entity_cfg

    def value(self) -> F64:
        """(N,)."""
        speed = _body.body_linear_velocity(self._entity)[:, 2]
        return speed * speed


@register_term("reward", "metric", name="ang_vel_xy_l2")
class AngVelXyL2(Judge):
    """Sum of squared turning rates about the body's x and y axes, (rad/s)^2: rolling and pitching.

    Isaac Lab's reward of the same name.

    Args:
        entity_cfg: The robot, or a link of it.

    Example:
        ``{func: ang_vel_xy_l2, weight: -0.05, params: {entity_cfg: {uid: go}}}``
    """

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity) -> None:
        self._entity = entity_cfg

    def value(self) -> F64:
        """(N,)."""
        rates = _body.body_angular_velocity(self._entity)[:, :2]
        return total(rates * rates)


@register_term("reward", "metric", name="base_height_l2")
class BaseHeightL2(Judge):
    """Square of the height's distance from a target, m^2. Isaac Lab's of the same name.

    Args:
        entity_cfg: The robot, or a link of it.
        target_height: Metres above z = 0.

    Example:
        ``{func: base_height_l2, weight: -1.0, params: {entity_cfg: {uid: go}, target_height: 0.3}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity, target_height: float) -> None:
        self._entity, self._target = entity_cfg, target_height

    def value(self) -> F64:
        """(N,)."""
        error = _spatial.position(self._entity)[:, 2] - self._target
        return error * error


@register_term("reward", "metric", name="object_height")
class ObjectHeight(Judge):
    """Height of an entity's origin in metres above a level, between 0 and a most: lifting.

    Args:
        entity_cfg: The entity, or a link of one.
        above: The level, metres above z = 0.
        most: Metres; higher than that pays no more.

    Example:
        ``{func: object_height, weight: 5.0, params: {entity_cfg: {uid: cube}, above: 0.05, most: 0.2}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        above: float = 0.0,
        most: Positive | None = None,
    ) -> None:
        self._entity, self._above = entity_cfg, above
        self._most = np.inf if most is None else most

    def value(self) -> F64:
        """(N,) m."""
        height = _spatial.position(self._entity)[:, 2] - self._above
        return np.minimum(np.maximum(height, 0.0), self._most)


@register_term("reward", "metric", name="body_lin_acc_l2")
class BodyLinAccL2(Recalling):
    """Square of a body's acceleration, (m/s^2)^2; 0 in an episode's first step.

    The mean acceleration of its origin over the control step, gravity not added. Isaac Lab's reward
    of this name sums lengths over bodies.

    Args:
        entity_cfg: The robot, or a link of it.

    Example:
        ``{func: body_lin_acc_l2, weight: -0.001, params: {entity_cfg: {uid: ur10, link_names: [ee_link]}}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity) -> None:
        super().__init__(env.num_envs)
        self._entity, self._dt = entity_cfg, env.step_dt

    def value(self) -> F64:
        """(N,)."""
        linear = _body.linear_velocity(self._entity)
        acceleration = (linear - self.recall(linear)[0]) / self._dt
        return np.where(self.calls > 1, total(acceleration * acceleration), 0.0)
