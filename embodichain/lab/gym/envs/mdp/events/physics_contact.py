"""Events that change what bodies and the ground are made of: friction."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.param_types import Ranges
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._model_fields import (
    Distribution,
    Draw,
    Operation,
    Quantity,
    bodies_of,
)
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import Engine, EnvIndex

__all__ = ["RandomizeGroundMaterial", "RandomizeRigidBodyMaterial"]

GROUND = "default_plane"
Groups = list[tuple[str, NDArray[np.int64]]]
"""Names, and geoms that are compiled with the same coefficients and get the same ones."""


class _Material(Term):
    """Draws coefficients for groups of geoms; every geom of a group gets the same."""

    def __init__(
        self,
        engine: Engine,
        groups: Groups,
        ranges: dict[str, Ranges | None],
        operation: Operation,
        distribution: Distribution,
    ) -> None:
        self._engine = engine
        names = [name for name, _ in groups]
        friction = engine.model.geom_friction
        first = [int(geoms[0]) for _, geoms in groups]
        quantities = [
            Quantity(param, given, names, friction[first, axis], operation, 0.0)
            for axis, (param, given) in enumerate(ranges.items())
            if given is not None
        ]
        self._draw = Draw(quantities, distribution)
        axes = [axis for axis, given in enumerate(ranges.values()) if given is not None]
        # One write: columns of geom_friction, and which draw each of them takes.
        columns: list[int] = []
        source: list[int] = []
        start = 0
        for axis, quantity in zip(axes, quantities, strict=True):
            for at, group in enumerate(quantity.ids):
                geoms = groups[group][1]
                columns += (3 * geoms + axis).tolist()
                source += [start + at] * len(geoms)
            start += len(quantity.ids)
        order = np.argsort(columns)
        self._columns = np.asarray(columns, np.int64)[order]
        self._source = np.asarray(source, np.int64)[order]

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the coefficients of these environments."""
        values = np.concatenate(self._draw(env, env_ids), axis=1)
        self._engine.write_model("geom_friction", values[:, self._source], env_ids, self._columns)


@register_term("event", name="randomize_rigid_body_material")
class RandomizeRigidBodyMaterial(_Material):
    """Gives bodies random coefficients of friction: every link or object its own, all its geoms.

    Isaac Lab's event of the same name, with MuJoCo's three coefficients. A contact takes the larger
    coefficient of its two geoms: to be felt, a small one needs a small one on the other side, such
    as `randomize_ground_material` gives. Torsional and rolling friction act only where
    a geom's ``condim`` is 4 or 6.

    Args:
        entity_cfg: An object, or a robot or articulation; link names pick links, else all that
            collide.
        friction_range: Sliding coefficient, [low, high] or {link regex: [low, high]}.
        torsional_range: Torsional coefficient, metres.
        rolling_range: Rolling coefficient, metres.
        operation: ``abs`` replaces the compiled coefficients, ``scale`` and ``add`` change them.
        distribution: ``uniform``, ``log_uniform`` or ``gaussian`` within the range.

    Example:
        ``{func: randomize_rigid_body_material, mode: reset, params: {entity_cfg: {uid: cube}, friction_range: [0.3, 1.2]}}``
    """  # noqa: E501

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        friction_range: Ranges | None = None,
        torsional_range: Ranges | None = None,
        rolling_range: Ranges | None = None,
        operation: Operation = "abs",
        distribution: Distribution = "uniform",
    ) -> None:
        engine = entity_cfg.asset.engine
        super().__init__(
            engine,
            _colliding(entity_cfg),
            _ranges(friction_range, torsional_range, rolling_range),
            operation,
            distribution,
        )


@register_term("event", name="randomize_ground_material")
class RandomizeGroundMaterial(_Material):
    """Gives the ground plane random coefficients of friction.

    Args:
        friction_range: Sliding coefficient, [low, high].
        torsional_range: Torsional coefficient, metres.
        rolling_range: Rolling coefficient, metres.
        operation: ``abs`` replaces the compiled coefficients, ``scale`` and ``add`` change them.
        distribution: ``uniform``, ``log_uniform`` or ``gaussian`` within the range.

    Example:
        ``{func: randomize_ground_material, mode: reset, params: {friction_range: [0.4, 1.0]}}``
    """

    def __init__(
        self,
        env: TermContext,
        friction_range: Ranges | None = None,
        torsional_range: Ranges | None = None,
        rolling_range: Ranges | None = None,
        operation: Operation = "abs",
        distribution: Distribution = "uniform",
    ) -> None:
        model = env.sim.engine.model
        names = [model.geom(i).name for i in range(model.ngeom)]
        if GROUND not in names:
            message = "there is no ground plane in this scene"
            raise ConfigError([Problem("", message, "the simulation's ground_plane is off")])
        geoms = np.array([names.index(GROUND)], np.int64)
        super().__init__(
            env.sim.engine,
            [("ground", geoms)],
            _ranges(friction_range, torsional_range, rolling_range),
            operation,
            distribution,
        )


def _ranges(
    sliding: Ranges | None, torsional: Ranges | None, rolling: Ranges | None
) -> dict[str, Ranges | None]:
    """In the order of MuJoCo's columns."""
    return {"friction_range": sliding, "torsional_range": torsional, "rolling_range": rolling}


def _colliding(entity: ResolvedEntity) -> Groups:
    """Links and their geoms that collide, of links that have any.

    Raises:
        ConfigError: If none has.
    """
    model = entity.asset.engine.model
    geoms = np.asarray(entity.asset.entity.geom_ids, np.int64)
    geoms = geoms[(model.geom_contype[geoms] | model.geom_conaffinity[geoms]) != 0]
    owner = model.geom_bodyid[geoms]
    names, bodies = bodies_of(entity)
    found: Groups = []
    for name, body in zip(names, bodies, strict=True):
        own = geoms[owner == body]
        _, kind = np.unique(model.geom_friction[own], axis=0, return_inverse=True)
        found += [(name, own[kind.reshape(-1) == k]) for k in np.unique(kind)]
    if not found:
        message = f"nothing of {entity.uid!r} collides: {', '.join(names)}"
        raise ConfigError([Problem("entity_cfg", message)])
    return found
