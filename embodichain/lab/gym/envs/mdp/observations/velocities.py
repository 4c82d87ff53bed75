"""Observations of velocities of objects and links."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _body
from embodichain.lab.gym.envs.mdp._links import Links
from embodichain.lab.gym.envs.mdp.observations._computed import Computed

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = ["GetRigidObjectVelocity", "LinkVelocity"]


@register_term("observation", name="get_rigid_object_velocity")
class GetRigidObjectVelocity(Computed):
    """(N, 6) linear velocity in m/s, then angular in rad/s, world axes; zeros unless dynamic.

    EmbodiChain's observation of the same name.

    Example:
        ``{func: get_rigid_object_velocity, params: {entity_cfg: {uid: cube}}}``

    Args:
        entity_cfg: The object (or a robot, then its root).
    """

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity) -> None:
        self._entity = entity_cfg

    def value(self) -> F64:
        """(N, 6)."""
        return np.concatenate(_body.velocity(self._entity), axis=1)


@register_term("observation", name="link_velocity")
class LinkVelocity(Computed):
    """Linear velocity of the picked links' origins in m/s, then angular in rad/s.

    (N, 6) of one link, (N, L, 6) of L. Isaac Lab's ``body_link_vel_w``.

    Example:
        ``{func: link_velocity, params: {entity_cfg: {uid: ur10, link_names: [ee_link]}}}``

    Args:
        entity_cfg: The robot and links of it; without links its root.
        in_root_frame: Whether velocities are those minus the root's, in the root's axes, instead of
            in world axes.
    """

    def __init__(
        self, env: TermContext, entity_cfg: ResolvedEntity, in_root_frame: bool = False
    ) -> None:
        self._links = Links(entity_cfg, in_root_frame)

    def value(self) -> F64:
        """Float64 velocities."""
        found = np.concatenate(self._links.velocity(), axis=2)
        return found[:, 0] if self._links.single else found
