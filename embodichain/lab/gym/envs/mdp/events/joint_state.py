"""Events that put joints at a state near their default one; drive targets follow."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.param_types import Range
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term, Uniform
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.api import F64, EnvIndex

__all__ = ["RandomizeRobotQpos", "ResetJointsByOffset", "ResetJointsByScale"]


class _JointState(Term):
    """Joints, their initial positions and limits, and how their state is written.

    Args:
        entity: The robot and the picked joints.
        joints: Their indices.
    """

    def __init__(self, entity: ResolvedEntity, joints: Sequence[int]) -> None:
        self._asset = asset = entity.asset
        self._joints: NDArray[np.int64] = np.asarray(joints, np.int64)
        self._dofs = np.asarray(asset.entity.dof_adr, np.int64)[self._joints]
        self._home: F64 = np.asarray(asset.parsed.init_qpos, np.float64)[self._joints]
        self._limits: F64 = np.asarray(asset.parsed.qpos_limits, np.float64)[self._joints]
        driven = np.asarray(asset.entity.actuator_ids)[self._joints] >= 0
        self._driven: NDArray[np.int64] = np.flatnonzero(driven)

    def _write(self, qpos: F64, qvel: F64 | float, env_ids: EnvIndex | None) -> None:
        """Write positions within the limits, velocities and targets of environments."""
        asset = self._asset
        qpos = np.clip(qpos, self._limits[:, 0], self._limits[:, 1])
        asset.write_qpos(qpos, self._joints, env_ids)
        asset.engine.write("qvel", qvel, env_ids, self._dofs)
        if len(self._driven):
            asset.write_target(qpos[:, self._driven], self._joints[self._driven], env_ids)


def _picked(entity: ResolvedEntity) -> tuple[int, ...]:
    if not entity.joint_ids:
        raise ConfigError([Problem("entity_cfg.uid", f"{entity.uid!r} has no joints")])
    return entity.joint_ids


def _per_joint(name: str, bounds: Range, count: int) -> Uniform:
    return Uniform(name, *(np.full(count, bound) for bound in bounds))


@register_term("event", name="reset_joints_by_offset")
class ResetJointsByOffset(_JointState):
    """Puts joints at their initial positions plus a uniform offset, moving at a uniform velocity.

    qpos = clip(qpos0 + U(position_range), limits), qvel = U(velocity_range), one draw a joint.
    Isaac Lab's and mjlab's event of the same name.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        position_range: [low, high] in rad or m.
        velocity_range: [low, high] in rad/s or m/s.

    Example:
        ``{func: reset_joints_by_offset, mode: reset, params: {of: {uid: ur10}, position_range: [-0.1, 0.1], velocity_range: [-0.2, 0.2]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        position_range: Range,
        velocity_range: Range = (0.0, 0.0),
    ) -> None:
        super().__init__(entity_cfg, _picked(entity_cfg))
        self._position = _per_joint("position", position_range, len(self._joints))
        self._velocity: Uniform | None = None
        if tuple(velocity_range) != (0.0, 0.0):
            self._velocity = _per_joint("velocity", velocity_range, len(self._joints))

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the joint states of these environments."""
        qpos = self._home + self._position(env.event_manager, env_ids)
        qvel = 0.0 if self._velocity is None else self._velocity(env.event_manager, env_ids)
        self._write(qpos, qvel, env_ids)


@register_term("event", name="reset_joints_by_scale")
class ResetJointsByScale(_JointState):
    """Puts joints at their initial positions times a uniform factor, with velocity 0.

    qpos = clip(qpos0 x U(position_range), limits), one draw a joint. Isaac Lab's event of the same
    name; its `velocity_range` scales initial velocities, which are always zero here.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        position_range: [low, high] factors.

    Example:
        ``{func: reset_joints_by_scale, mode: reset, params: {of: {uid: ur10}, position_range: [0.9, 1.1]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity, position_range: Range) -> None:
        super().__init__(entity_cfg, _picked(entity_cfg))
        self._position = _per_joint("position", position_range, len(self._joints))

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the joint positions of these environments."""
        self._write(self._home * self._position(env.event_manager, env_ids), 0.0, env_ids)


@register_term("event", name="randomize_robot_qpos")
class RandomizeRobotQpos(_JointState):
    """Puts joints at random positions within their limits, with velocity 0.

    EmbodiChain's event of the same name.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        qpos_range: [low, high] for all picked joints, or [[low, ...], [high, ...]] with one value a
            joint; rad or m.
        relative_qpos: True adds the draw to the initial position, False takes it as the position.
        joint_ids: Picks joints by index instead.

    Example:
        ``{func: randomize_robot_qpos, mode: reset, params: {of: {uid: ur10}, qpos_range: [-0.1, 0.1]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        qpos_range: list[float] | list[list[float]],
        relative_qpos: bool = True,
        joint_ids: list[int] | None = None,
    ) -> None:
        if not hasattr(entity_cfg.asset, "parsed"):
            raise ConfigError([Problem("entity_cfg.uid", f"{entity_cfg.uid!r} has no joints")])
        count = len(entity_cfg.asset.parsed.joint_names)
        wrong = [i for i in joint_ids or () if not 0 <= i < count]
        if wrong:
            message = f"{entity_cfg.uid!r} has {count} joints; got {wrong}"
            raise ConfigError([Problem("joint_ids", message)])
        super().__init__(entity_cfg, entity_cfg.joint_ids if joint_ids is None else joint_ids)
        self._qpos = Uniform("qpos", *_bounds(qpos_range, len(self._joints)))
        if not relative_qpos:
            self._home = np.zeros_like(self._home)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the joint positions of these environments."""
        self._write(self._home + self._qpos(env.event_manager, env_ids), 0.0, env_ids)


def _bounds(bounds: Any, count: int) -> tuple[F64, F64]:
    """Low and high, (count,) each, of [low, high] or [[low, ...], [high, ...]]."""
    array = np.asarray(bounds, np.float64) if len(bounds) == 2 else np.zeros(0)
    if array.shape == (2,):
        array = np.repeat(array[:, None], count, axis=1)
    if array.shape != (2, count):
        message = f"needs [low, high] or two rows of {count} values, got {bounds}"
        raise ConfigError([Problem("qpos_range", message)])
    if not np.isfinite(array).all() or (array[0] > array[1]).any():
        raise ConfigError([Problem("qpos_range", f"low exceeds high, or not finite: {bounds}")])
    return array[0], array[1]
