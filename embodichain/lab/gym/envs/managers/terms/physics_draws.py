"""`PhysicsDraw`: what an event declares to draw for drives and links, before the scene is compiled.

The compiler chooses armatures for which drives stay quiet, with the largest gains and the smallest
masses that an event may draw, and keeps a full mass matrix for links whose centre of mass moves.
An event says so where it is registered: ``register_term("event", draws=...)``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, cast

from embodichain.lab.gym.envs.cfg import EventCfg, SceneEntityCfg
from embodichain.lab.gym.envs.managers.terms.aliases import AliasSpec
from embodichain.lab.gym.envs.managers.terms.check import CheckedTerm, check_term
from embodichain.lab.gym.envs.managers.terms.registry import TermSpec
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext

__all__ = ["PhysicsDraw", "Quantity", "physics_draws"]

Bounds = Sequence[float]
"""[low, high]."""
Quantity = Literal["stiffness", "damping", "max_effort", "strength", "armature", "mass", "com"]
"""What an event may draw, see `PhysicsDraw`."""


@dataclass(frozen=True)
class PhysicsDraw:
    """Values that an event may draw for one quantity of an entity's drives or links.

    Attributes:
        entity: The reference. Joint names and control parts pick joints; link names pick links, for
            ``mass`` and ``com``. Without them all are picked.
        quantity: ``stiffness``, ``damping`` (N m/rad, N m s/rad, or N/m, N s/m), ``max_effort``
            (N m or N) and ``armature`` (kg m^2 or kg) of drives; ``strength``, factors of gains and
            effort limit together; ``mass`` (kg) of links; ``com``, links whose centre of mass
            moves.
        range: [low, high], or {regex of joints or links: [low, high]}; ``com`` has none.
        operation: ``abs`` replaces the compiled value, ``scale`` multiplies it, ``add`` adds to it.
            Without a meaning for ``strength`` and ``com``.
    """

    entity: SceneEntityCfg
    quantity: Quantity
    range: Bounds | Mapping[str, Bounds] = (0.0, 0.0)
    operation: Literal["abs", "scale", "add"] = "abs"


def physics_draws(
    events: Mapping[str, EventCfg], *, allow_import: bool = True
) -> Iterator[PhysicsDraw]:
    """Yield what the events of a task declare to draw; events with mistakes declare nothing.

    Args:
        events: The task's events.
        allow_import: Whether events named ``package.module:function`` are imported.
    """
    for name, event in events.items():
        # `check_terms` reports the mistakes, and a task with a mistake is not built.
        term, _ = check_term("event", event, f"events.{name}", allow_import=allow_import)
        if term is not None:
            yield from _draws_of(term)


def _draws_of(term: CheckedTerm) -> Sequence[PhysicsDraw]:
    spec = term.spec
    values = term.values
    target = spec.target if isinstance(spec, AliasSpec) else spec
    if target.draws is None:
        return ()
    if isinstance(spec, AliasSpec):
        try:
            _, values = spec.meaning(values, cast("TermContext", _UnbuiltScene()))[0]
        except ConfigError:  # raised again where the term is built
            return ()
    return tuple(target.draws(**_arguments(target, values)))


def _arguments(spec: TermSpec, values: Mapping[str, Any]) -> dict[str, Any]:
    """The event's parameters that its declaration takes, with the event's defaults."""
    return {
        name: values.get(word, spec.params[word].default)
        for name, word in spec.draws_params.items()
    }


class _UnbuiltScene:
    """Stands for the environment before there is one: references stay as they are declared."""

    def scene_entity(self, cfg: Mapping[str, Any]) -> SceneEntityCfg:
        """Return the reference itself."""
        return SceneEntityCfg(**cfg)
