"""Reads mesh files into parts of one material each, with colours and textures.

pycollada reads COLLADA (units, up axis), trimesh the other formats.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from embodichain.utils.system.pictures import open_picture, refuse_postscript

if TYPE_CHECKING:
    from PIL.Image import Image

__all__ = ["MeshData", "MeshError", "MeshPart", "Rgba", "joined", "read_mesh"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
Rgba = tuple[float, float, float, float]
"""Red, green, blue, opacity, each in [0, 1]."""

_SUFFIXES = (".dae", ".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
_EMBEDDING = (".glb", ".gltf")
"""Formats with pictures inside, which trimesh opens without asking for a file."""
_MAX_PIXELS = 512
"""Longest side: models and logs contain uncompressed images."""
_MAX_COLORS = 16
"""Face colours that become parts; with more, there is one part in their mean colour."""
_TO_Z_UP: dict[str, F64] = {  # COLLADA 1.4.1, section "up_axis": which axes are right, up, inward
    "X_UP": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "Y_UP": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}


class MeshError(Exception):
    """A mesh file cannot be read; the message is one line that names the file."""


@dataclass
class MeshPart:
    """Triangles of one material. MuJoCo computes their normals and keeps sharp edges.

    Attributes:
        vertices: (V, 3) metres.
        faces: (F, 3) indices of vertices, counter-clockwise seen from outside.
        uv: (V, 2) texture coordinates, origin at the lower left, or None.
        rgba: The material's colour, or None if the file has none.
        texture: Its colour image, or None.
    """

    vertices: F32
    faces: I32
    uv: F32 | None = None
    rgba: Rgba | None = None
    texture: Image | None = None

    @classmethod
    def of_corners(
        cls,
        corners: NDArray[np.floating],
        uv: NDArray[np.floating] | None = None,
    ) -> MeshPart:
        """Make a part from triangle corners, with equal corners merged.

        Args:
            corners: (F, 3, 3) metres.
            uv: (F, 3, 2) or None.
        """
        columns = [c.reshape(-1, c.shape[-1]) for c in (corners, uv) if c is not None]
        rows, index = np.unique(
            np.concatenate(columns, axis=1, dtype=np.float32), axis=0, return_inverse=True
        )
        part = cls(rows[:, :3], index.reshape(-1, 3).astype(np.int32))
        if uv is not None:
            part.uv = rows[:, 3:]
        return part


@dataclass
class MeshData:
    """A mesh file.

    Attributes:
        parts: At least one, each with at least one triangle.
        notes: Data of the file that was lost, one line each, without the file's name.
    """

    parts: list[MeshPart]
    notes: list[str] = field(default_factory=list)


def joined(parts: list[MeshPart], textured: bool = False) -> MeshPart:
    """Return the triangles of all parts as one without a material.

    Args:
        parts: At least one.
        textured: Whether to keep texture coordinates; each part must then have them.
    """
    corners = np.concatenate([p.vertices[p.faces] for p in parts])
    uvs = [p.uv[p.faces] for p in parts if textured and p.uv is not None]
    return MeshPart.of_corners(corners, np.concatenate(uvs) if uvs else None)


def read_mesh(path: Path) -> MeshData:
    """Read a mesh file: metres, z up.

    Units and up axis of COLLADA are applied. Other formats have no units: metres are assumed. In
    glTF y is up, but coordinates are not rotated, as in EmbodiChain.

    Raises:
        MeshError: If the format is unknown, a library is missing, or the file is broken.
    """
    if path.suffix.lower() not in _SUFFIXES:
        message = f"{path}: format {path.suffix or 'none'} is not one of {', '.join(_SUFFIXES)}"
        raise MeshError(message)
    try:
        data = _read_collada(path) if path.suffix.lower() == ".dae" else _read_other(path)
    except ImportError as error:
        message = f"{path}: needs {error.name}: pip install trimesh pycollada"
        raise MeshError(message) from error
    for part in data.parts:
        if part.texture is not None and part.uv is None:
            data.notes.append("a texture without coordinates: drawn in its mean colour")
            part.rgba = _mean_color(part.texture)
            part.texture = None
    data.parts = list(_by_material(data.parts))
    return data


def _by_material(parts: list[MeshPart]) -> Iterator[MeshPart]:
    """Yield one part per material; texture coordinates without a texture are dropped."""
    groups: dict[tuple[Rgba | None, int], list[MeshPart]] = {}
    for part in parts:
        groups.setdefault((part.rgba, id(part.texture)), []).append(part)
    for group in groups.values():
        first = group[0]
        part = joined(group, textured=first.texture is not None)
        part.rgba = first.rgba
        part.texture = first.texture
        yield part


# ----------------------------------------------------------------------------------------- COLLADA


def _read_collada(path: Path) -> MeshData:
    """Read the visual scene of a COLLADA file.

    Raises:
        ImportError: If pycollada is missing.
        MeshError: If it is malformed or has no triangles.
    """
    from collada.common import DaeError

    try:
        source = path.read_bytes()
        document = _load(source)
        notes = []
        if document.errors:  # else shapes with broken materials would be left out
            reasons = "; ".join(str(error).partition(": ")[2] for error in document.errors)
            notes.append(f"broken references ({reasons}): what they colour is drawn grey")
            document = _load(_without_broken_materials(source, document))
    except (DaeError, ET.ParseError, ValueError, OSError) as error:
        raise MeshError(f"{path}: not readable as COLLADA: {error}") from error
    data = MeshData([], notes)
    turn = float(document.assetInfo.unitmeter or 1.0) * _to_z_up(document.assetInfo)
    looks: dict[str, _Look] = {}
    for bound in document.scene.objects("geometry") if document.scene else ():
        for primitive in bound.primitives():
            part = _part(primitive, turn)
            if part is None:
                continue
            material = primitive.material
            if material is not None:
                if material.id not in looks:
                    looks[material.id] = _read_look(path, material.effect, data.notes)
                part.rgba = looks[material.id].rgba
                part.texture = looks[material.id].texture
            data.parts.append(part)
    if not data.parts:
        raise MeshError(f"{path}: it contains no triangles")
    data.notes = list(dict.fromkeys(data.notes))
    return data


@dataclass(frozen=True)
class _Look:
    """Colour and texture of a material."""

    rgba: Rgba | None
    texture: Image | None


def _read_look(path: Path, effect: Any, notes: list[str]) -> _Look:
    """Read the look of a COLLADA material; one image, so that parts can share it."""
    image = _image(effect.diffuse) or _image(effect.emission)
    texture = _open_texture(path, image, notes) if image else None
    return _Look(_color(effect), texture)


def _load(source: bytes) -> Any:
    import collada

    return collada.Collada(BytesIO(source), ignore=[collada.common.DaeError])


def _without_broken_materials(source: bytes, document: Any) -> bytes:
    """Return the file without references to materials that could not be read."""
    readable = {f"#{material.id}" for material in document.materials}
    root = ET.fromstring(source)
    for parent in root.findall(".//{*}technique_common"):
        for use in parent.findall("{*}instance_material"):
            if use.get("target") not in readable:
                parent.remove(use)
    return ET.tostring(root)


def _to_z_up(info: Any) -> F64:
    """Return the rotation (3, 3) from a file's up axis to z, the up axis of URDF and MuJoCo.

    MeshLab writes ``Y_UP`` to every file without rotating vertices, so its value is ignored.
    """
    tools = [str(contributor.authoring_tool) for contributor in info.contributors]
    if any("MeshLab" in tool for tool in tools):
        return np.eye(3)
    return _TO_Z_UP.get(info.upaxis, np.eye(3))


def _part(primitive: Any, turn: F64) -> MeshPart | None:
    """Return a primitive's rotated triangles; None for lines and empty lists."""
    if hasattr(primitive, "triangleset"):  # a list of polygons
        primitive = primitive.triangleset()
    if type(primitive).__name__ != "BoundTriangleSet" or len(primitive) == 0:
        return None
    corners = primitive.vertex[primitive.vertex_index] @ turn.T
    uv = None
    if primitive.texcoordset:
        uv = primitive.texcoordset[0][primitive.texcoord_indexset[0]][..., :2]
    return MeshPart.of_corners(corners, uv)


