"""`SceneTextures`: a model's textures as layers of one array, and which material has which."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

__all__ = ["SceneTextures"]

_PIXELS = 512
_MOST = 32  # entries of the table in the shader
_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)


class SceneTextures:
    """Textures of one size, squares of 512 pixels, in one array: a cube is six layers.

    Args:
        model: The compiled scene.
        unit: The texture unit that they are bound to.

    Attributes:
        sky: Entry of the skybox in the table, -1 without one.
    """

    def __init__(self, model: mujoco.MjModel, unit: int) -> None:
        kinds = [int(kind) for kind in model.tex_type]
        cube = [kind != int(mujoco.mjtTexture.mjTEXTURE_2D) for kind in kinds]
        first, layers = [], 0
        images: list[NDArray[np.uint8]] = []
        for texture, is_cube in enumerate(cube):
            first.append(layers)
            images += _faces(model, texture, is_cube)
            layers += 6 if is_cube else 1
        self._table = np.full((_MOST, 4), -1.0)
        self._repeats = np.zeros(_MOST, np.int32)
        for material in range(min(model.nmat, _MOST - 1)):
            texture = int(model.mat_texid[material][_RGB])
            if texture < 0:
                continue
            repeat = model.mat_texrepeat[material]
            self._table[material] = first[texture], cube[texture], *np.where(repeat > 0, repeat, 1)
            self._repeats[material] = int(model.mat_texuniform[material])
        skies = [i for i, k in enumerate(kinds) if k == int(mujoco.mjtTexture.mjTEXTURE_SKYBOX)]
        self.sky = -1
        if skies:
            self.sky = _MOST - 1
            self._table[self.sky] = first[skies[0]], 1, 1, 1
        _upload(images or [np.full((_PIXELS, _PIXELS, 3), 255, np.uint8)], unit)

    def uniforms(self) -> dict[str, Any]:
        """What shaders need to know."""
        return {"textureTable": self._table, "uniformRepeat": self._repeats}


def _faces(model: mujoco.MjModel, texture: int, is_cube: bool) -> list[NDArray[np.uint8]]:
    """Squares of RGB of a texture: one, or six of a cube."""
    height, width = int(model.tex_height[texture]), int(model.tex_width[texture])
    channels, start = int(model.tex_nchannel[texture]), int(model.tex_adr[texture])
    data = np.asarray(model.tex_data[start : start + height * width * channels], np.uint8)
    image = data.reshape(height, width, channels)[..., :3]
    if image.shape[2] == 1:
        image = np.repeat(image, 3, axis=2)
    if not is_cube:
        return [_resized(image)]
    if height == 6 * width:
        return [_resized(image[i * width : (i + 1) * width]) for i in range(6)]
    return [_resized(image)] * 6  # one picture for every face


def _resized(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    if image.shape[:2] == (_PIXELS, _PIXELS):
        return np.ascontiguousarray(image)
    from PIL import Image

    return np.asarray(Image.fromarray(np.ascontiguousarray(image)).resize((_PIXELS, _PIXELS)))


def _upload(images: list[NDArray[np.uint8]], unit: int) -> None:
    from OpenGL import GL

    texture = GL.glGenTextures(1)
    GL.glActiveTexture(GL.GL_TEXTURE0 + unit)
    GL.glBindTexture(GL.GL_TEXTURE_2D_ARRAY, texture)
    levels = _PIXELS.bit_length()
    size = _PIXELS, _PIXELS, len(images)
    GL.glTexStorage3D(GL.GL_TEXTURE_2D_ARRAY, levels, GL.GL_RGB8, *size)
    GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
    data = np.ascontiguousarray(np.stack(images))
    GL.glTexSubImage3D(
        GL.GL_TEXTURE_2D_ARRAY, 0, 0, 0, 0, *size, GL.GL_RGB, GL.GL_UNSIGNED_BYTE, data
    )
    GL.glGenerateMipmap(GL.GL_TEXTURE_2D_ARRAY)
    for name, value in (
        (GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR_MIPMAP_LINEAR),
        (GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR),
        (GL.GL_TEXTURE_WRAP_S, GL.GL_REPEAT),
        (GL.GL_TEXTURE_WRAP_T, GL.GL_REPEAT),
    ):
        GL.glTexParameteri(GL.GL_TEXTURE_2D_ARRAY, name, value)
