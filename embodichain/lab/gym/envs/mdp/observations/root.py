"""Observations of a base: where its root is, how it moves, in world axes or in its own.

Names are Isaac Lab's and mjlab's. Velocities are those of the root's origin, as mjlab's ``link``
ones; Isaac Lab's are of the centre of mass of the root link. Each takes a link instead of the root
if ``entity_cfg`` picks one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _body, _spatial
from embodichain.lab.gym.envs.mdp._rotations import unique_quat
from embodichain.lab.gym.envs.mdp.observations._computed import Computed

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = [
    "BaseAngularVelocity",
    "BaseHeight",
    "BaseLinearVelocity",
    "ProjectedGravity",
    "RootAngularVelocity",
    "RootLinearVelocity",
    "RootPosition",
    "RootQuaternion",
]


class _OfRoot(Computed):
    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity) -> None:
        self._entity = entity_cfg


@register_term("observation", name="root_pos_w")
class RootPosition(_OfRoot):
    """(N, 3) position of the root in the environment's frame, m.

    Example:
        ``{func: root_pos_w, params: {entity_cfg: {uid: go}}}``

    Args:
        entity_cfg: The robot or object.
    """

    def value(self) -> F64:
        """(N, 3)."""
        return _spatial.position(self._entity)


@register_term("observation", name="root_quat_w")
class RootQuaternion(Computed):
    """(N, 4) orientation of the root in the environment's frame, wxyz.

    Example:
        ``{func: root_quat_w, params: {entity_cfg: {uid: go}, make_quat_unique: true}}``

    Args:
        entity_cfg: The robot or object.
        make_quat_unique: Whether to take the one of q and -q that has w >= 0.
    """

    def __init__(
        self, env: TermContext, entity_cfg: ResolvedEntity, make_quat_unique: bool = False
    ) -> None:
        self._entity, self._unique = entity_cfg, make_quat_unique

    def value(self) -> F64:
        """(N, 4)."""
        quat = _body.orientation(self._entity)
        return unique_quat(quat) if self._unique else quat


@register_term("observation", name="root_lin_vel_w")
class RootLinearVelocity(_OfRoot):
    """(N, 3) linear velocity of the root's origin, world axes, m/s.

    Example:
        ``{func: root_lin_vel_w, params: {entity_cfg: {uid: go}}}``

    Args:
        entity_cfg: The robot or object.
    """

    def value(self) -> F64:
        """(N, 3)."""
        return _body.velocity(self._entity)[0]


@register_term("observation", name="root_ang_vel_w")
class RootAngularVelocity(_OfRoot):
    """(N, 3) angular velocity of the root, world axes, rad/s.

    Example:
        ``{func: root_ang_vel_w, params: {entity_cfg: {uid: go}}}``

    Args:
        entity_cfg: The robot or object.
    """

    def value(self) -> F64:
        """(N, 3)."""
        return _body.velocity(self._entity)[1]


@register_term("observation", name="base_lin_vel")
class BaseLinearVelocity(_OfRoot):
    """(N, 3) linear velocity of the root's origin in the root's own axes, m/s.

    Example:
        ``{func: base_lin_vel, params: {entity_cfg: {uid: go}}}``

    Args:
        entity_cfg: The robot or object.
    """

    def value(self) -> F64:
        """(N, 3)."""
        return _body.body_velocity(self._entity)[0]


@register_term("observation", name="base_ang_vel")
class BaseAngularVelocity(_OfRoot):
    """(N, 3) angular velocity of the root in its own axes, rad/s: what a gyroscope there reads.

    Example:
        ``{func: base_ang_vel, scale: 0.25, params: {entity_cfg: {uid: go}}}``

    Args:
        entity_cfg: The robot or object.
    """

    def value(self) -> F64:
        """(N, 3)."""
        return _body.body_velocity(self._entity)[1]


@register_term("observation", name="projected_gravity")
class ProjectedGravity(_OfRoot):
    """(N, 3) the world's unit vector straight down in the root's axes: (0, 0, -1) when upright.

    It tells roll and pitch, and not yaw.

    Example:
        ``{func: projected_gravity, params: {entity_cfg: {uid: go}}}``

    Args:
        entity_cfg: The robot or object.
    """

    def value(self) -> F64:
        """(N, 3)."""
        return _body.projected_gravity(self._entity)


@register_term("observation", name="base_height")
class BaseHeight(_OfRoot):
    """(N, 1) height of the root above the environment's origin, m. Isaac Lab's ``base_pos_z``.

    Example:
        ``{func: base_height, params: {entity_cfg: {uid: go}}}``

    Args:
        entity_cfg: The robot or object.
    """

    def value(self) -> F64:
        """(N, 1)."""
        return _spatial.position(self._entity)[:, 2:]