def _image(value: Any) -> str | None:
    """The image file of a property, if that is a texture."""
    sampler = getattr(value, "sampler", None)
    return str(sampler.surface.image.path) if sampler is not None else None


def _color(effect: Any) -> Rgba | None:
    """Diffuse colour, or emission where that is black, and opacity.

    Opacity is that of COLLADA 1.4.1, section "Determining Transparency". An opacity of zero is read
    as one, because many exporters write ``transparency`` 0 for opaque materials.
    """
    # A texture in place of a colour is not a tuple.
    colors = [value for value in (effect.diffuse, effect.emission) if isinstance(value, tuple)]
    bright_colors = [color for color in colors if max(color[:3]) > 0]
    if bright_colors:
        color = bright_colors[0]
    elif isinstance(effect.diffuse, tuple):
        color = effect.diffuse
    else:
        return None
    red, green, blue = (min(max(float(c), 0.0), 1.0) for c in color[:3])
    return red, green, blue, _opacity(effect)


def _opacity(effect: Any) -> float:
    """Return the opacity of a material in (0, 1], see `_color`."""
    transparent = effect.transparent
    transparency = effect.transparency
    if not isinstance(transparent, tuple) or not isinstance(transparency, (int, float)):
        return 1.0
    if effect.opaque_mode == "RGB_ZERO":
        luminance = float(np.dot(transparent[:3], (0.212671, 0.715160, 0.072169)))
        opacity = 1.0 - luminance * transparency
    else:
        alpha = float(transparent[3]) if len(transparent) > 3 else 1.0
        opacity = alpha * transparency
    return opacity if 0.0 < opacity < 1.0 else 1.0


