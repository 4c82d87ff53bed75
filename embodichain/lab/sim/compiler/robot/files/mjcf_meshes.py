"""Meshes and other files of an MJCF: where they are, formats, convex parts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco

from embodichain.lab.sim.compiler.geoms.mesh_conversion import convert_collision, decompose, reads
from embodichain.lab.sim.compiler.geoms.shape_geoms import COLLISION_GROUP, HULL_VERTICES, collides
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["convert_meshes", "make_absolute", "missing_files", "split_meshes"]

_CONTACT_FIELDS = (
    "contype",
    "conaffinity",
    "condim",
    "priority",
    "friction",
    "solref",
    "solimp",
    "solmix",
    "margin",
    "gap",
)
_ORIENTATION_FIELDS = ("type", "axisangle", "xyaxes", "zaxis", "euler")
"""Other ways than a quaternion in which a file can give an orientation."""


@dataclass(frozen=True)
class _Asset:
    """An asset of an MJCF that is in a file.

    Attributes:
        kind: What it is, for messages.
        folder: Its folder, by the file's options; absolute or below the MJCF's.
        element: The asset.
    """

    kind: str
    folder: str
    element: Any


def _assets(spec: mujoco.MjSpec) -> list[_Asset]:
    """Return the meshes, textures and height fields of a file that are files of their own."""
    assets = [_Asset("mesh", spec.meshdir, mesh) for mesh in spec.meshes]
    assets += [_Asset("texture", spec.texturedir, texture) for texture in spec.textures]
    assets += [_Asset("height field", spec.meshdir, hfield) for hfield in spec.hfields]
    return [asset for asset in assets if asset.element.file]


def make_absolute(spec: mujoco.MjSpec, folder: Path) -> None:
    """Make file names of assets absolute, so that equal names of two robots do not clash.

    Args:
        spec: The parsed file.
        folder: Its folder.
    """
    for asset in _assets(spec):
        # MuJoCo resolves names from an <include> in another folder.
        path = folder / asset.folder / asset.element.file
        if path.is_file():
            asset.element.file = str(path.resolve())


def missing_files(spec: mujoco.MjSpec, path: Path) -> list[Problem]:
    """Return a problem for each asset whose file is not there.

    Args:
        spec: The parsed file, which MuJoCo could not compile.
        path: The file.
    """
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    problems: dict[Path, Problem] = {}
    for asset in _assets(spec):
        name = asset.element.file
        file = path.parent / asset.folder / name
        if file.is_file() or file in problems:
            continue
        line = next((i for i, text in enumerate(lines, 1) if Path(name).name in text), None)
        place = f"{path}:{line}" if line else str(path)
        what = f"{place}: {asset.kind} {asset.element.name!r}: no file {file.name!r}"
        names: list[str] = []
        reason = "there is no such folder"
        if file.parent.is_dir():
            names = sorted(p.name for p in file.parent.iterdir())
            reason = f"there are: {listing(names)}"
        message = f"{what} in {file.parent}; {reason}.{did_you_mean(file.name, names)}"
        problems[file] = Problem("", message)
    return list(problems.values())


def convert_meshes(spec: mujoco.MjSpec) -> Iterator[str]:
    """Convert meshes that MuJoCo does not read, such as ASCII STL, without colours.

    Yields:
        One line for each.
    """
    for mesh in spec.meshes:
        file = Path(mesh.file)
        if mesh.file and file.is_file() and not reads(file):
            mesh.file = str(convert_collision(file))
            yield f"{file}: not a mesh that MuJoCo reads: converted, its shape alone"


def split_meshes(spec: mujoco.MjSpec) -> None:
    """Let convex parts of meshes collide in place of the meshes' hulls.

    A geom keeps its mass and look; parts have its contact properties. Meshes whose vertices are in
    the XML keep their hull.

    Raises:
        MeshError: If a mesh cannot be split, or CoACD is missing.
        OSError: If the cache cannot be written.
    """
    meshes = {mesh.name: mesh for mesh in spec.meshes}
    parts: dict[str, list[str]] = {}
    for geom in list(spec.geoms):
        mesh = meshes.get(geom.meshname)
        if mesh is None or not mesh.file or not collides(geom):
            continue
        if geom.type != mujoco.mjtGeom.mjGEOM_MESH:  # a primitive that is fitted to the mesh
            continue
        if mesh.name not in parts:
            parts[mesh.name] = list(_split(spec, mesh))
        for number, name in enumerate(parts[mesh.name]):
            part = geom.parent.add_geom(
                name=f"{geom.name}_part_{number}", type=geom.type, meshname=name, mass=0.0
            )
            part.group = COLLISION_GROUP
            part.pos = geom.pos
            part.quat = geom.quat
            for field in _ORIENTATION_FIELDS:
                setattr(part.alt, field, getattr(geom.alt, field))
            for field in _CONTACT_FIELDS:
                setattr(part, field, getattr(geom, field))
        geom.contype = geom.conaffinity = 0


def _split(spec: mujoco.MjSpec, mesh: mujoco.MjsMesh) -> Iterator[str]:
    """Add the convex parts of a mesh, and yield their names."""
    for number, file in enumerate(decompose(Path(mesh.file))):
        part = spec.add_mesh(name=f"{mesh.name}_part_{number}", file=str(file))
        part.scale = mesh.scale
        part.refpos = mesh.refpos
        part.refquat = mesh.refquat
        part.maxhullvert = HULL_VERTICES
        yield part.name
