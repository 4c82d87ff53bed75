"""Converts mesh files to OBJ and PNG files that MuJoCo reads, cached by content.

CoACD splits concave meshes into convex parts (Wei et al., SIGGRAPH 2022).
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from importlib import metadata
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from embodichain.lab.sim.compiler.geoms.mesh_reading import (
    MeshError,
    MeshPart,
    Rgba,
    joined,
    read_mesh,
)
from embodichain.utils.system.atomic import remove_abandoned, temporary_name

__all__ = [
    "MAX_STL_FACES",
    "MadePart",
    "MadeVisual",
    "cache_folder",
    "convert_collision",
    "convert_visual",
    "digest",
    "entry",
    "has_materials",
    "reads",
    "referenced",
    "split_pieces",
    "write_obj",
]

_MANIFEST = "manifest.json"


def cache_folder() -> Path:
    """Return the folder of converted meshes; it need not exist.

    It is ``meshes`` in ``$EMBODICHAIN_CACHE``, else in ``$XDG_CACHE_HOME/embodichain``, else in
    ``~/.cache/embodichain``.
    """
    configured = os.environ.get("EMBODICHAIN_CACHE")
    if configured:
        return Path(configured).expanduser() / "meshes"
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base, "embodichain").expanduser() / "meshes"


def digest(recipe: str, files: list[Path]) -> str:
    """Return the name of a cache entry: 32 hexadecimal digits of a SHA-256.

    Args:
        recipe: Kind and version of the conversion.
        files: The source files, the main file first. Missing ones count as missing.
    """
    total = sha256(recipe.encode())
    for path in files:
        try:
            total.update(sha256(path.read_bytes()).digest())
        except OSError:
            total.update(b"missing")
    return total.hexdigest()[:32]


def entry(name: str, make: Callable[[Path], dict[str, Any]]) -> tuple[Path, dict[str, Any]]:
    """Return an entry's folder and manifest; it is created if it does not exist.

    Args:
        name: From `digest`.
        make: Writes the entry's files to an empty folder and returns its manifest, as JSON values.
            If it raises, no entry remains.

    Raises:
        OSError: If the cache cannot be written.
    """
    folder = cache_folder() / name
    try:
        return folder, json.loads((folder / _MANIFEST).read_bytes())
    except FileNotFoundError:
        pass  # it is made below
    folder.parent.mkdir(parents=True, exist_ok=True)
    remove_abandoned(folder.parent)
    stage = folder.with_name(temporary_name(name))
    stage.mkdir()
    try:
        manifest = make(stage)
        (stage / _MANIFEST).write_text(json.dumps(manifest), encoding="utf-8")
        try:
            stage.rename(folder)
        except OSError:
            if not (folder / _MANIFEST).is_file():
                raise
            # Another process has created the same entry.
    finally:
        shutil.rmtree(stage, ignore_errors=True)
    return folder, manifest


NATIVE = (".obj", ".stl", ".msh")
"""Suffixes that MuJoCo reads."""

MAX_STL_FACES = 200_000
"""MuJoCo's limit on faces of an STL file."""

_VERSION = 2  # increased with every change of the output
_PARTS_VERSION = 1  # likewise, for convex parts
_PIECES_VERSION = 1  # likewise, for pieces
_HULL_VERTICES = 64  # per part, as the compiler keeps of a hull
_NO_LIMIT = -1  # CoACD's word for as many parts as needed
_STL_HEADER_BYTES = 84
_STL_FACE_BYTES = 50


@dataclass(frozen=True)
class MadePart:
    """One part of a visual mesh.

    Attributes:
        mesh: OBJ file.
        rgba: Its colour; None if the file has none.
        texture: PNG file, or None. MuJoCo multiplies it by the colour.
    """

    mesh: Path
    rgba: Rgba | None
    texture: Path | None


@dataclass(frozen=True)
class MadeVisual:
    """A visual mesh: its parts, and notes about lost data, one line each with the file's name."""

    parts: tuple[MadePart, ...]
    notes: tuple[str, ...]