def _open_texture(mesh: Path, name: str, notes: list[str]) -> Image | None:
    """Return the RGB image that a mesh file refers to; None, with a note, if unreadable.

    The name is a path relative to the folder of the mesh, or a ``file://`` URI.
    """
    path = mesh.parent / unquote(name.removeprefix("file://")).replace("\\", "/")
    try:
        with open_picture(path) as image:
            return _as_rgb(image)
    except FileNotFoundError:
        notes.append(f"texture {name!r} is missing: drawn in the material's colour")
    except (OSError, ValueError) as error:
        notes.append(f"texture {name!r} cannot be read ({error}): drawn in the material's colour")
    return None


def _as_rgb(image: Image) -> Image:
    """Return an image as RGB, scaled down to at most `_MAX_PIXELS` per side."""
    rgb = image.convert("RGB")
    rgb.thumbnail((_MAX_PIXELS, _MAX_PIXELS))
    return rgb


def _mean_color(image: Image) -> Rgba:
    """Return the mean colour of an RGB image, opaque."""
    red, green, blue = (np.asarray(image, np.float64).reshape(-1, 3).mean(axis=0) / 255.0).tolist()
    return red, green, blue, 1.0


# ----------------------------------------------------------------------------------- other formats


def _resolver(mesh: Path, notes: list[str]) -> Any:
    """What trimesh reads the other files of a mesh with: as it does itself, but no PostScript."""
    from trimesh.resolvers import FilePathResolver

    class Resolver(FilePathResolver):
        def get(self, name: str) -> Any:
            data = super().get(name)
            try:
                refuse_postscript(data)
            except OSError as error:  # trimesh goes on without the texture, and says nothing
                notes.append(f"texture {name!r} cannot be read ({error})")
                raise
            return data

    return Resolver(str(mesh))


def _read_other(path: Path) -> MeshData:
    import trimesh

    data = MeshData([])
    try:
        if path.suffix.lower() in _EMBEDDING:
            refuse_postscript(path.read_bytes())
        scene = trimesh.load_scene(path, resolver=_resolver(path, data.notes), process=False)
        meshes = [m for m in scene.dump() if isinstance(m, trimesh.Trimesh) and len(m.faces)]
    except (ValueError, KeyError, IndexError, TypeError, OSError, AttributeError) as error:
        # trimesh may raise any exception for a broken file
        raise MeshError(f"{path}: cannot be read: {error}") from error
    for mesh in meshes:
        data.parts += _parts(mesh, data.notes)
    if not data.parts:
        raise MeshError(f"{path}: it contains no triangles")
    return data


def _parts(mesh: Any, notes: list[str]) -> list[MeshPart]:
    visual = mesh.visual
    kind = visual.kind
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
    part.texture = _as_rgb(image) if image is not None else None
    return [part]


def _rgba(material: Any) -> Rgba | None:
    """The base colour of a trimesh material of either kind; by default white, as in glTF."""
    color = getattr(material, "baseColorFactor", None)
    if color is None:
        color = getattr(material, "diffuse", None)
    if color is None:
        return 1.0, 1.0, 1.0, 1.0
    values = [float(c) / 255.0 for c in np.asarray(color).ravel()]
    red, green, blue, alpha = (*values, 1.0)[:4]
    return red, green, blue, alpha


def _by_color(corners: Any, colors: Any, notes: list[str]) -> list[MeshPart]:
    """Split triangles by colour: MuJoCo has no vertex colours."""
    unique_colors, color_of_face = np.unique(colors, axis=0, return_inverse=True)
    if len(unique_colors) > _MAX_COLORS:
        message = f"{len(unique_colors)} colours of faces or vertices: drawn in their mean colour"
        notes.append(message)
        unique_colors = colors.mean(axis=0, keepdims=True)
        color_of_face = np.zeros(len(colors), np.int64)
    parts = []
    for number, color in enumerate(unique_colors):
        part = MeshPart.of_corners(corners[color_of_face.ravel() == number])
        red, green, blue, alpha = (float(c) / 255.0 for c in color)
        part.rgba = (red, green, blue, alpha)
        parts.append(part)
    return parts
