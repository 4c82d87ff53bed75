"""Mesh files into parts of one material each; pycollada reads COLLADA, trimesh everything else.

Both are imported here only, when a file needs them.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from embodichain.lab.sim.meshes.collada import read_collada
from embodichain.lab.sim.meshes.part import MeshData, MeshError, MeshPart, Rgba, joined
from embodichain.lab.sim.meshes.texture import as_rgb, mean_color

__all__ = ["SUFFIXES", "read_mesh"]

SUFFIXES = (".dae", ".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
"""What can be read."""

_MAX_COLORS = 16  # colours of faces that become parts; above, one part in their mean colour


def read_mesh(path: Path) -> MeshData:
    """Read a mesh file: metres, z up.

    Units and up axis of COLLADA are followed. Other formats hold numbers without units, taken as
    metres; glTF calls y up, but its coordinates are not turned, as EmbodiChain does not either.

    Raises:
        MeshError: If the format is none of `SUFFIXES`, a library is missing, or the file is broken.
    """
    if path.suffix.lower() not in SUFFIXES:
        message = f"{path}: format {path.suffix or 'none'} is none of {', '.join(SUFFIXES)}"
        raise MeshError(message)
    try:
        data = read_collada(path) if path.suffix.lower() == ".dae" else _read_other(path)
    except ImportError as error:
        message = f"{path}: needs {error.name}: pip install trimesh pycollada"
        raise MeshError(message) from error
    for part in data.parts:
        if part.texture is not None and part.uv is None:
            data.notes.append("a texture without coordinates: drawn in its mean colour")
            part.rgba, part.texture = mean_color(part.texture), None
    data.parts = list(_by_material(data.parts))
    return data


def _by_material(parts: list[MeshPart]) -> Iterator[MeshPart]:
    """Yield one part for each material; coordinates of a texture that is not there are left out."""
    groups: dict[tuple[Rgba | None, int], list[MeshPart]] = {}
    for part in parts:
        groups.setdefault((part.rgba, id(part.texture)), []).append(part)
    for same in groups.values():
        first = same[0]
        whole = joined(same, textured=first.texture is not None)
        whole.rgba, whole.texture = first.rgba, first.texture
        yield whole


def _read_other(path: Path) -> MeshData:
    import trimesh

    try:
        scene = trimesh.load_scene(path, process=False)
        meshes = [m for m in scene.dump() if isinstance(m, trimesh.Trimesh) and len(m.faces)]
    except (ValueError, KeyError, IndexError, TypeError, OSError, AttributeError) as error:
        # trimesh raises whatever a broken file makes its parser do
        raise MeshError(f"{path}: cannot be read: {error}") from error
    data = MeshData([])
    for mesh in meshes:
        data.parts += _parts(mesh, data.notes)
    if not data.parts:
        raise MeshError(f"{path}: it holds no triangles")
    return data


def _parts(mesh: Any, notes: list[str]) -> list[MeshPart]:
    visual, kind = mesh.visual, mesh.visual.kind
    corners = np.asarray(mesh.vertices)[mesh.faces]
    if kind in ("face", "vertex"):
        return _by_color(corners, np.asarray(visual.face_colors), notes)
    if kind != "texture":
        return [MeshPart.of_corners(corners)]
    uv = np.asarray(visual.uv)[mesh.faces] if visual.uv is not None else None
    part = MeshPart.of_corners(corners, uv)
    material = visual.material
    part.rgba = _rgba(material)
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    part.texture = as_rgb(image) if image is not None else None
    return [part]


def _rgba(material: Any) -> Rgba | None:
    """The base colour of either kind of trimesh material; white where it has none, as in glTF."""
    color = getattr(material, "baseColorFactor", None)
    color = color if color is not None else getattr(material, "diffuse", None)
    if color is None:
        return 1.0, 1.0, 1.0, 1.0
    values = [float(c) / 255.0 for c in np.asarray(color).ravel()]
    red, green, blue, alpha = (*values, 1.0)[:4]
    return red, green, blue, alpha


def _by_color(corners: Any, colors: Any, notes: list[str]) -> list[MeshPart]:
    """Split triangles by colour: MuJoCo's vertices have none."""
    found, which = np.unique(colors, axis=0, return_inverse=True)
    if len(found) > _MAX_COLORS:
        notes.append(f"{len(found)} colours of faces or vertices: drawn in their mean colour")
        found, which = colors.mean(axis=0, keepdims=True), np.zeros(len(colors), np.int64)
    parts = []
    for number, color in enumerate(found):
        part = MeshPart.of_corners(corners[which.ravel() == number])
        red, green, blue, alpha = (float(c) / 255.0 for c in color)
        part.rgba = (red, green, blue, alpha)
        parts.append(part)
    return parts
