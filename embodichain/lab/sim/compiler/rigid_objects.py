"""Rigid objects: initial pose, body, shape or mesh, contact and damping."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from embodichain.data import DataNotFoundError, get_data_path
from embodichain.lab.sim.cfg import ObjectBaseCfg, RigidObjectCfg, VariantCfg
from embodichain.lab.sim.compiler.contact_parameters import set_contact_parameters
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import check_uid
from embodichain.lab.sim.compiler.object_contacts import check_object_contact, object_contact
from embodichain.lab.sim.compiler.textures import add_textures, check_textures
from embodichain.lab.sim.meshes.mesh_conversion import (
    MadePart,
    MadeVisual,
    convert_collision,
    convert_visual,
    decompose,
    has_materials,
    reads,
)
from embodichain.lab.sim.meshes.mesh_reading import MeshError
from embodichain.lab.sim.shapes import (
    AnyShapeCfg,
    CapsuleCfg,
    CubeCfg,
    CylinderCfg,
    MeshCfg,
    PlaneCfg,
    SphereCfg,
    VisualMaterialCfg,
)
from embodichain.utils.defaults import is_given
from embodichain.utils.errors import ConfigError, OutsideError, Problem
from embodichain.utils.math import euler_xyz_to_quat, matrix_to_quat, normalize_quat

__all__ = [
    "COLLISION_GROUP",
    "HAS_SHAPES",
    "HULL_VERTICES",
    "OF_EACH_SHAPE",
    "VISUAL_GROUP",
    "add_object",
    "add_shape",
    "check_object",
    "check_pose",
    "check_shape",
    "collides",
    "damping_of",
    "given_pose",
    "inertia_about_axes",
    "initial_pose",
    "keep_hull_inertia",
    "set_collision",
    "shapes_of",
]

VISUAL_GROUP = 2
"""Group of visual shapes; by default MuJoCo draws groups 0 to 2."""
COLLISION_GROUP = 3
"""Group of collision shapes of bodies that have visual ones: not drawn."""
HULL_VERTICES = 64
"""Maximum number of vertices of a mesh's convex hull."""
_PALETTE = (
    (0.86, 0.36, 0.26),
    (0.25, 0.55, 0.75),
    (0.93, 0.69, 0.25),
    (0.38, 0.65, 0.42),
    (0.58, 0.44, 0.69),
)
_GEOM, _INERTIA = mujoco.mjtGeom, mujoco.mjtMeshInertia
_NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])


def initial_pose(cfg: ObjectBaseCfg) -> tuple[F64, F64]:
    """Return position (3,) in metres and unit wxyz quaternion (4,); what is not given is no change.

    `init_local_pose` overrides `init_quat`, which overrides `init_rot` (degrees, intrinsic XYZ).

    Raises:
        ConfigError: If a value has the wrong shape, is not finite, or is not a rotation.
    """
    pos, quat = given_pose(cfg)
    return np.zeros(3) if pos is None else pos, _NO_TURN.copy() if quat is None else quat


def given_pose(cfg: ObjectBaseCfg) -> tuple[F64 | None, F64 | None]:
    """As `initial_pose`; None for a position or an orientation that the config does not give."""
    if cfg.init_local_pose is not None:
        matrix = _vector(cfg.init_local_pose, 16, "init_local_pose").reshape(4, 4)
        rotation = matrix[:3, :3]
        off = np.abs(rotation @ rotation.T - np.eye(3)).max()
        if off > 1e-3 or np.linalg.det(rotation) < 0 or not np.allclose(matrix[3], [0, 0, 0, 1]):
            message = "must be a 4x4 rigid transform: a rotation, a translation, last row 0 0 0 1"
            raise ConfigError([Problem("init_local_pose", message)])
        return matrix[:3, 3].copy(), matrix_to_quat(rotation)
    # Both are None in an `ArticulationCfg` that does not give them.
    at: object = cfg.init_pos
    turned: object = cfg.init_rot
    pos = None if at is None else _vector(at, 3, "init_pos")
    if cfg.init_quat is not None:
        quat = _vector(cfg.init_quat, 4, "init_quat")
        try:
            return pos, normalize_quat(quat)
        except ValueError as error:
            raise ConfigError([Problem("init_quat", f"{error}, got {quat.tolist()}")]) from error
    if turned is None:
        return pos, None
    return pos, euler_xyz_to_quat(_vector(turned, 3, "init_rot") * (math.pi / 180.0))


def _vector(value: object, size: int, key: str) -> F64:
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise ConfigError([Problem(key, f"must be {size} numbers, got {value!r}")]) from None
    if array.size != size or not np.isfinite(array).all():
        raise ConfigError([Problem(key, f"must be {size} finite numbers, got {array.tolist()}")])
    return array.reshape(-1).copy()


