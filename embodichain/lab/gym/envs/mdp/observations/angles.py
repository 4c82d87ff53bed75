"""Observations of angles without the jump at half a turn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp._joints import Joints
from embodichain.lab.gym.envs.mdp.observations._computed import Computed

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = ["JointSinCos"]


@register_term("observation", name="joint_sin_cos")
class JointSinCos(Computed):
    """(N, 2 K) sines of the picked joints' positions, then their cosines: for joints without end.

    Example:
        ``{func: joint_sin_cos, params: {entity_cfg: {uid: ur10}}}``

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
    """

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity) -> None:
        self._of = Joints(entity_cfg)

    def value(self) -> F64:
        """(N, 2 K) in [-1, 1]."""
        # Contiguous: numpy may round a strided transcendental function differently.
        qpos = np.ascontiguousarray(self._of.qpos())
        return np.concatenate([np.sin(qpos), np.cos(qpos)], axis=1)