def reads(path: Path) -> bool:
    """Whether MuJoCo reads a mesh file as it is (not, for example, ASCII or very large STL)."""
    suffix = path.suffix.lower()
    if suffix != ".stl":
        return suffix in NATIVE
    with path.open("rb") as file:
        header = file.read(_STL_HEADER_BYTES)
    faces = int.from_bytes(header[80:84], "little")
    if len(header) < _STL_HEADER_BYTES or not 0 < faces <= MAX_STL_FACES:
        return False
    return path.stat().st_size >= _STL_HEADER_BYTES + _STL_FACE_BYTES * faces


def has_materials(path: Path) -> bool:
    """Whether it is an OBJ file with a material file, which MuJoCo ignores."""
    return path.suffix.lower() == ".obj" and bool(_libraries(path))


def convert_visual(path: Path) -> MadeVisual:
    """Convert a mesh file to one OBJ file per material, with textures as PNG.

    Raises:
        MeshError: If it cannot be read, or a library that reads it is missing.
        OSError: If the cache cannot be written.
    """
    name = digest(f"visual {_VERSION} {path.name}", [path, *referenced(path)])
    stem = f"{path.stem}-{name[:8]}"  # MuJoCo names meshes by file: one name, one content

    def make(folder: Path) -> dict[str, Any]:
        data = read_mesh(path)
        parts = [_save(part, folder, f"{stem}-{n}") for n, part in enumerate(data.parts)]
        return {"parts": parts, "notes": data.notes}

    folder, manifest = entry(name, make)
    parts = tuple(
        MadePart(
            mesh=folder / part["mesh"],
            rgba=tuple(part["rgba"]) if part["rgba"] else None,
            texture=folder / part["texture"] if part["texture"] else None,
        )
        for part in manifest["parts"]
    )
    notes = tuple(f"{path}: {note}" for note in manifest["notes"])
    return MadeVisual(parts, notes)


def convert_collision(path: Path) -> Path:
    """Convert a mesh file to one OBJ file of all its triangles; their hull collides.

    Raises:
        MeshError: If it cannot be read, or a library that reads it is missing.
        OSError: If the cache cannot be written.
    """
    name = digest(f"collision {_VERSION} {path.name}", [path, *referenced(path)])
    file = f"{path.stem}-{name[:8]}.obj"

    def make(folder: Path) -> dict[str, Any]:
        write_obj(joined(read_mesh(path).parts), folder / file)
        return {}

    return entry(name, make)[0] / file


def decompose(path: Path, max_parts: int | None = None) -> tuple[Path, ...]:
    """Split a mesh into convex parts, as OBJ files; deterministic (seed 0).

    Takes seconds to minutes the first time.

    Args:
        path: The mesh file.
        max_parts: Maximum number; None is as many as CoACD's default concavity of 0.05 needs.

    Raises:
        MeshError: If it cannot be read, or CoACD is missing or fails.
        OSError: If the cache cannot be written.
    """
    try:
        version = metadata.version("coacd")
    except metadata.PackageNotFoundError as error:
        message = "splitting into convex parts needs coacd: pip install 'embodichain[decompose]'"
        raise MeshError(f"{path}: {message}") from error
    limit = _NO_LIMIT if max_parts is None else max_parts
    recipe = f"parts {_PARTS_VERSION} coacd {version} {limit} {path.name}"
    name = digest(recipe, [path, *referenced(path)])

    def make(folder: Path) -> dict[str, Any]:
        files: list[str] = []
        for number, part in enumerate(_split(path, limit)):
            file = f"{path.stem}-{name[:8]}-{number}.obj"
            write_obj(part, folder / file)
            files.append(file)
        return {"files": files}

    folder, manifest = entry(name, make)
    return tuple(folder / file for file in manifest["files"])


def split_pieces(path: Path) -> tuple[Path, ...]:
    """Split a mesh into its pieces, as OBJ files: the sets of triangles that share corners.

    Raises:
        MeshError: If it cannot be read.
        OSError: If the cache cannot be written.
    """
    name = digest(f"pieces {_PIECES_VERSION} {path.name}", [path, *referenced(path)])

    def make(folder: Path) -> dict[str, Any]:
        files: list[str] = []
        for number, piece in enumerate(_pieces(joined(read_mesh(path).parts))):
            file = f"{path.stem}-{name[:8]}-{number}.obj"
            write_obj(piece, folder / file)
            files.append(file)
        return {"files": files}

    folder, manifest = entry(name, make)
    return tuple(folder / file for file in manifest["files"])


