"""What a mesh file is read into: parts of one material each, and their colour images."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from PIL.Image import Image

__all__ = [
    "MAX_PIXELS",
    "MeshData",
    "MeshError",
    "MeshPart",
    "Rgba",
    "as_rgb",
    "joined",
    "mean_color",
    "open_texture",
]

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
Rgba = tuple[float, float, float, float]
"""Red, green, blue, opacity, each in [0, 1]."""


class MeshError(Exception):
    """A mesh file cannot be read; the message is one line that names the file."""


@dataclass
class MeshPart:
    """Triangles of one material. MuJoCo makes their normals, with sharp edges kept.

    Attributes:
        vertices: (V, 3) metres.
        faces: (F, 3) indices of vertices, counter-clockwise seen from outside.
        uv: (V, 2) texture coordinates, origin at the lower left, or None.
        rgba: The material's colour, or None where the file has none.
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
        """Make a part of triangle corners, with equal ones merged.

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
        notes: What of the file was lost, one line each, without the file's name.
    """

    parts: list[MeshPart]
    notes: list[str] = field(default_factory=list)


def joined(parts: list[MeshPart], textured: bool = False) -> MeshPart:
    """Return the triangles of all parts as one without a material.

    Args:
        parts: At least one.
        textured: Keep texture coordinates, which each part then has.
    """
    corners = np.concatenate([p.vertices[p.faces] for p in parts])
    uvs = [p.uv[p.faces] for p in parts if textured and p.uv is not None]
    return MeshPart.of_corners(corners, np.concatenate(uvs) if uvs else None)


MAX_PIXELS = 512
"""Longest side: an image is kept uncompressed in the model, and in every log of it."""


def open_texture(mesh: Path, name: str, notes: list[str]) -> Image | None:
    """Return the image that a mesh file names, RGB; None, with a note, if it cannot be had.

    Args:
        mesh: The mesh file; names are relative to its folder.
        name: What it says: a file name or a ``file://`` URI.
        notes: What could not be done is added here.
    """
    from PIL import Image, UnidentifiedImageError

    path = mesh.parent / unquote(name.removeprefix("file://")).replace("\\", "/")
    try:
        with Image.open(path) as image:
            return as_rgb(image)
    except FileNotFoundError:
        notes.append(f"texture {name!r} is missing: drawn in the material's colour")
    except (UnidentifiedImageError, OSError, ValueError) as error:
        notes.append(f"texture {name!r} cannot be read ({error}): drawn in the material's colour")
    return None


def as_rgb(image: Image) -> Image:
    """Return an image as RGB, scaled down to at most `MAX_PIXELS` a side."""
    rgb = image.convert("RGB")
    rgb.thumbnail((MAX_PIXELS, MAX_PIXELS))
    return rgb


def mean_color(image: Image) -> Rgba:
    """Return the mean colour of an RGB image, opaque."""
    red, green, blue = (np.asarray(image, np.float64).reshape(-1, 3).mean(axis=0) / 255.0).tolist()
    return red, green, blue, 1.0