def check_pose(cfg: ObjectBaseCfg) -> list[Problem]:
    """Return what is wrong with an initial pose."""
    try:
        initial_pose(cfg)
    except ConfigError as error:
        return list(error.problems)
    return []


def check_object(cfg: RigidObjectCfg) -> list[Problem]:
    """Return every mistake in an object's config, with paths below it."""
    problems = check_pose(cfg) + _check_attrs(cfg) + check_object_contact(cfg)
    if cfg.any_of:
        # A config made in Python cannot say whether a default was given; for YAML, see
        # `config.given_keys`.
        for name in OF_EACH_SHAPE:
            if not _same(getattr(cfg, name), getattr(RigidObjectCfg(), name)):
                problems.append(Problem(name, HAS_SHAPES))
    for name, one in shapes_of(cfg).items():
        if not cfg.any_of:
            return problems + _check_shape(one)
        path = f"any_of.{name}"
        problems += check_uid(name, path, {})
        problems += [p.below(path) for p in _check_place(cfg.any_of[name]) + _check_shape(one)]
    return problems


OF_EACH_SHAPE = ("shape", "body_scale", "max_convex_hull_num", "collision")
"""Fields of an object that each shape of `any_of` has instead."""
HAS_SHAPES = "the object has any_of: give each of its shapes there"


def _same(a: object, b: object) -> bool:
    return list(a) == list(b) if isinstance(a, Sequence) and isinstance(b, Sequence) else a == b


def _check_place(variant: VariantCfg) -> list[Problem]:
    names = {"init_pos": "pos", "init_rot": "rot", "init_quat": "quat"}
    found = check_pose(_place(variant))
    return [Problem(names[p.path], p.message, p.hint) for p in found]


def _place(variant: VariantCfg) -> ObjectBaseCfg:
    return ObjectBaseCfg(init_pos=variant.pos, init_rot=variant.rot, init_quat=variant.quat)


def shapes_of(cfg: RigidObjectCfg) -> dict[str, RigidObjectCfg]:
    """Return the shapes that an object may have, each as an object of its own, by name.

    The shape of an object without `any_of` has the name "".
    """
    found = {}
    for name, variant in cfg.any_of.items():
        given = {key: getattr(variant, key) for key in ("mass", "density", "dynamic_friction")}
        given = {key: value for key, value in given.items() if value is not None}
        own = ("shape", "body_scale", "max_convex_hull_num", "collision")
        found[name] = dataclasses.replace(
            cfg,
            any_of={},
            attrs=dataclasses.replace(cfg.attrs, **given),
            **{key: getattr(variant, key) for key in own},
        )
    return found or {"": cfg}


def _check_shape(cfg: RigidObjectCfg) -> list[Problem]:
    problems: list[Problem] = []
    if cfg.collision == "decompose" and _given_parts(cfg) == 1:
        message = "1 part is the hull, but collision is decompose: leave one of them out"
        problems.append(Problem("max_convex_hull_num", message))
    scale = np.asarray(cfg.body_scale, np.float64)
    if scale.shape != (3,) or not (scale > 0).all():
        problems.append(Problem("body_scale", f"must be 3 positive numbers, got {scale.tolist()}"))
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
    look = cfg.shape.visual_material
    if look is not None and look.textures is not None:
        problems += check_textures(look.textures, "shape.visual_material.textures")
    if isinstance(cfg.shape, PlaneCfg) and cfg.body_type != "static":
        message = f"a Plane must be static, got {cfg.body_type!r}"
        problems.append(Problem("body_type", message))
    return problems


def _check_attrs(cfg: RigidObjectCfg) -> list[Problem]:
    problems: list[Problem] = []
    attrs = cfg.attrs
    for name in ("mass", "linear_damping", "angular_damping", "dynamic_friction"):
        value = getattr(attrs, name)
        if not (value >= 0 and np.isfinite(value)):
            message = f"must be finite and not negative, got {value}"
            problems.append(Problem(f"attrs.{name}", message))
    if attrs.mass == 0 and not attrs.density > 0:
        message = f"must be positive as mass is 0, got {attrs.density}"
        problems.append(Problem("attrs.density", message))
    return problems


def _convex_parts(cfg: RigidObjectCfg) -> int | None:
    """Maximum number of convex parts of a mesh; 1 is its hull, None as many as needed."""
    given = _given_parts(cfg)
    if given is not None:
        return given
    return None if cfg.collision == "decompose" else 1


def _given_parts(cfg: RigidObjectCfg) -> int | None:
    number = cfg.max_convex_hull_num
    return int(number) if is_given(number) else None