def _pieces(mesh: MeshPart) -> list[MeshPart]:
    """Return the pieces of a mesh whose equal corners are merged."""
    from scipy.sparse import coo_array  # few scenes have such meshes
    from scipy.sparse.csgraph import connected_components

    count = len(mesh.vertices)
    first = mesh.faces[:, [0, 1]].ravel()
    second = mesh.faces[:, [1, 2]].ravel()
    edges = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    number, piece_of_vertex = connected_components(edges, directed=False)
    pieces: list[MeshPart] = []
    for piece in range(number):
        is_in_piece = piece_of_vertex[mesh.faces[:, 0]] == piece
        pieces.append(MeshPart.of_corners(mesh.vertices[mesh.faces[is_in_piece]]))
    return pieces


def _split(path: Path, max_parts: int) -> list[MeshPart]:
    """Return the convex parts of a mesh.

    Raises:
        MeshError: If it cannot be read, or CoACD fails.
    """
    import ruckig  # noqa: F401  (experts use it; loaded after coacd, it crashes the process)

    import coacd  # isort: skip

    coacd.set_log_level("error")
    whole = joined(read_mesh(path).parts)
    mesh = coacd.Mesh(whole.vertices.astype(np.float64), whole.faces)
    try:
        parts = coacd.run_coacd(
            mesh,
            max_convex_hull=max_parts,
            decimate=True,
            max_ch_vertex=_HULL_VERTICES,
            seed=0,
        )
    except (RuntimeError, ValueError) as error:
        raise MeshError(f"{path}: CoACD cannot split it: {error}") from error
    if not parts:
        raise MeshError(f"{path}: CoACD cannot split it: it returned no parts")
    return [MeshPart(v.astype(np.float32), f.astype(np.int32)) for v, f in parts]


def write_obj(part: MeshPart, path: Path) -> None:
    """Write triangles, with texture coordinates if there are any."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in part.vertices.tolist()]
    faces = (part.faces + 1).tolist()
    if part.uv is None:
        lines += [f"f {a} {b} {c}" for a, b, c in faces]
    else:
        lines += [f"vt {u:.6g} {v:.6g}" for u, v in part.uv.tolist()]
        lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def _save(part: MeshPart, folder: Path, stem: str) -> dict[str, Any]:
    """Write a part and its texture; return its entry in the manifest."""
    write_obj(part, folder / f"{stem}.obj")
    texture = None
    if part.texture is not None:
        pixels = part.texture.tobytes() + str(part.texture.size).encode()
        texture = f"{sha256(pixels).hexdigest()[:12]}.png"  # parts may share it
        if not (folder / texture).exists():
            part.texture.save(folder / texture)
    return {"mesh": f"{stem}.obj", "rgba": part.rgba, "texture": texture}


def referenced(path: Path) -> list[Path]:
    """Return the files that a mesh file refers to, on which its conversion depends."""
    suffix = path.suffix.lower()
    if suffix == ".obj":
        libraries = _libraries(path)
        files = list(libraries)
        for library in libraries:
            files += _find_files(library, rb"(?m)^\s*map_\w+\s(.*)$")
        return files
    if suffix == ".dae":
        return _find_files(path, rb"<init_from>([^<]*)</init_from>")
    if suffix == ".gltf":
        return _find_files(path, rb'"uri"\s*:\s*"([^"]{1,512})"')
    return []


def _libraries(path: Path) -> list[Path]:
    """Return the material files of an OBJ file that exist."""
    files = _find_files(path, rb"(?m)^mtllib\s+(.*)$")
    return [file for file in files if file.is_file()]


def _find_files(path: Path, pattern: bytes) -> list[Path]:
    """Return the files that a file refers to, each the group of a match of the pattern."""
    files: list[Path] = []
    for match in re.findall(pattern, path.read_bytes()):
        text = match.decode("utf-8", "replace").strip()
        if text:
            name = unquote(text.removeprefix("file://")).split(" ")[-1]  # options are before it
            files.append(path.parent / name)
    return files
