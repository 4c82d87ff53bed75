"""Colour images of meshes: found, read, and made small enough for a model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

import numpy as np

if TYPE_CHECKING:
    from PIL.Image import Image

    from embodichain.lab.sim.meshes.part import Rgba

__all__ = ["MAX_PIXELS", "as_rgb", "mean_color", "open_texture"]

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
