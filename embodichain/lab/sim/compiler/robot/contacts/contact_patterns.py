"""`contact` of an articulation: contact parameters of the links and geoms that patterns match."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import mujoco

from embodichain.lab.sim.compiler.geoms.contact_parameters import (
    ContactParameters,
    set_contact_parameters,
)
from embodichain.lab.sim.compiler.geoms.shape_geoms import collides
from embodichain.lab.sim.compiler.names import match
from embodichain.lab.sim.configs.contact_cfg import ContactCfg
from embodichain.utils.errors import Problem

__all__ = ["apply_contacts", "check_contacts"]


def check_contacts(
    spec: mujoco.MjSpec, contact: Mapping[str, ContactCfg], added: Sequence[str] = ()
) -> list[Problem]:
    """Return every mistake in the contact parameters of an articulation.

    Args:
        spec: Its file.
        contact: Link or geom regex -> parameters.
        added: Links that are added later.

    Returns:
        Problems with paths that begin with ``contact``.
    """
    problems: list[Problem] = []
    names = [*_names(spec), *added]
    for pattern in contact:
        path = f"contact.{pattern}"
        ids, mistakes = match(pattern, names, "link or geom", path)
        problems += mistakes
        picked = [names[i] for i in ids]
        has_added = not set(picked).isdisjoint(added)
        if picked and not has_added and not _colliding_geoms(spec, picked):
            message = f"no part of {', '.join(map(repr, picked))} collides"
            problems.append(Problem(path, message))
    return problems


def apply_contacts(spec: mujoco.MjSpec, contact: Mapping[str, ContactCfg]) -> None:
    """Set the contact parameters that `check_contacts` has checked; later entries override."""
    names = _names(spec)
    for pattern, cfg in contact.items():
        ids, _ = match(pattern, names, "link or geom", "")
        geoms = _colliding_geoms(spec, [names[i] for i in ids])
        set_contact_parameters(geoms, ContactParameters.of_config(cfg))


def _names(spec: mujoco.MjSpec) -> list[str]:
    """Links, then geoms; a name that both have occurs once, and stands for both."""
    links = [body.name for body in spec.bodies[1:]]  # the first is the world
    return list(dict.fromkeys([*links, *(geom.name for geom in spec.geoms)]))


def _colliding_geoms(spec: mujoco.MjSpec, names: Collection[str]) -> list[mujoco.MjsGeom]:
    """The colliding geoms that have one of these names, or belong to a link that has one."""
    names = set(names)
    paired: set[str] = set()
    for pair in spec.pairs:
        paired |= {pair.geomname1, pair.geomname2}
    geoms: list[mujoco.MjsGeom] = []
    for geom in spec.geoms:
        is_named = geom.name in names or geom.parent.name in names
        if is_named and (collides(geom) or geom.name in paired):
            geoms.append(geom)
    return geoms
