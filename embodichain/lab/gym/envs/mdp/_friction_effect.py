"""`check_friction_acts`: refuses draws of a friction that no contact takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.terms.aliases import AliasSpec
from embodichain.lab.gym.envs.managers.terms.registry import TERMS
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.utils.array_types import Floats

__all__ = ["check_friction_acts"]

_FRICTIONS = ("friction", "torsional_friction", "rolling_friction")
_GROUND = "default_plane"
_ADVICE = (
    "a collider that does not move and was given no friction has priority -1: give it a friction "
    "or a priority, or draw the friction of what touches it"
)


def check_friction_acts(
    env: TermContext,
    param: str,
    names: Sequence[str],
    geoms: Sequence[NDArray[np.int64]],
    axis: int,
    highest: Floats,
    each: bool,
) -> None:
    """Check that frictions that are drawn can act in a contact.

    Args:
        env: The environment; its scene is complete.
        param: The parameter with the range, for messages.
        names: (m,) names of the drawn values.
        geoms: (m,) the geoms that have each value.
        axis: 0 is sliding, 1 torsional, 2 rolling friction.
        highest: (m,) the largest value of each draw.
        each: Whether each of them must act, because it is named; else one of them.

    Raises:
        ConfigError: If a friction cannot act; says why.
    """
    from embodichain.lab.sim.compiler.scene.contact_partners import FrictionEffect  # imports MuJoCo

    model = env.sim.engine.model
    least = model.geom_friction[:, axis].copy()
    least[_drawn_geoms(env, axis)] = 0.0
    effect = FrictionEffect(model, _masks(env))
    reasons: dict[str, str] = {}
    for name, own, high in zip(names, geoms, highest.tolist(), strict=True):
        found = [effect.why_not(int(geom), axis, high, least) for geom in own]
        if all(found):
            reasons.setdefault(name, found[0])
    if not reasons or (not each and len(reasons) < len(dict.fromkeys(names))):
        return
    told = dict.fromkeys(f"{name}: {reason}" for name, reason in reasons.items())
    lines = "; ".join([*told][:_SHOWN]) + ("; ..." if len(told) > _SHOWN else "")
    hint = _ADVICE if "has priority" in lines else ""
    raise ConfigError([Problem(param, f"this friction cannot act: {lines}", hint)])


_SHOWN = 3


def _masks(env: TermContext) -> dict[int, tuple[int, int]]:
    """The bits that geoms of objects with several shapes have with any of them."""
    found: dict[int, tuple[int, int]] = {}
    for index in env.sim.scene.entities.values():
        if index.variants is None:
            continue
        contype = np.bitwise_or.reduce(index.variants.contype, axis=0)
        conaffinity = np.bitwise_or.reduce(index.variants.conaffinity, axis=0)
        pairs = zip(contype.tolist(), conaffinity.tolist(), strict=True)
        found |= dict(zip(index.geom_ids.tolist(), pairs, strict=True))
    return found


def _drawn_geoms(env: TermContext, axis: int) -> NDArray[np.int64]:
    """The geoms whose friction events draw, or may set in a way that is not known here."""
    model = env.sim.engine.model
    if env.cfg.curriculum:  # it may change ranges
        return np.arange(model.ngeom)
    found: list[NDArray[np.int64]] = []
    for event in env.cfg.events.values():
        spec = TERMS["event"].get(event.func) if isinstance(event.func, str) else None
        if spec is None:
            return np.arange(model.ngeom)
        params = {meant: event.params[name] for name, meant in spec.written(event.params).items()}
        if isinstance(spec, AliasSpec):
            params |= {key: params[name] for key, name in spec.names.items() if name in params}
        if params.get(_FRICTIONS[axis]) is not None:
            found += [_geoms_of(env, uid) for uid in _uids(params)]
    return np.concatenate(found) if found else np.zeros(0, np.int64)


def _uids(params: Mapping[str, Any]) -> list[str]:
    """The entities of an event; the ground if it names none."""
    entities = [params.get("of"), *(params.get("entity_cfgs") or [])]
    fields = [
        entity if isinstance(entity, Mapping) else getattr(entity, "__dict__", {})
        for entity in entities
        if entity is not None
    ]
    return [str(one.get("uid")) for one in fields] or [_GROUND]


def _geoms_of(env: TermContext, uid: str) -> NDArray[np.int64]:
    if uid == _GROUND:
        model = env.sim.engine.model
        return np.array([i for i in range(model.ngeom) if model.geom(i).name == _GROUND], np.int64)
    index = env.sim.scene.entities.get(uid)
    return np.zeros(0, np.int64) if index is None else index.geom_ids
