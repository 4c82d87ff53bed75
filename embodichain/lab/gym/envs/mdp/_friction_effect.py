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
_MOST_SHOWN = 3
"""Reasons that a message gives at most."""
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
    # Of two geoms the larger friction acts: one that is drawn too may be as small as 0.
    lowest_friction = model.geom_friction[:, axis].copy()
    lowest_friction[_drawn_geoms(env, axis)] = 0.0
    effect = FrictionEffect(model, _contact_bits(env))
    reasons: dict[str, str] = {}
    for name, name_geoms, high in zip(names, geoms, highest.tolist(), strict=True):
        geom_reasons = [
            effect.why_not(int(geom), axis, high, lowest_friction) for geom in name_geoms
        ]
        if all(geom_reasons):
            reasons.setdefault(name, geom_reasons[0])
    if not reasons:
        return
    if not each and len(reasons) < len(set(names)):
        return
    lines = [f"{name}: {reason}" for name, reason in reasons.items()]
    text = "; ".join(lines[:_MOST_SHOWN])
    if len(lines) > _MOST_SHOWN:
        text += "; ..."
    hint = _ADVICE if "has priority" in text else ""
    raise ConfigError([Problem(param, f"this friction cannot act: {text}", hint)])


def _contact_bits(env: TermContext) -> dict[int, tuple[int, int]]:
    """The bits that geoms of objects with several shapes have with any of them."""
    bits: dict[int, tuple[int, int]] = {}
    for index in env.sim.scene.entities.values():
        if index.variants is None:
            continue
        contype = np.bitwise_or.reduce(index.variants.contype, axis=0).tolist()
        conaffinity = np.bitwise_or.reduce(index.variants.conaffinity, axis=0).tolist()
        for i, geom in enumerate(index.geom_ids.tolist()):
            bits[geom] = (contype[i], conaffinity[i])
    return bits


def _drawn_geoms(env: TermContext, axis: int) -> NDArray[np.int64]:
    """The geoms whose friction events draw, or may set in a way that is not known here."""
    model = env.sim.engine.model
    if env.cfg.curriculum:  # it may change ranges
        return np.arange(model.ngeom)
    geoms: list[NDArray[np.int64]] = []
    for event in env.cfg.events.values():
        spec = TERMS["event"].get(event.func) if isinstance(event.func, str) else None
        if spec is None:  # an event of the user's, which may write anything
            return np.arange(model.ngeom)
        params = {meant: event.params[name] for name, meant in spec.written(event.params).items()}
        if isinstance(spec, AliasSpec):
            params |= {key: params[name] for key, name in spec.names.items() if name in params}
        if params.get(_FRICTIONS[axis]) is not None:
            geoms += [_geoms_of(env, uid) for uid in _uids_of(params)]
    if not geoms:
        return np.zeros(0, np.int64)
    return np.concatenate(geoms)


def _uids_of(params: Mapping[str, Any]) -> list[str]:
    """The entities of an event; the ground if it names none."""
    uids: list[str] = []
    for entity in [params.get("of"), *(params.get("entity_cfgs") or [])]:
        if entity is None:
            continue
        fields = entity if isinstance(entity, Mapping) else getattr(entity, "__dict__", {})
        uids.append(str(fields.get("uid")))
    return uids or [_GROUND]


def _geoms_of(env: TermContext, uid: str) -> NDArray[np.int64]:
    """The geoms of an entity, or of the ground; none of an entity that does not exist."""
    if uid == _GROUND:
        model = env.sim.engine.model
        return np.array([i for i in range(model.ngeom) if model.geom(i).name == _GROUND], np.int64)
    index = env.sim.scene.entities.get(uid)
    if index is None:
        return np.zeros(0, np.int64)
    return index.geom_ids
