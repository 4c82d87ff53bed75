"""`Links`: poses and velocities of several links of one entity at once.

One link, or a root, is `_spatial`'s and `_body`'s.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _body, _spatial
from embodichain.utils.math import cross, quat_conjugate, quat_multiply, quat_rotate

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.base import F64

__all__ = ["Links"]


class Links:
    """L links in N environments; without a choice of links the root alone.

    Args:
        entity: The entity and the links picked.
        in_root_frame: Whether poses and velocities are those relative to the entity's root, in its
            axes, instead of in the environment's frame.
    """

    def __init__(self, entity: ResolvedEntity, in_root_frame: bool = False) -> None:
        self._root = ResolvedEntity(entity.uid, entity.asset)
        names = entity.link_names
        self.single = len(names) <= 1
        self._relative = in_root_frame
        self._engine = entity.asset.engine
        bodies = [entity.asset.body_of(name) for name in names] or [_body.body_id(entity)]
        self._count = len(bodies)
        # Found here: terms of a task are listed without the engine's modules.
        from embodichain.lab.sim.objects._arrays import columns_of

        self._ids = columns_of(bodies)
        self._rooted = not names
        self._com = int(self._engine.model.body_rootid[bodies[0]])

    def pose(self) -> tuple[F64, F64]:
        """Positions (N, L, 3) in metres and orientations (N, L, 4), wxyz: not to be kept."""
        if self._rooted:
            position = _spatial.position(self._root)[:, None]
            quat = _body.orientation(self._root)[:, None]
        else:
            position = self._engine.derived("xpos")[:, self._ids]
            quat = self._engine.derived("xquat")[:, self._ids]
        if not self._relative:
            return position, quat
        inverse = self._inverse(self._count)
        delta = position - _spatial.position(self._root)[:, None]
        return quat_rotate(inverse, delta), quat_multiply(inverse, quat)

    def velocity(self) -> tuple[F64, F64]:
        """Linear in m/s, of the links' origins, and angular in rad/s, (N, L, 3) each."""
        linear, angular = self._world_velocity()
        if not self._relative:
            return linear, angular
        root_linear, root_angular = _body.velocity(self._root)
        inverse = self._inverse(self._count)
        linear, angular = linear - root_linear[:, None], angular - root_angular[:, None]
        return quat_rotate(inverse, linear), quat_rotate(inverse, angular)

    def _world_velocity(self) -> tuple[F64, F64]:
        if self._rooted:
            linear, angular = _body.velocity(self._root)
            return linear[:, None], angular[:, None]
        cvel = self._engine.derived("cvel")[:, self._ids]
        arm = self._engine.derived("xpos")[:, self._ids]
        arm = arm - self._engine.derived("subtree_com")[:, self._com][:, None]
        angular = cvel[..., :3]
        return cvel[..., 3:] + cross(angular, arm), angular

    def _inverse(self, count: int) -> F64:
        """(N, L, 4) the rotation from the environment's axes to the root's."""
        inverse = quat_conjugate(_body.orientation(self._root))[:, None]
        return np.broadcast_to(inverse, (len(inverse), count, 4))