def check_shape(shape: AnyShapeCfg, scale: F64, max_parts: int | None = 1) -> list[Problem]:
    """Return every mistake in a shape; paths begin with ``shape`` or ``body_scale``.

    Args:
        shape: The shape; a mesh file is read (`add_shape` needs it as well).
        scale: (3,) factors.
        max_parts: Maximum number of convex collision parts; 1 is the hull, None as many as needed.
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
    if isinstance(shape, MeshCfg) and not shape.fpath:
        problems.append(Problem("shape.fpath", "a Mesh needs a file"))
    elif isinstance(shape, MeshCfg):
        try:
            path = Path(get_data_path(shape.fpath))
            _shape_file(path)
            if max_parts != 1:
                decompose(path, max_parts)
            if shape.visual_material is None:
                _look(path)
        except (DataNotFoundError, OutsideError, MeshError, OSError) as error:
            problems.append(Problem("shape.fpath", str(error)))
    return problems


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
    for order, (name, one) in enumerate(shapes_of(cfg).items()):
        before, prefix = len(body.geoms), f"{uid}/{name}" if name else uid
        scale, parts = np.asarray(one.body_scale, np.float64), _convex_parts(one)
        geom = add_shape(spec, body, prefix, one.shape, scale, number + order, parts)
        attrs = one.attrs
        if attrs.mass > 0:
            geom.mass = float(attrs.mass)
        else:
            geom.density = float(attrs.density)
        geoms = body.geoms[before:]
        set_contact_parameters(geoms, object_contact(one))
        set_collision(geoms, attrs.enable_collision)
        if name:
            body.userdata = [0.0]  # the index of the shape, as a field of each environment
            place = initial_pose(_place(cfg.any_of[name]))
            for part in geoms:
                part.pos, part.quat = place
        if order:
            geom.mass = 0.0
            for part in geoms:
                part.rgba[3] = 0.0
    keep_hull_inertia(spec, body)


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
        body: Its body; a mesh of several colours or convex parts adds more geoms.
        uid: Prefix of the names.
        shape: The shape, checked.
        scale: (3,) factors.
        number: Selects a colour if there is none.
        max_parts: See `check_shape`.
    """
    geom = body.add_geom(name=f"{uid}/geom")
    if isinstance(shape, MeshCfg):
        _add_mesh(spec, geom, uid, shape, scale, number, max_parts)
        return geom
    geom.material = _surface(spec, uid, shape.visual_material, number)
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


def _surface(spec: mujoco.MjSpec, uid: str, cfg: VisualMaterialCfg | None, number: int) -> str:
    """Add an object's material and return its name; without a config, `number` sets the colour."""
    name = f"{uid}/material"
    if cfg is None:
        rgba = [*_PALETTE[number % len(_PALETTE)], 1.0]
        spec.add_material(name=name, rgba=rgba, specular=0.2, shininess=0.3)
        return name
    material = spec.add_material(
        name=name,
        rgba=[float(c) for c in cfg.base_color],
        specular=0.5 * (1.0 - float(cfg.roughness)),
        shininess=1.0 - float(cfg.roughness),
        metallic=float(cfg.metallic),
        roughness=float(cfg.roughness),
        emission=float(cfg.emissive_intensity) * float(max(cfg.emissive)),
    )
    if cfg.textures:
        first = add_textures(spec, uid, cfg.textures)[0]
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = first
    return name


def _add_mesh(
    spec: mujoco.MjSpec,
    geom: mujoco.MjsGeom,
    uid: str,
    shape: MeshCfg,
    scale: F64,
    number: int,
    max_parts: int | None,
) -> None:
    """Turn a geom into the mesh, and add geoms to its body where one is not enough.

    The geom has the mass and its hull collides. For several colours, geoms without mass and
    contacts are added that are drawn; for convex parts, geoms that collide in its place.
    """
    path, body = Path(get_data_path(shape.fpath)), geom.parent

    def mesh(name: str, file: Path) -> mujoco.MjsMesh:
        added = spec.add_mesh(name=f"{uid}/{name}", file=str(file))
        added.scale, added.maxhullvert = scale, HULL_VERTICES
        return added

    def add(name: str, group: int) -> mujoco.MjsGeom:
        kind = _GEOM.mjGEOM_MESH
        return body.add_geom(name=name, type=kind, meshname=name, mass=0.0, group=group)

    look = _look(path) if shape.visual_material is None else None
    single = look is not None and len(look.parts) == 1
    whole = mesh("mesh", look.parts[0].mesh if look is not None and single else _shape_file(path))
    if not reads(path):
        whole.inertia = _INERTIA.mjMESH_INERTIA_CONVEX
    geom.type, geom.meshname = _GEOM.mjGEOM_MESH, whole.name
    if look is None:
        geom.material = _surface(spec, uid, shape.visual_material, number)
    elif single:
        geom.material = _add_material(spec, f"{uid}/material", look.parts[0])
    else:
        geom.group = COLLISION_GROUP
        for i, part in enumerate(look.parts):
            visual = mesh(f"visual_{i}", part.mesh)
            visual.inertia = _INERTIA.mjMESH_INERTIA_SHELL
            drawn = add(visual.name, VISUAL_GROUP)
            drawn.contype = drawn.conaffinity = 0
            name = f"{uid}/material_{i}" if i else f"{uid}/material"
            drawn.material = _add_material(spec, name, part)
    if max_parts != 1:
        geom.contype = geom.conaffinity = 0
        for i, convex in enumerate(decompose(path, max_parts)):
            add(mesh(f"part_{i}", convex).name, COLLISION_GROUP)


