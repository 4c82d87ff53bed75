"""Concave meshes as convex parts, through CoACD (Wei et al., SIGGRAPH 2022), cached by content."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from embodichain.lab.sim.meshes.mesh_conversion import digest, entry, referenced, write_obj
from embodichain.lab.sim.meshes.mesh_part import MeshError, MeshPart, joined
from embodichain.lab.sim.meshes.mesh_reading import read_mesh

__all__ = ["decompose"]

_VERSION = 1  # of what is written: raised with every change of it
_HULL_VERTICES = 64  # of a part: what the compiler keeps of a hull


def decompose(path: Path, max_parts: int | None = None) -> tuple[Path, ...]:
    """Split a mesh into convex parts, as OBJ files; the same parts every time (seed 0).

    Takes seconds to minutes the first time.

    Args:
        path: The mesh file.
        max_parts: Most parts; None: as many as CoACD's default concavity of 0.05 takes.

    Raises:
        MeshError: If it cannot be read, or CoACD is missing or fails.
        OSError: If the cache cannot be written.
    """
    try:
        version = metadata.version("coacd")
    except metadata.PackageNotFoundError as error:
        message = "splitting into convex parts needs coacd: pip install 'embodichain[decompose]'"
        raise MeshError(f"{path}: {message}") from error
    most = -1 if max_parts is None else max_parts
    recipe = f"parts {_VERSION} coacd {version} {most} {path.name}"
    name = digest(recipe, [path, *referenced(path)])

    def make(folder: Path) -> dict[str, Any]:
        files = []
        for number, part in enumerate(_split(path, most)):
            files.append(f"{path.stem}-{name[:8]}-{number}.obj")
            write_obj(part, folder / files[-1])
        return {"files": files}

    folder, manifest = entry(name, make)
    return tuple(folder / file for file in manifest["files"])


def _split(path: Path, most: int) -> list[MeshPart]:
    import coacd

    coacd.set_log_level("error")
    whole = joined(read_mesh(path).parts)
    mesh = coacd.Mesh(whole.vertices.astype(np.float64), whole.faces)
    try:
        parts = coacd.run_coacd(
            mesh,
            max_convex_hull=most,
            decimate=True,
            max_ch_vertex=_HULL_VERTICES,
            seed=0,
        )
    except (RuntimeError, ValueError) as error:
        raise MeshError(f"{path}: CoACD cannot split it: {error}") from error
    if not parts:
        raise MeshError(f"{path}: CoACD cannot split it: it returned no parts")
    return [MeshPart(v.astype(np.float32), f.astype(np.int32)) for v, f in parts]
