"""Rigid objects: one body, its shape or mesh, and how the body moves."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from embodichain.data import DataNotFoundError, get_data_path
from embodichain.lab.sim.cfg import RigidObjectCfg
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.rigid_math import inertia_about_axes, initial_pose
from embodichain.lab.sim.compiler.robot_bodies import COLLISION_GROUP, VISUAL_GROUP
from embodichain.lab.sim.compiler.visuals import surface
from embodichain.lab.sim.meshes.mesh_conversion import (
    MadeVisual,
    convert_collision,
    convert_visual,
    has_materials,
    reads,
)
from embodichain.lab.sim.meshes.mesh_decomposition import decompose
from embodichain.lab.sim.meshes.mesh_part import MeshError
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

__all__ = [
    "add_mesh",
    "add_object",
    "add_shape",
    "check_mesh",
    "check_object",
    "check_shape",
    "damping_of",
    "set_contact",
]

HULL_VERTICES = 64
_GEOM, _INERTIA = mujoco.mjtGeom, mujoco.mjtMeshInertia


def check_mesh(shape: MeshCfg, max_parts: int | None = 1) -> list[Problem]:
    """Return what is wrong with a mesh; its file is read, which `add_mesh` needs anyway.

    Args:
        shape: The mesh.
        max_parts: Convex parts that collide: 1, its hull; None: as many as it takes.
    """
    if not shape.fpath:
        return [Problem("shape.fpath", "a Mesh needs a file")]
    try:
        path = Path(get_data_path(shape.fpath))
        if not reads(path):
            convert_collision(path)
        if max_parts != 1:
            decompose(path, max_parts)
        if shape.visual_material is None:
            _look(path)
    except (DataNotFoundError, MeshError, OSError) as error:
        return [Problem("shape.fpath", str(error))]
    return []


def add_mesh(
    spec: mujoco.MjSpec,
    geom: mujoco.MjsGeom,
    uid: str,
    shape: MeshCfg,
    scale: F64,
    number: int,
    max_parts: int | None = 1,
) -> None:
    """Make a geom the mesh, and add geoms to its body where one cannot be all of it.

    The geom weighs, and collides by its hull. Parts of several colours are drawn by geoms of their
    own, without mass and contacts; so are convex parts added, which collide in its place.

    Args:
        spec: The scene.
        geom: The body's first.
        uid: Prefix of the names in the scene.
        shape: The mesh, checked.
        scale: (3,) factors.
        number: Chooses a colour where neither config nor file has one.
        max_parts: See `check_mesh`.
    """
    path, body = Path(get_data_path(shape.fpath)), geom.parent
    look = _look(path) if shape.visual_material is None else None
    single = look is not None and len(look.parts) == 1
    file = look.parts[0].mesh if look is not None and single else _shape_file(path)
    mesh = _mesh(spec, f"{uid}/mesh", file, scale)
    if not reads(path):
        mesh.inertia = _INERTIA.mjMESH_INERTIA_CONVEX
    geom.type, geom.meshname = _GEOM.mjGEOM_MESH, mesh.name
    if look is None:
        geom.material = surface(spec, uid, shape.visual_material, number)
    elif single:
        geom.material = _material(spec, f"{uid}/material", look, 0)
    else:
        geom.group = COLLISION_GROUP
        for i, part in enumerate(look.parts):
            drawn = _mesh(spec, f"{uid}/visual_{i}", part.mesh, scale)
            drawn.inertia = _INERTIA.mjMESH_INERTIA_SHELL
            added = _add(body, drawn.name, VISUAL_GROUP)
            added.contype = added.conaffinity = 0
            added.material = _material(
                spec, f"{uid}/material_{i}" if i else f"{uid}/material", look, i
            )
    if max_parts != 1:
        geom.contype = geom.conaffinity = 0
        for i, convex in enumerate(decompose(path, max_parts)):
            _add(body, _mesh(spec, f"{uid}/part_{i}", convex, scale).name, COLLISION_GROUP)


def _add(body: mujoco.MjsBody, name: str, group: int) -> mujoco.MjsGeom:
    return body.add_geom(name=name, type=_GEOM.mjGEOM_MESH, meshname=name, mass=0.0, group=group)


def _mesh(spec: mujoco.MjSpec, name: str, file: Path, scale: F64) -> mujoco.MjsMesh:
    mesh = spec.add_mesh(name=name, file=str(file))
    mesh.scale, mesh.maxhullvert = scale, HULL_VERTICES
    return mesh


def _shape_file(path: Path) -> Path:
    return path if reads(path) else convert_collision(path)


def _look(path: Path) -> MadeVisual | None:
    """Return the file's parts if it has colours; None if MuJoCo draws all that there is of it."""
    if reads(path) and not has_materials(path):
        return None
    made = convert_visual(path)
    colored = any(part.rgba is not None or part.texture is not None for part in made.parts)
    return made if colored else None


