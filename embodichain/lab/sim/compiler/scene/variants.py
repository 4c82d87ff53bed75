"""`index_variants`: what differs between the shapes that an object may have (`any_of`)."""

from __future__ import annotations

import dataclasses
from typing import Literal

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import RigidObjectCfg
from embodichain.lab.sim.compiler.index import Ids, VariantIndex
from embodichain.lab.sim.compiler.scene.rigid_objects import add_object

__all__ = ["index_variants"]


def index_variants(
    model: mujoco.MjModel, spec: mujoco.MjSpec, uid: str, cfg: RigidObjectCfg, geoms: Ids
) -> VariantIndex:
    """Return the values of the model's fields with each of an object's shapes.

    Each shape is compiled once more, alone, which gives its mass and inertia. In the scene only the
    first one collides from now on.

    Args:
        model: The compiled scene; changed.
        spec: What it was compiled from; changed likewise.
        uid: The object.
        cfg: Its config, with `any_of`.
        geoms: (G,) its geoms in the scene.
    """
    count = len(cfg.any_of)
    contype = np.zeros((count, len(geoms)), np.int64)
    conaffinity = np.zeros((count, len(geoms)), np.int64)
    alpha = np.zeros((count, len(geoms)))
    materials = np.full((count, len(geoms)), -1, np.int64)
    mass = np.zeros(count)
    inertia = np.zeros((count, 3))
    ipos = np.zeros((count, 3))
    iquat = np.zeros((count, 4))
    for row, name in enumerate(cfg.any_of):
        single = mujoco.MjSpec()
        add_object(single, uid, dataclasses.replace(cfg, any_of={name: cfg.any_of[name]}), 0)
        alone = single.compile()
        scene_geoms = np.array([model.geom(alone.geom(i).name).id for i in range(alone.ngeom)])
        columns = scene_geoms - geoms[0]
        contype[row, columns] = alone.geom_contype
        conaffinity[row, columns] = alone.geom_conaffinity
        alpha[row, columns] = alone.geom_rgba[:, 3]
        materials[row, columns] = model.geom_matid[scene_geoms]
        body = int(alone.body(uid).id)
        mass[row] = alone.body_mass[body]
        inertia[row] = alone.body_inertia[body]
        ipos[row] = alone.body_ipos[body]
        iquat[row] = alone.body_iquat[body]
    root = int(model.body(uid).id)
    _set_bits(model, spec, root, geoms, "contype", contype[0])
    _set_bits(model, spec, root, geoms, "conaffinity", conaffinity[0])
    return VariantIndex(
        names=tuple(cfg.any_of),
        contype=contype,
        conaffinity=conaffinity,
        alpha=alpha,
        materials=materials,
        mass=mass,
        ipos=ipos,
        iquat=iquat,
        inertia=inertia,
    )


def _set_bits(
    model: mujoco.MjModel,
    spec: mujoco.MjSpec,
    body: int,
    geoms: Ids,
    field: Literal["contype", "conaffinity"],
    bits: Ids,
) -> None:
    """Set bits (G,) of a body's geoms, and their union, which the broad phase reads."""
    getattr(model, f"geom_{field}")[geoms] = bits
    getattr(model, f"body_{field}")[body] = np.bitwise_or.reduce(bits)
    for geom, value in zip(geoms.tolist(), bits.tolist(), strict=True):
        setattr(spec.geom(model.geom(geom).name), field, value)
