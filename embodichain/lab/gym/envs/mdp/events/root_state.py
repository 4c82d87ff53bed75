"""Events that put an entity's root, or the whole scene, at a state near its default."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Axes6
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._root_state import (
    need_free_root,
    rpy_to_quat,
    six_axes,
    write_root_velocity,
)
from embodichain.utils.math import quat_multiply

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["ResetRootStateUniform", "reset_scene_to_default"]


@register_term("event")
def reset_scene_to_default(env: TermContext, env_ids: EnvIndex | None) -> None:
    """Puts every entity into its configured state: poses, joints, drive targets, no velocity.

    Isaac Lab's event. A reset here does so before any event runs; as an `interval` event it puts
    the scene back within an episode. Entities that are detached from resets are put back too.

    Args:
        env: The environment.
        env_ids: (n,) environments, or None for all.

    Example:
        ``{func: reset_scene_to_default, mode: interval, interval_step: 100}``
    """
    env.sim.reset_objects_state(env_ids)


@register_term("event", name="reset_root_state_uniform")
class ResetRootStateUniform(Term):
    """Moves and turns an entity's root away from its configured pose, and gives it a velocity.

    pos = pos0 + U(x, y, z); quat = quat0 * q(roll, pitch, yaw) with q = Rz Ry Rx, so that the turn
    is in the entity's own frame; velocity = U. Isaac Lab's event of the same name.

    Args:
        entity_cfg: A rigid object or a robot.
        pose_range: {x, y, z: [low, high] in metres; roll, pitch, yaw: [low, high] in rad}. An axis
            that is absent is 0.
        velocity_range: {x, y, z: [low, high] in m/s; roll, pitch, yaw: in rad/s}, environment's
            axes. Needs a dynamic object or a floating base; joints are left alone.

    Example:
        ``{func: reset_root_state_uniform, mode: reset, params: {entity_cfg: {uid: cube}, pose_range: {x: [-0.2, 0.2], yaw: [-3.14, 3.14]}, velocity_range: {z: [-0.5, 0.5]}}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        pose_range: Axes6 | None = None,
        velocity_range: Axes6 | None = None,
    ) -> None:
        self._pose = six_axes("pose", pose_range)
        self._velocity = six_axes("velocity", velocity_range)
        if self._velocity is not None:
            need_free_root(entity_cfg)
        self._asset = asset = entity_cfg.asset
        index = asset.entity
        self._floats = index.free_qvel_adr >= 0
        self._pos0: F64 = np.tile(np.asarray(index.pos0, np.float64), (env.num_envs, 1))
        self._quat0: F64 = np.tile(np.asarray(index.quat0, np.float64), (env.num_envs, 1))

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the root states of these environments."""
        count = env.num_envs if env_ids is None else len(env_ids)
        pos, quat = self._pos0[:count], self._quat0[:count]
        if self._pose is not None:
            drawn = self._pose(env.event_manager, env_ids)
            pos = pos + drawn[:, :3]
            quat = quat_multiply(quat, rpy_to_quat(drawn[:, 3:]))
        asset = self._asset
        asset.write_pose(pos, quat, env_ids)
        if self._velocity is not None:
            velocity = self._velocity(env.event_manager, env_ids)
            write_root_velocity(asset, velocity, env_ids)
        elif self._floats:
            write_root_velocity(asset, np.zeros((count, 6)), env_ids)
