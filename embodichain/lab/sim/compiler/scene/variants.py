"""`index_variants`: what differs between the shapes that an object may have (`any_of`)."""

from __future__ import annotations

import dataclasses

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
    shape = len(cfg.any_of), len(geoms)
    contype, conaffinity = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    alpha, materials = np.zeros(shape), np.full(shape, -1, np.int64)
    mass, inertia = np.zeros(shape[0]), np.zeros((shape[0], 3))
    ipos, iquat = np.zeros((shape[0], 3)), np.zeros((shape[0], 4))
    for row, name in enumerate(cfg.any_of):
        single = mujoco.MjSpec()
        add_object(single, uid, dataclasses.replace(cfg, any_of={name: cfg.any_of[name]}), 0)
        alone = single.compile()
        there = np.array([model.geom(alone.geom(i).name).id for i in range(alone.ngeom)])
        columns = there - geoms[0]
        contype[row, columns] = alone.geom_contype
        conaffinity[row, columns] = alone.geom_conaffinity
        alpha[row, columns] = alone.geom_rgba[:, 3]
        materials[row, columns] = model.geom_matid[there]
        body = int(alone.body(uid).id)
        mass[row], inertia[row] = alone.body_mass[body], alone.body_inertia[body]
        ipos[row], iquat[row] = alone.body_ipos[body], alone.body_iquat[body]
    root = int(model.body(uid).id)
    for kind, masks in (("contype", contype[0]), ("conaffinity", conaffinity[0])):
        getattr(model, f"geom_{kind}")[geoms] = masks
        getattr(model, f"body_{kind}")[root] = np.bitwise_or.reduce(masks)
        for geom, mask in zip(geoms.tolist(), masks.tolist(), strict=True):
            setattr(spec.geom(model.geom(geom).name), kind, mask)
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
