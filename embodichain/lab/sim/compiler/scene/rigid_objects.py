"""Rigid objects: initial pose, body, shape or mesh, contact and damping."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import ObjectBaseCfg, RigidObjectCfg, SiteCfg, VariantCfg
from embodichain.lab.sim.compiler.geoms.contact_parameters import set_contact_parameters
from embodichain.lab.sim.compiler.geoms.poses import check_pose, initial_pose
from embodichain.lab.sim.compiler.geoms.shape_geoms import (
    ConvexParts,
    add_shape,
    check_geometry,
    inertia_about_axes,
    keep_hull_inertia,
    set_collision,
)
from embodichain.lab.sim.compiler.geoms.textures import check_textures
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import check_uid
from embodichain.lab.sim.compiler.scene.object_contacts import check_object_contact, object_contact
from embodichain.lab.sim.shapes import (
    MeshCfg,
    PlaneCfg,
)
from embodichain.utils.errors import Problem
from embodichain.utils.fields.defaults import is_given

__all__ = [
    "HAS_SHAPES",
    "OF_EACH_SHAPE",
    "add_object",
    "check_object",
    "damping_of",
    "shapes_of",
]


def check_object(cfg: RigidObjectCfg) -> list[Problem]:
    """Return every mistake in an object's config, with paths below it."""
    problems = check_pose(cfg) + _check_attrs(cfg) + check_object_contact(cfg)
    for name, site in cfg.sites.items():
        path = f"sites.{name}"
        mistakes = check_uid(name, path, {})
        mistakes += [mistake.below(path) for mistake in _check_place(site)]
        problems += mistakes
    if cfg.any_of:
        # A config made in Python cannot say whether a default was given; for YAML, see
        # `config.checks.given_keys`.
        for name in OF_EACH_SHAPE:
            if not _same(getattr(cfg, name), getattr(RigidObjectCfg(), name)):
                problems.append(Problem(name, HAS_SHAPES))
    if not cfg.any_of:
        return problems + _check_shape(cfg)
    for name, shape in shapes_of(cfg).items():
        path = f"any_of.{name}"
        problems += check_uid(name, path, {})
        mistakes = _check_place(cfg.any_of[name]) + _check_shape(shape)
        problems += [mistake.below(path) for mistake in mistakes]
    return problems


_THINNEST = 1e-9
"""Metres: MuJoCo's boxes have a thickness."""
_SITE_GROUP = 4
"""MuJoCo draws the groups 0 to 2 by default."""
OF_EACH_SHAPE = ("shape", "body_scale", "max_convex_hull_num", "collision")
"""Fields of an object that each shape of `any_of` has instead."""
HAS_SHAPES = "the object has any_of: give each of its shapes there"


def _same(a: object, b: object) -> bool:
    """Whether two values are equal; a list equals a tuple of the same items."""
    if isinstance(a, Sequence) and isinstance(b, Sequence):
        return list(a) == list(b)
    return a == b


_PLACE_KEYS = {"init_pos": "pos", "init_rot": "rot", "init_quat": "quat"}
"""Keys of a pose -> keys of a shape of `any_of`."""


def _check_place(part: VariantCfg | SiteCfg) -> list[Problem]:
    mistakes = check_pose(_place(part))
    return [Problem(_PLACE_KEYS[p.path], p.message, p.hint) for p in mistakes]


def _place(part: VariantCfg | SiteCfg) -> ObjectBaseCfg:
    return ObjectBaseCfg(init_pos=part.pos, init_rot=part.rot, init_quat=part.quat)


def shapes_of(cfg: RigidObjectCfg) -> dict[str, RigidObjectCfg]:
    """Return the shapes that an object may have, each as an object of its own, by name.

    The shape of an object without `any_of` has the name "".
    """
    if not cfg.any_of:
        return {"": cfg}
    shapes: dict[str, RigidObjectCfg] = {}
    for name, variant in cfg.any_of.items():
        attrs: dict[str, Any] = {}
        for key in ("mass", "density", "dynamic_friction"):
            value = getattr(variant, key)
            if value is not None:
                attrs[key] = value
        shapes[name] = dataclasses.replace(
            cfg,
            any_of={},
            attrs=dataclasses.replace(cfg.attrs, **attrs),
            **{key: getattr(variant, key) for key in OF_EACH_SHAPE},
        )
    return shapes


def _check_shape(cfg: RigidObjectCfg) -> list[Problem]:
    problems: list[Problem] = []
    if cfg.collision == "decompose" and _given_parts(cfg) == 1:
        message = "1 part is the hull, but collision is decompose: leave one of them out"
        problems.append(Problem("max_convex_hull_num", message))
    if cfg.collision == "pieces" and _given_parts(cfg) is not None:
        message = "collision is pieces: the mesh has as many parts as pieces; leave this out"
        problems.append(Problem("max_convex_hull_num", message))
    scale = np.asarray(cfg.body_scale, np.float64)
    parts = _convex_parts(cfg)
    if parts != 1 and not isinstance(cfg.shape, MeshCfg):
        name = "max_convex_hull_num" if cfg.max_convex_hull_num > 1 else "collision"
        message = f"only a Mesh is split into convex parts, this is a {cfg.shape.shape_type}"
        problems.append(Problem(name, message))
    problems += check_geometry(cfg.shape, scale, parts)
    look = cfg.shape.visual_material
    if look is not None and look.textures is not None:
        problems += check_textures(look.textures, "shape.visual_material.textures")
    if isinstance(cfg.shape, PlaneCfg) and cfg.body_type != "static":
        message = f"a Plane must be static, got {cfg.body_type!r}"
        problems.append(Problem("body_type", message))
    return problems


