"""Events that move centres of mass and scale inertias."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.param_types import Box3, Ranges
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._model_fields import (
    Distribution,
    Draw,
    Quantity,
    articulation_of,
    bodies_of,
    object_of,
)

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex

__all__ = ["RandomizeLinkCom", "RandomizeLinkInertia", "RandomizeRigidObjectCenterOfMass"]


class _Com(Term):
    """Shifts centres of mass from where they were compiled, each by its own draw."""

    def __init__(
        self, entity: ResolvedEntity, param: str, box: Box3, distribution: Distribution
    ) -> None:
        names, bodies = bodies_of(entity)
        self._engine = entity.asset.engine
        self._columns = _three(bodies)
        default = self._engine.model.body_ipos.reshape(-1)[self._columns]
        axes = [f"{name}.{axis}" for name in names for axis in "xyz"]
        bounds = np.tile(np.asarray(box, np.float64), (1, len(names)))
        quantity = Quantity(param, bounds.tolist(), axes, default, "add")
        quantity.name = "com"
        self._draw = Draw([quantity], distribution)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the centres of mass of these environments."""
        (com,) = self._draw(env, env_ids)
        self._engine.write_model("body_ipos", com, env_ids, self._columns)
        self._engine.set_const_later(env_ids)


@register_term("event", name="randomize_rigid_object_center_of_mass")
class RandomizeRigidObjectCenterOfMass(_Com):
    """Shifts a dynamic object's centre of mass from the compiled one by a random offset.

    EmbodiChain's event of the same name. The inertia about the centre of mass stays.

    Args:
        entity_cfg: The object.
        com_pos_offset_range: [[x, y, z] low, [x, y, z] high] in metres, in the object's frame.
        distribution: ``uniform`` or ``gaussian`` within the box.

    Example:
        ``{func: randomize_rigid_object_center_of_mass, mode: reset, params: {entity_cfg: {uid: cube}, com_pos_offset_range: [[-0.01, -0.01, -0.01], [0.01, 0.01, 0.01]]}}``
    """  # noqa: E501

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        com_pos_offset_range: Box3,
        distribution: Distribution = "uniform",
    ) -> None:
        entity = object_of(entity_cfg, "its centre of mass")
        super().__init__(entity, "com_pos_offset_range", com_pos_offset_range, distribution)


@register_term("event", name="randomize_link_com")
class RandomizeLinkCom(_Com):
    """Shifts links' centres of mass from the compiled ones, each by its own random offset.

    Isaac Lab's `randomize_rigid_body_com`. Inertias about the centres of mass stay.

    Args:
        entity_cfg: The robot or articulation; link names pick links, else all.
        com_range: [[x, y, z] low, [x, y, z] high] in metres, in each link's frame.
        distribution: ``uniform`` or ``gaussian`` within the box.

    Example:
        ``{func: randomize_link_com, mode: startup, params: {entity_cfg: {uid: ur10, link_names: [forearm_link]}, com_range: [[-0.02, -0.02, -0.02], [0.02, 0.02, 0.02]]}}``
    """  # noqa: E501

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        com_range: Box3,
        distribution: Distribution = "uniform",
    ) -> None:
        super().__init__(articulation_of(entity_cfg), "com_range", com_range, distribution)


@register_term("event", name="randomize_link_inertia")
class RandomizeLinkInertia(Term):
    """Scales the three principal moments of inertia of a body by one random factor; mass stays.

    One factor keeps the moments possible (the largest is at most the sum of the others). It
    multiplies the inertia that belongs to the body's present mass: declare it after events that
    change masses.

    Args:
        entity_cfg: A robot or articulation (link names pick links, else all), or a dynamic object.
        inertia_range: Factors [low, high], positive; or {link regex: [low, high]}.
        distribution: ``uniform``, ``log_uniform`` or ``gaussian`` within the range.

    Example:
        ``{func: randomize_link_inertia, mode: startup, params: {entity_cfg: {uid: ur10}, inertia_range: [0.9, 1.1]}}``
    """  # noqa: E501

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        inertia_range: Ranges,
        distribution: Distribution = "uniform",
    ) -> None:
        self._object = not hasattr(entity_cfg.asset, "parsed")
        if self._object:
            object_of(entity_cfg, "its inertia")
        names, bodies = bodies_of(entity_cfg)
        quantity = Quantity("inertia_range", inertia_range, names, np.ones(len(names)), "abs", 1e-9)
        self._draw = Draw([quantity], distribution)
        self._asset, self._bodies = entity_cfg.asset, bodies[quantity.ids]
        mass = self._asset.engine.model.body_mass[self._bodies]
        self._mass0 = np.where(mass > 0, mass, 1.0)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the inertias of these environments."""
        (factor,) = self._draw(env, env_ids)
        if self._object:
            self._asset.write_inertia_scale(factor[:, 0], env_ids)
            return
        mass = self._asset.engine.model_field("body_mass")[:, self._bodies]
        mass = mass if env_ids is None else mass[env_ids]
        self._asset.write_inertia(mass / self._mass0 * factor, self._bodies, env_ids)


def _three(bodies: NDArray[np.int64]) -> NDArray[np.int64]:
    columns: NDArray[np.int64] = (3 * bodies[:, None] + np.arange(3)).reshape(-1)
    return columns
