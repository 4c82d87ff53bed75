"""Rigid objects: one body, one geom, and how the body moves."""

from __future__ import annotations

import mujoco
import numpy as np

from embodichain.data import DataNotFoundError, get_data_path
from embodichain.lab.sim.cfg import RigidObjectCfg
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.inertia import inertia_about_axes
from embodichain.lab.sim.compiler.pose import initial_pose
from embodichain.lab.sim.compiler.urdf import MESH_SUFFIXES
from embodichain.lab.sim.compiler.visuals import surface
from embodichain.lab.sim.shapes import (
    AnyShapeCfg,
    CapsuleCfg,
    CubeCfg,
    CylinderCfg,
    MeshCfg,
    PlaneCfg,
    SphereCfg,
)
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["add_object", "check_object", "check_shape", "damping_of", "set_shape"]

_GEOM = mujoco.mjtGeom
_HULL_VERTICES = 64


def check_object(cfg: RigidObjectCfg) -> list[Problem]:
    """Return every mistake in an object's config, with paths below it."""
    problems: list[Problem] = []
    try:
        initial_pose(cfg)
    except ConfigError as error:
        problems += error.problems
    scale = np.asarray(cfg.body_scale, np.float64)
    if scale.shape != (3,) or not (scale > 0).all():
        problems.append(Problem("body_scale", f"wants 3 positive numbers, got {scale.tolist()}"))
        scale = np.ones(3)
    problems += check_shape(cfg.shape, scale)
    if isinstance(cfg.shape, PlaneCfg) and cfg.body_type != "static":
        message = f"a Plane must be static, got {cfg.body_type!r}"
        problems.append(Problem("body_type", message))
    attrs = cfg.attrs
    for name in ("mass", "linear_damping", "angular_damping", "dynamic_friction"):
        value = getattr(attrs, name)
        if not (value >= 0 and np.isfinite(value)):
            problems.append(
                Problem(f"attrs.{name}", f"must be finite and not negative, got {value}")
            )
    if attrs.mass == 0 and not attrs.density > 0:
        problems.append(
            Problem("attrs.density", f"must be positive as mass is 0, got {attrs.density}")
        )
    if cfg.max_convex_hull_num != 1:
        message = f"only 1: MuJoCo collides a mesh by its hull, got {cfg.max_convex_hull_num}"
        problems.append(Problem("max_convex_hull_num", message))
    return problems


def check_shape(shape: AnyShapeCfg, scale: F64) -> list[Problem]:
    """Return every mistake in a shape; paths begin with ``shape`` or ``body_scale``."""
    problems = []
    for name in ("size", "radius", "height"):
        value = getattr(shape, name, None)
        if value is None:
            continue
        array = np.asarray(value, np.float64)
        allowed = (array >= 0).all() if isinstance(shape, PlaneCfg) else (array > 0).all()
        if not (allowed and np.isfinite(array).all()):
            problems.append(Problem(f"shape.{name}", f"must be positive metres, got {value}"))
    if isinstance(shape, (CylinderCfg, CapsuleCfg)) and scale[0] != scale[1]:
        message = f"a {shape.shape_type} scales equally along x and y, got {scale.tolist()}"
        problems.append(Problem("body_scale", message))
    if isinstance(shape, MeshCfg):
        problems += _check_mesh(shape)
    return problems


def _check_mesh(shape: MeshCfg) -> list[Problem]:
    if not shape.fpath:
        return [Problem("shape.fpath", "a Mesh needs a file")]
    try:
        path = get_data_path(shape.fpath)
    except DataNotFoundError as error:
        return [Problem("shape.fpath", str(error))]
    if not path.lower().endswith(MESH_SUFFIXES):
        message = f"MuJoCo reads {', '.join(MESH_SUFFIXES)}, not {shape.fpath!r}; convert it"
        return [Problem("shape.fpath", message)]
    return []


def add_object(spec: mujoco.MjSpec, uid: str, cfg: RigidObjectCfg, number: int) -> tuple[F64, F64]:
    """Add body `uid`, its geom ``uid/geom`` and, if dynamic, its joint ``uid/free``.

    Args:
        spec: The scene.
        uid: The object's name.
        cfg: Its config, checked.
        number: Its place among the objects: chooses a colour where the config has none.

    Returns:
        Its initial position and orientation.
    """
    pos, quat = initial_pose(cfg)
    body = spec.worldbody.add_body(name=uid, pos=pos, quat=quat)
    body.mocap = cfg.body_type == "kinematic"
    if cfg.body_type == "dynamic":
        body.add_freejoint(name=f"{uid}/free")
        # A body compiled as "simple" has a diagonal mass matrix, and could never get another
        # centre of mass per environment.
        body.simple = 0
    geom = body.add_geom(name=f"{uid}/geom")
    set_shape(spec, geom, uid, cfg.shape, np.asarray(cfg.body_scale, np.float64))
    geom.material = surface(spec, uid, cfg.shape.visual_material, number)
    attrs = cfg.attrs
    if attrs.mass > 0:
        geom.mass = float(attrs.mass)
    else:
        geom.density = float(attrs.density)
    geom.friction[0] = float(attrs.dynamic_friction)
    if not attrs.enable_collision:
        geom.contype = geom.conaffinity = 0
    return pos, quat


def set_shape(
    spec: mujoco.MjSpec, geom: mujoco.MjsGeom, uid: str, shape: AnyShapeCfg, scale: F64
) -> None:
    """Set type and size; MuJoCo's sizes are half sizes."""
    if isinstance(shape, CubeCfg):
        geom.type, geom.size = _GEOM.mjGEOM_BOX, 0.5 * np.asarray(shape.size) * scale
    elif isinstance(shape, SphereCfg):
        radii = shape.radius * scale
        even = radii[0] == radii[1] == radii[2]
        geom.type = _GEOM.mjGEOM_SPHERE if even else _GEOM.mjGEOM_ELLIPSOID
        geom.size = [radii[0], 0.0, 0.0] if even else radii
    elif isinstance(shape, (CylinderCfg, CapsuleCfg)):
        capsule = isinstance(shape, CapsuleCfg)
        geom.type = _GEOM.mjGEOM_CAPSULE if capsule else _GEOM.mjGEOM_CYLINDER
        geom.size = [shape.radius * scale[0], 0.5 * shape.height * scale[2], 0.0]
    elif isinstance(shape, PlaneCfg):
        geom.type = _GEOM.mjGEOM_PLANE
        geom.size = [0.5 * shape.size[0] * scale[0], 0.5 * shape.size[1] * scale[1], 1.0]
    else:
        mesh = spec.add_mesh(name=f"{uid}/mesh", file=get_data_path(shape.fpath))
        mesh.scale = scale
        mesh.maxhullvert = _HULL_VERTICES
        geom.type, geom.meshname = _GEOM.mjGEOM_MESH, mesh.name


def damping_of(model: mujoco.MjModel, body: int, cfg: RigidObjectCfg) -> F64:
    """Return the free joint's damping (6,) that makes velocities decay at the config's rates.

    Force = -linear_damping x mass x v, torque = -angular_damping x inertia x w, so that velocities
    fall by ``exp(-damping t)`` whatever the body's size. MuJoCo's joint damping is one number an
    axis: of an inertia tensor that is not diagonal in the body's axes its diagonal is taken.
    """
    inertia = inertia_about_axes(model.body_iquat[body], model.body_inertia[body])
    attrs = cfg.attrs
    linear = np.full(3, attrs.linear_damping * model.body_mass[body])
    return np.concatenate([linear, attrs.angular_damping * inertia])