def _material(spec: mujoco.MjSpec, name: str, look: MadeVisual, number: int) -> str:
    part = look.parts[number]
    material = spec.add_material(name=name, specular=0.2, shininess=0.3)
    if part.rgba is not None:
        material.rgba = part.rgba
    if part.texture is not None:
        spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=str(part.texture))
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    return name


_GEOM = mujoco.mjtGeom


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
    if not cfg.max_convex_hull_num >= 1:
        message = f"must be at least 1, got {cfg.max_convex_hull_num}"
        return [*problems, Problem("max_convex_hull_num", message)]
    parts = _convex_parts(cfg)
    if parts != 1 and not isinstance(cfg.shape, MeshCfg):
        name = "max_convex_hull_num" if cfg.max_convex_hull_num > 1 else "collision"
        message = f"only a Mesh is split into convex parts, this is a {cfg.shape.shape_type}"
        problems.append(Problem(name, message))
    problems += check_shape(cfg.shape, scale, parts)
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
    return problems


def _convex_parts(cfg: RigidObjectCfg) -> int | None:
    """Most convex parts of a mesh: 1, its hull; None: as many as it takes."""
    if cfg.max_convex_hull_num > 1:
        return int(cfg.max_convex_hull_num)
    return None if cfg.collision == "decompose" else 1


def check_shape(shape: AnyShapeCfg, scale: F64, max_parts: int | None = 1) -> list[Problem]:
    """Return every mistake in a shape; paths begin with ``shape`` or ``body_scale``.

    Args:
        shape: The shape.
        scale: (3,) factors.
        max_parts: Convex parts that a mesh collides by: 1, its hull; None: as many as it takes.
    """
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
        problems += check_mesh(shape, max_parts)
    return problems


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
    scale = np.asarray(cfg.body_scale, np.float64)
    geom = add_shape(spec, body, uid, cfg.shape, scale, number, _convex_parts(cfg))
    attrs = cfg.attrs
    if attrs.mass > 0:
        geom.mass = float(attrs.mass)
    else:
        geom.density = float(attrs.density)
    set_contact(body, float(attrs.dynamic_friction), attrs.enable_collision)
    return pos, quat


def add_shape(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    uid: str,
    shape: AnyShapeCfg,
    scale: F64,
    number: int,
    max_parts: int | None = 1,
) -> mujoco.MjsGeom:
    """Add geom ``uid/geom`` with type, size (half sizes, MuJoCo's) and material, and return it.

    Args:
        spec: The scene.
        body: What gets it; a mesh of several colours or convex parts adds more geoms.
        uid: Prefix of the names.
        shape: The shape, checked.
        scale: (3,) factors.
        number: Chooses a colour where there is none.
        max_parts: See `check_shape`.
    """
    geom = body.add_geom(name=f"{uid}/geom")
    if isinstance(shape, MeshCfg):
        add_mesh(spec, geom, uid, shape, scale, number, max_parts)
        return geom
    geom.material = surface(spec, uid, shape.visual_material, number)
    if isinstance(shape, CubeCfg):
        geom.type, geom.size = _GEOM.mjGEOM_BOX, 0.5 * np.asarray(shape.size) * scale
    elif isinstance(shape, SphereCfg):
        radii = shape.radius * scale
        even = radii[0] == radii[1] == radii[2]
        geom.type = _GEOM.mjGEOM_SPHERE if even else _GEOM.mjGEOM_ELLIPSOID
        geom.size = [radii[0], 0.0, 0.0] if even else radii
    elif isinstance(shape, PlaneCfg):
        geom.type = _GEOM.mjGEOM_PLANE
        geom.size = [0.5 * shape.size[0] * scale[0], 0.5 * shape.size[1] * scale[1], 1.0]
    else:
        capsule = isinstance(shape, CapsuleCfg)
        geom.type = _GEOM.mjGEOM_CAPSULE if capsule else _GEOM.mjGEOM_CYLINDER
        geom.size = [shape.radius * scale[0], 0.5 * shape.height * scale[2], 0.0]
    return geom


def set_contact(body: mujoco.MjsBody, friction: float, collides: bool) -> None:
    """Set the sliding friction of a body's geoms, and whether they collide."""
    for geom in body.geoms:
        geom.friction[0] = friction
        if not collides:
            geom.contype = geom.conaffinity = 0


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
