"""Events that place joints."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._ranges import constant
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["RandomizeRobotQpos"]


@register_term("event", name="randomize_robot_qpos")
class RandomizeRobotQpos(Term):
    """Puts joints at random positions, and their drive targets with them; the robot stands still.

    EmbodiChain's event of the same name. Positions are clamped to the joints' limits.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        qpos_range: [low, high] for all picked joints, or [[low, ...], [high, ...]] with one value a
            joint; rad or m.
        relative_qpos: True adds the draw to the initial position, False takes it as the position.
        joint_ids: Picks joints by index instead.

    Example:
        ``{func: randomize_robot_qpos, mode: reset, params: {entity_cfg: {uid: ur10}, qpos_range: [-0.1, 0.1]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        qpos_range: list[float] | list[list[float]],
        relative_qpos: bool = True,
        joint_ids: list[int] | None = None,
    ) -> None:
        self._asset = asset = entity_cfg.asset
        if not hasattr(asset, "parsed"):
            raise ConfigError([Problem("entity_cfg.uid", f"{entity_cfg.uid!r} has no joints")])
        parsed = asset.parsed
        picked = list(entity_cfg.joint_ids) if joint_ids is None else joint_ids
        wrong = [i for i in picked if not 0 <= i < len(parsed.joint_names)]
        if wrong:
            message = f"{entity_cfg.uid!r} has {len(parsed.joint_names)} joints; got {wrong}"
            raise ConfigError([Problem("joint_ids", message)])
        self._joints: NDArray[np.int64] = np.asarray(picked, np.int64)
        low, high = _per_joint(qpos_range, len(picked))
        self._low, self._high = constant(low), constant(high)
        self._home: F64 = np.asarray(parsed.init_qpos, np.float64)[self._joints]
        self._limits: F64 = np.asarray(parsed.qpos_limits, np.float64)[self._joints]
        if not relative_qpos:
            self._home = np.zeros_like(self._home)
        driven = np.asarray(asset.entity.actuator_ids)[self._joints] >= 0
        self._driven: NDArray[np.int64] = np.flatnonzero(driven)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the joint positions of these environments."""
        shape = (len(self._joints),)
        drawn = env.event_manager.draw("qpos", shape, self._low, self._high, env_ids)
        qpos = np.clip(self._home + drawn, self._limits[:, 0], self._limits[:, 1])
        asset = self._asset
        asset.write_qpos(qpos, self._joints, env_ids)
        asset.engine.write("qvel", 0.0, env_ids, np.asarray(asset.entity.dof_adr)[self._joints])
        if len(self._driven):
            asset.write_target(qpos[:, self._driven], self._joints[self._driven], env_ids)


def _per_joint(bounds: Any, count: int) -> tuple[F64, F64]:
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
