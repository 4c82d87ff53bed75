"""`SceneTextures`: a model's textures, in one array of squares and one of cubes."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.layered.shaders import UNITS

__all__ = ["SceneTextures"]

_MOST_PIXELS = 1024
_2D = int(mujoco.mjtTexture.mjTEXTURE_2D)
_SKYBOX = int(mujoco.mjtTexture.mjTEXTURE_SKYBOX)


class SceneTextures:
    """Textures as layers, resized to the largest of their kind, at most 1024 pixels a side.

    Args:
        model: The compiled scene.

    Attributes:
        layers: (ntex, 2) of each texture, its layer among the squares and among the cubes; -1 in
            the one where it is not.
        sky: The cube of the first skybox, -1 without one.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.layers = np.full((model.ntex, 2), -1, np.int64)
        squares: list[NDArray[np.uint8]] = []
        cubes: list[NDArray[np.uint8]] = []
        self.sky = -1
        for texture, kind in enumerate(model.tex_type):
            if kind == _2D:
                self.layers[texture, 0] = len(squares)
                squares.append(_image(model, texture))
                continue
            self.layers[texture, 1] = len(cubes) // 6
            if kind == _SKYBOX and self.sky < 0:
                self.sky = len(cubes) // 6
            cubes += _faces(_image(model, texture))
        self._textures = [
            _upload(squares, "GL_TEXTURE_2D_ARRAY", UNITS["textures"], empty=1),
            _upload(cubes, "GL_TEXTURE_CUBE_MAP_ARRAY", UNITS["cubes"], empty=6),
        ]

    def close(self) -> None:
        """Free them."""
        from OpenGL import GL

        GL.glDeleteTextures(len(self._textures), self._textures)


def _image(model: mujoco.MjModel, texture: int) -> NDArray[np.uint8]:
    """(H, W, 4) RGBA."""
    height = int(model.tex_height[texture])
    width = int(model.tex_width[texture])
    channels = int(model.tex_nchannel[texture])
    start = int(model.tex_adr[texture])
    data = np.asarray(model.tex_data[start : start + height * width * channels], np.uint8)
    data = data.reshape(height, width, channels)
    is_grey = channels < 3
    image = np.full((height, width, 4), 255, np.uint8)
    image[..., :3] = data[..., :1] if is_grey else data[..., :3]
    return image


def _faces(image: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """Six faces: right, left, up, down, front, back, as OpenGL's."""
    height, width = image.shape[:2]
    if height == 6 * width:
        return list(image.reshape(6, width, width, 4))
    return [image] * 6  # one picture for every face


def _upload(images: list[NDArray[np.uint8]], kind_name: str, unit: int, empty: int) -> Any:
    from OpenGL import GL

    longest = max((max(image.shape[:2]) for image in images), default=1)
    side = min(_MOST_PIXELS, 1 << (longest - 1).bit_length())
    data = np.full((empty, side, side, 4), 255, np.uint8)
    if images:
        data = np.stack([_resized(image, side) for image in images])
    kind = getattr(GL, kind_name)
    texture = GL.glGenTextures(1)
    GL.glActiveTexture(GL.GL_TEXTURE0 + unit)
    GL.glBindTexture(kind, texture)
    GL.glTexStorage3D(kind, side.bit_length(), GL.GL_RGBA8, side, side, len(data))
    GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
    GL.glTexSubImage3D(
        kind,
        0,  # level of detail
        0,  # x, y and layer at which the images begin
        0,
        0,
        side,
        side,
        len(data),
        GL.GL_RGBA,
        GL.GL_UNSIGNED_BYTE,
        data,
    )
    GL.glGenerateMipmap(kind)
    wrap = GL.GL_REPEAT if kind == GL.GL_TEXTURE_2D_ARRAY else GL.GL_CLAMP_TO_EDGE
    for name, value in (
        (GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR_MIPMAP_NEAREST),
        (GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR),
        (GL.GL_TEXTURE_WRAP_S, wrap),
        (GL.GL_TEXTURE_WRAP_T, wrap),
    ):
        GL.glTexParameteri(kind, name, value)
    return texture


def _resized(image: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    if image.shape[:2] == (side, side):
        return image
    from PIL import Image

    return np.asarray(Image.fromarray(np.ascontiguousarray(image)).resize((side, side)))
