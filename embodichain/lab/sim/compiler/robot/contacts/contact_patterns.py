"""`contact` of an articulation: contact parameters of the links and geoms that patterns match."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import mujoco

from embodichain.lab.sim.compiler.geoms.contact_parameters import (
    ContactParameters,
    check_contact,
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
    for pattern, cfg in contact.items():
        path = f"contact.{pattern}"
        found, wrong = match(pattern, names, "link or geom", path)
        problems += [*wrong, *(p.below(path) for p in check_contact(cfg))]
        picked = [names[i] for i in found]
        if picked and not set(picked) & set(added) and not _geoms(spec, picked):
            message = f"nothing of {', '.join(map(repr, picked))} collides"
            problems.append(Problem(path, message))
    return problems


def apply_contacts(spec: mujoco.MjSpec, contact: Mapping[str, ContactCfg]) -> None:
    """Set the contact parameters that `check_contacts` has checked; later entries override."""
    names = _names(spec)
    for pattern, cfg in contact.items():
        found, _ = match(pattern, names, "link or geom", "")
        geoms = _geoms(spec, [names[i] for i in found])
        set_contact_parameters(geoms, ContactParameters.of_config(cfg))


def _names(spec: mujoco.MjSpec) -> list[str]:
    """Links, then geoms; a name that both have occurs once, and stands for both."""
    links = [body.name for body in spec.bodies[1:]]  # the first is the world
    return list(dict.fromkeys([*links, *(geom.name for geom in spec.geoms)]))


def _geoms(spec: mujoco.MjSpec, names: Collection[str]) -> list[mujoco.MjsGeom]:
    """The colliding geoms that have one of these names, or belong to a link that has one."""
    wanted, paired = set(names), {name for p in spec.pairs for name in (p.geomname1, p.geomname2)}
    return [
        geom
        for geom in spec.geoms
        if (geom.name in wanted or geom.parent.name in wanted)
        and (collides(geom) or geom.name in paired)
    ]
