"""Events that change masses; inertias follow, so that bodies stay consistent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.param_types import Positive, Ranges
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._model_fields import (
    Distribution,
    Draw,
    Operation,
    Quantity,
    articulation_of,
    bodies_of,
    object_of,
)
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex

__all__ = ["RandomizeArticulationMass", "RandomizeRigidObjectMass"]


class _Mass(Term):
    """Draws masses of some bodies, from `min_mass` on."""

    def __init__(
        self,
        entity: ResolvedEntity,
        mass_range: Ranges,
        relative: bool,
        recompute_inertia: bool,
        min_mass: float,
        operation: Operation | None,
        distribution: Distribution,
        names: list[str],
        bodies: NDArray[np.int64],
    ) -> None:
        if relative and operation not in (None, "add"):
            message = f"relative: true adds, but operation is {operation!r}: give one of them"
            raise ConfigError([Problem("operation", message)])
        chosen: Operation = operation or ("add" if relative else "abs")
        default = entity.asset.engine.model.body_mass[bodies]
        quantity = Quantity("mass_range", mass_range, names, default, chosen)
        self._draw = Draw([quantity], distribution)
        self._asset, self._bodies = entity.asset, bodies[quantity.ids]
        self._inertia, self._least = recompute_inertia, min_mass

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the masses of these environments."""
        mass = np.maximum(self._draw(env, env_ids)[0], self._least)
        self._asset.write_mass(mass, self._bodies, env_ids, self._inertia)


@register_term("event", name="randomize_rigid_object_mass")
class RandomizeRigidObjectMass(_Mass):
    """Gives a dynamic object a random mass, kg; its inertia and damping scale with it.

    EmbodiChain's event of the same name; `operation` and `distribution` are added. It begins at
    the compiled mass every time. Where `randomize_rigid_object_scale` fires before it, the inertia
    is that of the new size at the new mass.

    Args:
        entity_cfg: The object.
        mass_range: [low, high] in kg (or factors, with ``operation: scale``).
        relative: True adds the draw to the compiled mass, False takes it as the mass.
        recompute_inertia: False leaves the inertia as it is, another distribution of the mass.
        min_mass: Masses below it become it, kg.
        operation: ``add``, ``scale`` or ``abs`` instead of `relative`.
        distribution: ``uniform``, ``log_uniform`` or ``gaussian`` within the range.

    Example:
        ``{func: randomize_rigid_object_mass, mode: startup, params: {entity_cfg: {uid: cube}, mass_range: [0.5, 2.0]}}``
    """  # noqa: E501

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        mass_range: Ranges,
        relative: bool = False,
        recompute_inertia: bool = True,
        min_mass: Positive = 1e-6,
        operation: Operation | None = None,
        distribution: Distribution = "uniform",
    ) -> None:
        names, bodies = bodies_of(object_of(entity_cfg, "its mass"))
        super().__init__(
            entity_cfg,
            mass_range,
            relative,
            recompute_inertia,
            min_mass,
            operation,
            distribution,
            names,
            bodies,
        )

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the masses of these environments."""
        mass = np.maximum(self._draw(env, env_ids)[0][:, 0], self._least)
        self._asset.write_mass(mass, env_ids, self._inertia)


@register_term("event", name="randomize_articulation_mass")
class RandomizeArticulationMass(_Mass):
    """Gives links random masses, kg, each its own; their inertias scale with them.

    EmbodiChain's event of the same name; `operation` and `distribution` are added.

    Args:
        entity_cfg: The robot or articulation; its link names pick links, else `link_names` does.
        mass_range: [low, high] in kg for every link, or {link regex: [low, high]}.
        link_names: Regexes that pick links; without any, all.
        relative: True adds the draw to the compiled mass, False takes it as the mass.
        recompute_inertia: False leaves inertias as they are.
        min_mass: Masses below it become it, kg.
        operation: ``add``, ``scale`` or ``abs`` instead of `relative`.
        distribution: ``uniform``, ``log_uniform`` or ``gaussian`` within the range.

    Example:
        ``{func: randomize_articulation_mass, mode: reset, params: {entity_cfg: {uid: ur10}, mass_range: [0.8, 1.2], operation: scale}}``
    """  # noqa: E501

    drive_ranges: ClassVar = {"mass_range": "mass"}

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        mass_range: Ranges,
        link_names: str | list[str] | None = None,
        relative: bool = False,
        recompute_inertia: bool = True,
        min_mass: Positive = 1e-6,
        operation: Operation | None = None,
        distribution: Distribution = "uniform",
    ) -> None:
        names, bodies = bodies_of(articulation_of(entity_cfg))
        if link_names is not None:
            keep = _matching(link_names, names)
            names, bodies = [names[i] for i in keep], bodies[keep]
        weightless = [n for n, b in zip(names, bodies, strict=True) if _mass_of(entity_cfg, b) == 0]
        if len(weightless) == len(names):
            message = f"links without mass: {', '.join(weightless)}"
            raise ConfigError([Problem("entity_cfg", message)])
        heavy = [i for i, name in enumerate(names) if name not in weightless]
        super().__init__(
            entity_cfg,
            mass_range,
            relative,
            recompute_inertia,
            min_mass,
            operation,
            distribution,
            [names[i] for i in heavy],
            bodies[heavy],
        )


def _mass_of(entity: ResolvedEntity, body: int) -> float:
    return float(entity.asset.engine.model.body_mass[body])


def _matching(patterns: str | list[str], names: list[str]) -> list[int]:
    """Indices of the names that a pattern matches in full."""
    zero: Sequence[float] = [0.0, 0.0]
    picks = dict.fromkeys([patterns] if isinstance(patterns, str) else patterns, zero)
    return [int(i) for i in Quantity("link_names", picks, names, np.zeros(len(names)), "abs").ids]