def _check_attrs(cfg: RigidObjectCfg) -> list[Problem]:
    attrs = cfg.attrs
    if attrs.mass == 0 and not attrs.density > 0:
        message = f"must be positive as mass is 0, got {attrs.density}"
        return [Problem("attrs.density", message)]
    return []


def _convex_parts(cfg: RigidObjectCfg) -> ConvexParts:
    """The convex parts that a mesh collides as."""
    if cfg.collision == "pieces":
        return "pieces"
    number = _given_parts(cfg)
    if number is not None:
        return number
    return None if cfg.collision == "decompose" else 1


def _given_parts(cfg: RigidObjectCfg) -> int | None:
    """The number of parts that the config gives, or None."""
    number = cfg.max_convex_hull_num
    return int(number) if is_given(number) else None


def add_object(spec: mujoco.MjSpec, uid: str, cfg: RigidObjectCfg, number: int) -> None:
    """Add body `uid`, its geom ``uid/geom`` and, if dynamic, its joint ``uid/free``.

    With `any_of` it has the geoms of all of these shapes, ``uid/NAME/geom``. All but the first
    one's are invisible and without mass; `index_variants` lets them not collide, once the scene is
    compiled: MuJoCo has bounding volumes only of geoms that collide when it compiles.

    Args:
        spec: The scene.
        uid: The object's name.
        cfg: Its config, checked.
        number: Its index among the objects: selects a colour if the config has none.
    """
    pos, quat = initial_pose(cfg)
    body = spec.worldbody.add_body(name=uid, pos=pos, quat=quat)
    body.mocap = cfg.body_type == "kinematic"
    if cfg.body_type == "dynamic":
        body.add_freejoint(name=f"{uid}/free")
        # A body compiled as "simple" has a diagonal mass matrix and cannot have a different centre
        # of mass per environment.
        body.simple = 0
    for order, (name, shape) in enumerate(shapes_of(cfg).items()):
        geoms_before = len(body.geoms)
        geom = add_shape(
            spec,
            body,
            uid=f"{uid}/{name}" if name else uid,
            shape=shape.shape,
            scale=np.asarray(shape.body_scale, np.float64),
            number=number + order,
            parts=_convex_parts(shape),
        )
        if shape.attrs.mass > 0:
            geom.mass = float(shape.attrs.mass)
        else:
            geom.density = float(shape.attrs.density)
        geoms = body.geoms[geoms_before:]
        set_contact_parameters(geoms, object_contact(shape))
        set_collision(geoms, shape.attrs.enable_collision)
        if name:
            body.userdata = [0.0]  # the index of the shape, as a field of each environment
            shape_pos, shape_quat = initial_pose(_place(cfg.any_of[name]))
            for part in geoms:
                part.pos = shape_pos
                part.quat = shape_quat
        if order:
            geom.mass = 0.0
            for part in geoms:
                part.rgba[3] = 0.0
    keep_hull_inertia(spec, body)
    for name, site in cfg.sites.items():
        _add_site(body, f"{uid}/{name}", site, np.asarray(cfg.body_scale, np.float64))


def _add_site(body: mujoco.MjsBody, name: str, cfg: SiteCfg, scale: F64) -> None:
    """Add a site, which is not drawn."""
    pos, quat = initial_pose(_place(cfg))
    site = body.add_site(name=name, pos=pos * scale, quat=quat, group=_SITE_GROUP)
    if cfg.size is None:
        return
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, quat)
    scale_along_edges = scale @ rotation.reshape(3, 3) ** 2
    site.type = mujoco.mjtGeom.mjGEOM_BOX
    site.size = np.maximum(0.5 * np.asarray(cfg.size) * scale_along_edges, _THINNEST)


def damping_of(model: mujoco.MjModel, body: int, cfg: RigidObjectCfg) -> F64:
    """Return the free joint's damping (6,) that makes velocities decay at the config's rates.

    Force = -linear_damping x mass x v, torque = -angular_damping x inertia x w, so that velocities
    decay as ``exp(-damping t)`` for any size of body. MuJoCo's joint damping is one number per
    axis: only the diagonal of the inertia tensor in the body's axes is used.
    """
    inertia = inertia_about_axes(model.body_iquat[body], model.body_inertia[body])
    linear = np.full(3, cfg.attrs.linear_damping * model.body_mass[body])
    return np.concatenate([linear, cfg.attrs.angular_damping * inertia])
