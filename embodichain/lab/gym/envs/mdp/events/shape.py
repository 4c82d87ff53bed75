"""The event that draws which of its shapes an object has."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import NonNegative, Whole
from embodichain.lab.gym.envs.managers.term import Term, Uniform
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.sim.compiler.names import no_such
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.random import constant

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex

__all__ = ["RandomizeShape"]


@register_term("event", name="randomize_shape")
class RandomizeShape(Term):
    """Draws one of an object's shapes in each environment.

    The shapes are those of its `any_of`. Mass, inertia and centre of mass become those of the shape
    that is drawn: events that randomize them come after this one. The pose does not change.

    Args:
        entity_cfg: A rigid object with `any_of`.
        weights: Shape -> how often it is drawn, relative to the others; 1 where not given.

    Raises:
        ConfigError: If the object has no `any_of`, or a weight is of no shape, or all are 0.

    Example:
        ``{func: randomize_shape, mode: reset, params: {of: {uid: thing}, weights: {can: 2}}}``
    """

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Whole,
        weights: Mapping[str, NonNegative] | None = None,
    ) -> None:
        self._object = entity_cfg.rigid_object
        names = getattr(self._object, "shape_names", ())
        if not names:
            message = f"{entity_cfg.uid!r} has no any_of: there is one shape"
            raise ConfigError([Problem("entity_cfg.uid", message)])
        weight_of = weights or {}
        problems = [
            no_such("shape", name, names, f"weights.{name}")
            for name in weight_of
            if name not in names
        ]
        share = np.array([float(weight_of.get(name, 1.0)) for name in names])
        if not problems and not share.any():
            problems = [Problem("weights", "all are 0: nothing can be drawn")]
        if problems:
            raise ConfigError(problems)
        # Drawn numbers are below the number of shapes: with equal weights, the index is the integer
        # part.
        self._ends = constant(np.cumsum(share) * (len(names) / share.sum()))
        self._last = int(np.flatnonzero(share)[-1])
        self._number = Uniform("shape", [0.0], [float(len(names))])

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the shape of the object in these environments."""
        drawn = self._number(env.event_manager, env_ids)[:, 0]
        chosen = np.searchsorted(self._ends, drawn, side="right")
        # Rounding may make the last end less than a number drawn.
        self._object.write_shape(np.minimum(chosen, self._last), env_ids)
