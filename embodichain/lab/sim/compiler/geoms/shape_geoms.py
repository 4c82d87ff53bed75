"""`add_shape`: shapes and meshes of a config as geoms of a body, checked before."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from embodichain.data import DataNotFoundError, get_data_path
from embodichain.lab.sim.compiler.geoms.mesh_conversion import (
    MadePart,
    MadeVisual,
    convert_collision,
    convert_visual,
    decompose,
    has_materials,
    reads,
    split_pieces,
)
from embodichain.lab.sim.compiler.geoms.mesh_reading import MeshError
from embodichain.lab.sim.compiler.geoms.textures import add_textures
from embodichain.lab.sim.compiler.index import F64
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
from embodichain.utils.errors import OutsideError, Problem

__all__ = [
    "COLLISION_GROUP",
    "HULL_VERTICES",
    "VISUAL_GROUP",
    "ConvexParts",
    "add_shape",
    "check_geometry",
    "collides",
    "inertia_about_axes",
    "keep_hull_inertia",
    "set_collision",
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
ConvexParts = int | Literal["pieces"] | None
"""Collision parts of a mesh: at most so many, 1 being its hull; its pieces; as many as needed."""
_GEOM = mujoco.mjtGeom
_INERTIA = mujoco.mjtMeshInertia


def check_geometry(shape: AnyShapeCfg, scale: F64, parts: ConvexParts = 1) -> list[Problem]:
    """Return every mistake in a shape; paths begin with ``shape`` or ``body_scale``.

    Args:
        shape: The shape; a mesh file is read (`add_shape` needs it as well).
        scale: (3,) factors.
        parts: Its convex collision parts.
    """
    problems: list[Problem] = []
    if isinstance(shape, (CylinderCfg, CapsuleCfg)) and scale[0] != scale[1]:
        message = f"a {shape.shape_type} scales equally along x and y, got {scale.tolist()}"
        problems.append(Problem("body_scale", message))
    if isinstance(shape, MeshCfg):
        problems += _check_mesh(shape, parts)
    return problems


def _check_mesh(shape: MeshCfg, parts: ConvexParts) -> list[Problem]:
    """Return what is wrong with a mesh file: it is read, and converted where that is needed."""
    if not shape.fpath:
        return [Problem("shape.fpath", "a Mesh needs a file")]
    try:
        path = Path(get_data_path(shape.fpath))
        _shape_file(path)
        _convex_files(path, parts)
        if shape.visual_material is None:
            _convert_look(path)
    except (DataNotFoundError, OutsideError, MeshError, OSError) as error:
        return [Problem("shape.fpath", str(error))]
    return []


def add_shape(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    uid: str,
    shape: AnyShapeCfg,
    scale: F64,
    number: int,
    parts: ConvexParts = 1,
) -> mujoco.MjsGeom:
    """Add geom ``uid/geom`` with type, size (half sizes, MuJoCo's) and material, and return it.

    Args:
        spec: The scene.
        body: Its body; a mesh of several colours or convex parts adds more geoms.
        uid: Prefix of the names.
        shape: The shape, checked.
        scale: (3,) factors.
        number: Selects a colour if there is none.
        parts: See `check_geometry`.
    """
    geom = body.add_geom(name=f"{uid}/geom")
    if isinstance(shape, MeshCfg):
        _add_mesh(spec, geom, uid, shape, scale, number, parts)
        return geom
    geom.material = _surface(spec, uid, shape.visual_material, number)
    if isinstance(shape, CubeCfg):
        geom.type = _GEOM.mjGEOM_BOX
        geom.size = 0.5 * np.asarray(shape.size) * scale
    elif isinstance(shape, SphereCfg):
        radii = shape.radius * scale
        if radii[0] == radii[1] == radii[2]:
            geom.type = _GEOM.mjGEOM_SPHERE
            geom.size = [radii[0], 0.0, 0.0]
        else:
            geom.type = _GEOM.mjGEOM_ELLIPSOID
            geom.size = radii
    elif isinstance(shape, PlaneCfg):
        geom.type = _GEOM.mjGEOM_PLANE
        geom.size = [0.5 * shape.size[0] * scale[0], 0.5 * shape.size[1] * scale[1], 1.0]
    else:
        is_capsule = isinstance(shape, CapsuleCfg)
        geom.type = _GEOM.mjGEOM_CAPSULE if is_capsule else _GEOM.mjGEOM_CYLINDER
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
    parts: ConvexParts,
) -> None:
    """Turn a geom into the mesh, and add geoms to its body where one is not enough.

    The geom has the mass and its hull collides. For several colours, geoms without mass and
    contacts are added that are drawn; for convex parts, geoms that collide in its place.
    """
    path = Path(get_data_path(shape.fpath))
    body = geom.parent
    look = _convert_look(path) if shape.visual_material is None else None
    # A single part has all triangles of the file, with texture coordinates.
    single_part = look.parts[0] if look is not None and len(look.parts) == 1 else None
    file = _shape_file(path) if single_part is None else single_part.mesh
    mesh = _add_mesh_file(spec, f"{uid}/mesh", file, scale)
    if not reads(path):
        mesh.inertia = _INERTIA.mjMESH_INERTIA_CONVEX
    if parts == "pieces":  # MuJoCo's default one fills what is hollow
        mesh.inertia = _INERTIA.mjMESH_INERTIA_EXACT
    geom.type = _GEOM.mjGEOM_MESH
    geom.meshname = mesh.name

    if look is None:
        geom.material = _surface(spec, uid, shape.visual_material, number)
    elif single_part is not None:
        geom.material = _add_material(spec, f"{uid}/material", single_part)
    else:
        geom.group = COLLISION_GROUP
        for i, part in enumerate(look.parts):
            visual_mesh = _add_mesh_file(spec, f"{uid}/visual_{i}", part.mesh, scale)
            visual_mesh.inertia = _INERTIA.mjMESH_INERTIA_SHELL
            visual = _add_massless_geom(body, visual_mesh.name, VISUAL_GROUP)
            visual.contype = visual.conaffinity = 0
            name = f"{uid}/material_{i}" if i else f"{uid}/material"
            visual.material = _add_material(spec, name, part)

    convex_files = _convex_files(path, parts)
    if convex_files:
        geom.contype = geom.conaffinity = 0
    for i, part_file in enumerate(convex_files):
        part_mesh = _add_mesh_file(spec, f"{uid}/part_{i}", part_file, scale)
        _add_massless_geom(body, part_mesh.name, COLLISION_GROUP)


def _convex_files(path: Path, parts: ConvexParts) -> tuple[Path, ...]:
    """Return the files of a mesh's convex parts; none if its hull collides."""
    if parts == 1:
        return ()
    if parts == "pieces":
        return split_pieces(path)
    return decompose(path, parts)


def _add_mesh_file(spec: mujoco.MjSpec, name: str, file: Path, scale: F64) -> mujoco.MjsMesh:
    mesh = spec.add_mesh(name=name, file=str(file))
    mesh.scale = scale
    mesh.maxhullvert = HULL_VERTICES
    return mesh


def _add_massless_geom(body: mujoco.MjsBody, mesh: str, group: int) -> mujoco.MjsGeom:
    """Add a geom to a body, called like its mesh, that changes nothing of the body's inertia."""
    return body.add_geom(name=mesh, type=_GEOM.mjGEOM_MESH, meshname=mesh, mass=0.0, group=group)


def _shape_file(path: Path) -> Path:
    return path if reads(path) else convert_collision(path)


def _convert_look(path: Path) -> MadeVisual | None:
    """Return the file's parts if it has colours; None if MuJoCo draws the file as it is."""
    if reads(path) and not has_materials(path):
        return None
    visual = convert_visual(path)
    if any(part.rgba is not None or part.texture is not None for part in visual.parts):
        return visual
    return None


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
    if enabled:
        return
    for geom in geoms:
        geom.contype = geom.conaffinity = 0


def keep_hull_inertia(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    """Give a body the mass and inertia that its meshes have without a limit on hull vertices.

    They differ where a mesh has the inertia of its hull.

    Args:
        spec: The scene.
        body: The body, its shapes added.
    """
    geoms = [geom for geom in body.geoms if geom.mass != 0.0]
    meshes = {geom.meshname: spec.mesh(geom.meshname) for geom in geoms if geom.meshname}
    if not any(mesh.inertia == _INERTIA.mjMESH_INERTIA_CONVEX for mesh in meshes.values()):
        return
    alone = mujoco.MjSpec()
    body_alone = alone.worldbody.add_body()
    for name, mesh in meshes.items():
        unlimited_mesh = alone.add_mesh(name=name, file=mesh.file)
        unlimited_mesh.scale = mesh.scale
        unlimited_mesh.inertia = mesh.inertia
    for geom in geoms:
        geom_alone = body_alone.add_geom(type=geom.type, meshname=geom.meshname)
        for field in ("pos", "quat", "size", "mass", "density"):
            setattr(geom_alone, field, getattr(geom, field))
    try:
        model = alone.compile()
    except ValueError:
        return  # the scene, which has the same meshes, cannot be compiled: it says why
    starts = [int(start) for start in model.mesh_graphadr if start >= 0]
    if all(model.mesh_graph[start] <= HULL_VERTICES for start in starts):
        return
    body.explicitinertial = True
    body.mass = float(model.body_mass[1])
    body.ipos = model.body_ipos[1]
    body.iquat = model.body_iquat[1]
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
    about_axes = moments[..., :1] * squares[:, 0]
    about_axes = about_axes + moments[..., 1:2] * squares[:, 1]
    return about_axes + moments[..., 2:] * squares[:, 2]
