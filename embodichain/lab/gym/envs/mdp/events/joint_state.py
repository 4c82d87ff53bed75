"""Events that put joints at a state near their default one, as Isaac Lab and mjlab name them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.param_types import Range
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._ranges import constant
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["ResetJointsByOffset", "ResetJointsByScale"]


class _ResetJoints(Term):
    """What both have in common: which joints, their initial positions and limits."""

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        position_range: Range,
        velocity_range: Range,
    ) -> None:
        if not entity_cfg.joint_ids:
            message = f"{entity_cfg.uid!r} has no joints"
            raise ConfigError([Problem("entity_cfg.uid", message)])
        self._asset = asset = entity_cfg.asset
        self._joints: NDArray[np.int64] = np.asarray(entity_cfg.joint_ids, np.int64)
        self._dofs = np.asarray(asset.entity.dof_adr, np.int64)[self._joints]
        self._home: F64 = np.asarray(asset.parsed.init_qpos, np.float64)[self._joints]
        self._limits: F64 = np.asarray(asset.parsed.qpos_limits, np.float64)[self._joints]
        driven = np.asarray(asset.entity.actuator_ids)[self._joints] >= 0
        self._driven: NDArray[np.int64] = np.flatnonzero(driven)
        width = len(self._joints)
        self._position = tuple(constant(np.full(width, bound)) for bound in position_range)
        self._velocity = tuple(constant(np.full(width, bound)) for bound in velocity_range)
        self._moves = tuple(velocity_range) != (0.0, 0.0)

    def _drawn(self, env: TermContext, env_ids: EnvIndex | None) -> F64:
        low, high = self._position
        return env.event_manager.draw("position", (len(self._joints),), low, high, env_ids)

    def _write(self, env: TermContext, env_ids: EnvIndex | None, qpos: F64) -> None:
        qpos = np.clip(qpos, self._limits[:, 0], self._limits[:, 1])
        asset, width = self._asset, len(self._joints)
        asset.write_qpos(qpos, self._joints, env_ids)
        qvel: F64 | float = 0.0
        if self._moves:
            low, high = self._velocity
            qvel = env.event_manager.draw("velocity", (width,), low, high, env_ids)
        asset.engine.write("qvel", qvel, env_ids, self._dofs)
        if len(self._driven):
            asset.write_target(qpos[:, self._driven], self._joints[self._driven], env_ids)


@register_term("event", name="reset_joints_by_offset")
class ResetJointsByOffset(_ResetJoints):
    """Puts joints at their initial positions plus a uniform offset, moving at a uniform velocity.

    qpos = clip(qpos0 + U(position_range), limits), qvel = U(velocity_range), one draw a joint.
    Drive targets follow the positions, so that nothing jerks before the first action. Isaac Lab's
    and mjlab's event of the same name.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        position_range: [low, high] in rad or m.
        velocity_range: [low, high] in rad/s or m/s.

    Example:
        ``{func: reset_joints_by_offset, mode: reset, params: {entity_cfg: {uid: ur10}, position_range: [-0.1, 0.1], velocity_range: [-0.2, 0.2]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        position_range: Range,
        velocity_range: Range = (0.0, 0.0),
    ) -> None:
        super().__init__(env, entity_cfg, position_range, velocity_range)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the joint states of these environments."""
        self._write(env, env_ids, self._home + self._drawn(env, env_ids))


@register_term("event", name="reset_joints_by_scale")
class ResetJointsByScale(_ResetJoints):
    """Puts joints at their initial positions times a uniform factor; they stand still.

    qpos = clip(qpos0 x U(position_range), limits), one draw a joint; drive targets follow. Isaac
    Lab's event of the same name; its `velocity_range` scales initial velocities, which are always
    zero here, so there is none.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        position_range: [low, high] factors.

    Example:
        ``{func: reset_joints_by_scale, mode: reset, params: {entity_cfg: {uid: ur10}, position_range: [0.9, 1.1]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity, position_range: Range) -> None:
        super().__init__(env, entity_cfg, position_range, (0.0, 0.0))

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the joint positions of these environments."""
        self._write(env, env_ids, self._home * self._drawn(env, env_ids))
