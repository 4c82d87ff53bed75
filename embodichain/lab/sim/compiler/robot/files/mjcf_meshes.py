"""Meshes and other files of an MJCF: where they are, formats, convex parts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco

from embodichain.lab.sim.compiler.geoms.mesh_conversion import convert_collision, decompose, reads
from embodichain.lab.sim.compiler.geoms.shape_geoms import COLLISION_GROUP, HULL_VERTICES, collides
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["convert_meshes", "make_absolute", "missing_files", "split_meshes"]

_CONTACT = (
    *("contype", "conaffinity", "condim", "priority", "friction", "solref", "solimp", "solmix"),
    *("margin", "gap"),
)
_TURN = ("type", "axisangle", "xyaxes", "zaxis", "euler")


def _assets(spec: mujoco.MjSpec) -> Iterator[tuple[str, str, mujoco.MjsElement]]:
    """Yield the kind, the folder in the file's options, and the asset."""
    for kind, directory, assets in (
        ("mesh", spec.meshdir, spec.meshes),
        ("texture", spec.texturedir, spec.textures),
        ("height field", spec.meshdir, spec.hfields),
    ):
        for asset in assets:
            if asset.file:
                yield kind, directory, asset


def make_absolute(spec: mujoco.MjSpec, folder: Path) -> None:
    """Make file names of assets absolute, so that equal names of two robots do not clash.

    Args:
        spec: The parsed file.
        folder: Its folder.
    """
    for _, directory, asset in _assets(spec):
        # MuJoCo resolves names from an <include> in another folder.
        path = folder / directory / asset.file
        if path.is_file():
            asset.file = str(path.resolve())


def missing_files(spec: mujoco.MjSpec, path: Path) -> list[Problem]:
    """Return a problem for each asset whose file is not there.

    Args:
        spec: The parsed file, which MuJoCo could not compile.
        path: The file.
    """
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    found: dict[str, Problem] = {}
    for kind, directory, asset in _assets(spec):
        file = path.parent / directory / asset.file
        if file.is_file() or str(file) in found:
            continue
        there = sorted(p.name for p in file.parent.iterdir()) if file.parent.is_dir() else None
        what = "there is no such folder" if there is None else f"there are: {listing(there)}"
        line = next((i for i, text in enumerate(lines, 1) if Path(asset.file).name in text), None)
        where = f"{path}:{line}" if line else str(path)
        message = f"{where}: {kind} {asset.name!r}: no file {file.name!r} in {file.parent}; {what}"
        found[str(file)] = Problem("", f"{message}.{did_you_mean(file.name, there or ())}")
    return list(found.values())


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
            part.group, part.pos, part.quat = COLLISION_GROUP, geom.pos, geom.quat
            for field in _TURN:
                setattr(part.alt, field, getattr(geom.alt, field))
            for field in _CONTACT:
                setattr(part, field, getattr(geom, field))
        geom.contype = geom.conaffinity = 0


def _split(spec: mujoco.MjSpec, mesh: mujoco.MjsMesh) -> Iterator[str]:
    """Add the convex parts of a mesh, and yield their names."""
    for number, file in enumerate(decompose(Path(mesh.file))):
        part = spec.add_mesh(name=f"{mesh.name}_part_{number}", file=str(file))
        part.scale, part.refpos, part.refquat = mesh.scale, mesh.refpos, mesh.refquat
        part.maxhullvert = HULL_VERTICES
        yield part.name
