"""Commands that ask for joint positions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Range
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import CommandTerm, Uniform
from embodichain.lab.gym.envs.mdp._rows import norm
from embodichain.lab.sim.compiler.names import match
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.api import F64, EnvIndex

__all__ = ["UniformJointPositionCommand"]


@register_term("command", name="uniform_joint_position")
class UniformJointPositionCommand(CommandTerm):
    """(N, K) positions of the picked joints, rad or m, drawn uniformly.

    The metric ``joint_error`` is the Euclidean distance of the joints from the command.

    Example:
        ``{func: uniform_joint_position, params: {of: {uid: ur10}}}``

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        position_range: [low, high] for all picked joints, or a map from joint name or regex to it;
            joints that no key matches stay at home. None draws between the joints' limits.
        relative: True adds the draw to the initial positions; without ranges it has no meaning.
    """

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        position_range: Range | dict[str, Range] | None = None,
        relative: bool = True,
    ) -> None:
        if not entity_cfg.joint_ids:
            raise ConfigError([Problem("entity_cfg", f"{entity_cfg.uid!r} has no joints to pick")])
        self._env = env
        self._entity = entity_cfg
        self.names = entity_cfg.joint_names
        parsed, ids = entity_cfg.asset.parsed, list(entity_cfg.joint_ids)
        home = np.asarray(parsed.init_qpos, np.float64)[ids]
        limits = np.asarray(parsed.qpos_limits, np.float64)[ids]
        if position_range is None:
            rows = limits
            free = [n for n, r in zip(self.names, rows, strict=True) if not np.isfinite(r).all()]
            if free:
                message = f"missing: {', '.join(free)} of {entity_cfg.uid!r} have no limits"
                raise ConfigError([Problem("position_range", message)])
        else:
            rows = _rows(position_range, self.names, np.zeros(len(ids)) if relative else home)
            rows = np.clip(rows + home[:, None] if relative else rows, limits[:, :1], limits[:, 1:])
        self._qpos = Uniform("qpos", rows[:, 0], rows[:, 1])
        self.values: F64 = np.tile(home, (env.num_envs, 1))

    def resample(self, env_ids: EnvIndex | None) -> None:
        """Draw positions."""
        drawn = self._qpos(self._env.command_manager, env_ids)
        self.values[slice(None) if env_ids is None else env_ids] = drawn

    def metrics(self) -> Mapping[str, F64]:
        """Distance of the joints from the command."""
        qpos: Any = self._entity.asset.read_qpos()
        if not self._entity.all_joints:
            qpos = qpos[:, list(self._entity.joint_ids)]
        return {"joint_error": norm(qpos - self.values)}


def _rows(given: Range | dict[str, Range], names: tuple[str, ...], rest: F64) -> F64:
    """(K, 2) ranges of the joints; those that no pattern matches get their number in ``rest``."""
    rows = np.stack([rest, rest], axis=1)
    if not isinstance(given, dict):
        rows[:] = given
        return rows
    for pattern, pair in given.items():
        found, problems = match(pattern, names, "picked joint", f"position_range.{pattern}")
        if problems:
            raise ConfigError(problems)
        rows[list(found)] = pair
    return rows