def _shape_file(path: Path) -> Path:
    return path if reads(path) else convert_collision(path)


def _look(path: Path) -> MadeVisual | None:
    """Return the file's parts if it has colours; None if MuJoCo draws the file as it is."""
    if reads(path) and not has_materials(path):
        return None
    made = convert_visual(path)
    colored = any(part.rgba is not None or part.texture is not None for part in made.parts)
    return made if colored else None


def _add_material(spec: mujoco.MjSpec, name: str, part: MadePart) -> str:
    material = spec.add_material(name=name, specular=0.2, shininess=0.3)
    if part.rgba is not None:
        material.rgba = part.rgba
    if part.texture is not None:
        spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=str(part.texture))
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    return name


def collides(geom: mujoco.MjsGeom) -> bool:
    """Whether a geom takes part in collision."""
    return bool(geom.contype or geom.conaffinity)


def set_collision(geoms: Sequence[mujoco.MjsGeom], enabled: bool) -> None:
    """Let geoms collide with nothing unless they are enabled."""
    for geom in geoms if not enabled else ():
        geom.contype = geom.conaffinity = 0


def damping_of(model: mujoco.MjModel, body: int, cfg: RigidObjectCfg) -> F64:
    """Return the free joint's damping (6,) that makes velocities decay at the config's rates.

    Force = -linear_damping x mass x v, torque = -angular_damping x inertia x w, so that velocities
    decay as ``exp(-damping t)`` for any size of body. MuJoCo's joint damping is one number per
    axis: only the diagonal of the inertia tensor in the body's axes is used.
    """
    inertia = inertia_about_axes(model.body_iquat[body], model.body_inertia[body])
    linear = np.full(3, cfg.attrs.linear_damping * model.body_mass[body])
    return np.concatenate([linear, cfg.attrs.angular_damping * inertia])


def keep_hull_inertia(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    """Give a body the mass and inertia that its meshes have without a limit on hull vertices.

    They differ where a mesh has the inertia of its hull.

    Args:
        spec: The scene.
        body: The body, its shapes added.
    """
    heavy = [geom for geom in body.geoms if geom.mass != 0.0]
    meshes = {geom.meshname: spec.mesh(geom.meshname) for geom in heavy if geom.meshname}
    if not any(mesh.inertia == _INERTIA.mjMESH_INERTIA_CONVEX for mesh in meshes.values()):
        return
    alone = mujoco.MjSpec()
    there = alone.worldbody.add_body()
    for name, mesh in meshes.items():
        copy = alone.add_mesh(name=name, file=mesh.file)
        copy.scale, copy.inertia = mesh.scale, mesh.inertia
    for geom in heavy:
        copy = there.add_geom(type=geom.type, meshname=geom.meshname)
        for field in ("pos", "quat", "size", "mass", "density"):
            setattr(copy, field, getattr(geom, field))
    try:
        model = alone.compile()
    except ValueError:
        return  # the scene, which has the same meshes, cannot be compiled: it says why
    starts = [int(start) for start in model.mesh_graphadr if start >= 0]
    if all(model.mesh_graph[start] <= HULL_VERTICES for start in starts):
        return
    body.explicitinertial = True
    body.mass = float(model.body_mass[1])
    body.ipos, body.iquat = model.body_ipos[1], model.body_iquat[1]
    body.inertia = model.body_inertia[1]


def inertia_about_axes(iquat: F64, moments: F64) -> F64:
    """Diagonal of the inertia tensor in the body's axes.

    Terms are added in a fixed order, so results do not depend on the number of environments.

    Args:
        iquat: (4,) orientation of the principal axes in the body, wxyz.
        moments: (..., 3) principal moments, kg m^2.
    """
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, iquat)
    squares = rotation.reshape(3, 3) ** 2
    found: F64 = moments[..., :1] * squares[:, 0]
    found = found + moments[..., 1:2] * squares[:, 1]
    return found + moments[..., 2:] * squares[:, 2]
