"""A mesh file as the shape of one body: what collides, what is drawn, in which colours."""

from __future__ import annotations

from pathlib import Path

import mujoco

from embodichain.data import DataNotFoundError, get_data_path
from embodichain.lab.sim.compiler.collision import COLLISION_GROUP, VISUAL_GROUP
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.visuals import surface
from embodichain.lab.sim.meshes.conversion import (
    MadeVisual,
    convert_collision,
    convert_visual,
    has_materials,
    reads,
)
from embodichain.lab.sim.meshes.decomposition import decompose
from embodichain.lab.sim.meshes.part import MeshError
from embodichain.lab.sim.shapes import MeshCfg
from embodichain.utils.errors import Problem

__all__ = ["add_mesh", "check_mesh"]

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
