"""Contacts of a fixed base with the links on it, which MuJoCo leaves out for mocap bodies.

A body does not collide with its parent, unless the parent is fixed to the world. A fixed base is a
mocap body here, for which MuJoCo makes no such exception: an explicit contact pair restores each
contact that the file's model has.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

__all__ = ["restore_base_contacts"]


def restore_base_contacts(spec: mujoco.MjSpec, model: mujoco.MjModel, root: str) -> bool:
    """Add a contact pair for each two shapes of base and first links that may touch.

    A pair has parameters of its own: those that MuJoCo would give the contact of the two shapes.

    Args:
        spec: The robot with a mocap base; it changes.
        model: The robot, compiled.
        root: Its base.

    Returns:
        Whether any was added.
    """
    pairs = list(_lost_pairs(spec, model, model.body(root).id))
    for first, second in pairs:
        names = {"geomname1": model.geom(first).name, "geomname2": model.geom(second).name}
        spec.add_pair(**names, **_combined(model, first, second))
    return bool(pairs)


def _combined(model: mujoco.MjModel, first: int, second: int) -> dict[str, Any]:
    """Return the parameters of the contact of two geoms.

    The rules are those of MuJoCo's manual, chapter Modeling, "Contact parameters": the geom with
    the higher priority decides; else friction and condim are the larger ones, and solref and solimp
    weighted means.
    """
    geoms = [first, second]
    priority = model.geom_priority[geoms]
    if priority[0] != priority[1]:
        decisive = geoms[int(np.argmax(priority))]
        geoms = [decisive, decisive]
    solref, mix = model.geom_solref[geoms], model.geom_solmix[geoms]
    weights = mix / mix.sum() if mix.sum() > mujoco.mjMINVAL else np.full(2, 0.5)
    in_time = (solref > 0).all()  # else stiffness and damping, whose mean would mean nothing
    sliding, torsional, rolling = model.geom_friction[geoms].max(axis=0)
    both = [first, second]
    return {
        "condim": int(model.geom_condim[geoms].max()),
        "friction": [sliding, sliding, torsional, rolling, rolling],
        "solref": weights @ solref if in_time else solref.min(axis=0),
        "solimp": weights @ model.geom_solimp[geoms],
        "margin": float(model.geom_margin[both].sum()),
        "gap": float(model.geom_gap[both].sum()),
    }


def _lost_pairs(spec: mujoco.MjSpec, model: mujoco.MjModel, root: int) -> Iterator[tuple[int, int]]:
    welded = model.body_weldid
    on_base = np.flatnonzero(welded[model.geom_bodyid] == root)
    parents = welded[model.body_parentid[welded]]  # of each body's weld
    on_links = np.flatnonzero((parents == root)[model.geom_bodyid])
    on_links = on_links[welded[model.geom_bodyid[on_links]] != root]
    excluded = {frozenset((e.bodyname1, e.bodyname2)) for e in spec.excludes}
    paired = {frozenset((p.geomname1, p.geomname2)) for p in spec.pairs}
    for first in on_base.tolist():
        for second in on_links.tolist():
            geoms = model.geom(first).name, model.geom(second).name
            bodies = (model.body(model.geom_bodyid[geom]).name for geom in (first, second))
            known = frozenset(geoms) in paired or frozenset(bodies) in excluded
            if _may_touch(model, first, second) and not known:
                yield first, second


def _may_touch(model: mujoco.MjModel, first: int, second: int) -> bool:
    """Whether the bits of two geoms let them collide."""
    types, affinities = model.geom_contype, model.geom_conaffinity
    return bool(types[first] & affinities[second] or types[second] & affinities[first])
