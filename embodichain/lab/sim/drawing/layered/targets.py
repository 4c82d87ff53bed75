"""`PictureTarget`: what pictures of one size are drawn into; `ShadowMaps`: what lights see."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.layered.shaders import UNITS
from embodichain.utils.errors import RenderError

__all__ = ["OUTPUT_BYTES", "PictureTarget", "ShadowMaps", "picture_bytes"]

_FORMATS = {
    "color": ("GL_RGBA8", "GL_RGBA", "GL_UNSIGNED_BYTE", np.uint8),
    "depth": ("GL_R32F", "GL_RED", "GL_FLOAT", np.float32),
    "mask": ("GL_R32I", "GL_RED_INTEGER", "GL_INT", np.int32),
}
_PLACES = {name: place for place, name in enumerate(_FORMATS)}
OUTPUT_BYTES = 4
"""Bytes of a pixel of any output."""
_SAMPLE_BYTES = 8 + 4 + 4  # surface, its distance, overlay
_SPARE_UNIT = 15
"""For textures that no program reads."""


class PictureTarget:
    """Pictures of one size, one a layer: their surfaces, the transparent overlay, and the outputs.

    Args:
        width: Pixels.
        height: Pixels.
        layers: How many pictures.
        outputs: Of ``color``, ``depth``, ``mask``.
        samples: Of a pixel, along each side: 1 or 2.

    Raises:
        RenderError: If OpenGL has no memory for it.
    """

    def __init__(
        self, width: int, height: int, layers: int, outputs: Sequence[str], samples: int
    ) -> None:
        self.size = (width, height)
        self.outputs = tuple(outputs)
        self.layers = layers
        self.bytes = layers * picture_bytes(width, height, samples)
        self._frames: list[Any] = []
        self._textures: list[Any] = []

        # The first stage draws surfaces, with all samples of a pixel.
        self._sampled = samples * width, samples * height
        self._depths = self._texture("GL_DEPTH_COMPONENT32F", self._sampled)
        self._surface = self._texture("GL_RG32UI", self._sampled)
        self._surfaces = self._frame({0: self._surface}, self._depths)
        # Few scenes have transparent geoms: the overlay is made with the first of them.
        self._overlay: Any = None
        self._overlay_frame: Any = None

        # The second shades pixels.
        self._read = {name: self._texture(_FORMATS[name][0], self.size) for name in self.outputs}
        places = {_PLACES[name]: texture for name, texture in self._read.items()}
        self._needs = self._texture("GL_DEPTH_COMPONENT32F", self.size)
        self._pictures = self._frame(places, self._needs)
        self._colours: Any = None
        if "color" in self.outputs:
            self._colours = self._frame({0: self._read["color"]}, self._needs)

    def _texture(self, kind: str, size: tuple[int, int]) -> Any:
        from OpenGL import GL

        texture = GL.glGenTextures(1)
        self._textures.append(texture)
        _bind(_SPARE_UNIT, texture)
        GL.glTexStorage3D(GL.GL_TEXTURE_2D_ARRAY, 1, getattr(GL, kind), *size, self.layers)
        for name in (GL.GL_TEXTURE_MIN_FILTER, GL.GL_TEXTURE_MAG_FILTER):
            GL.glTexParameteri(GL.GL_TEXTURE_2D_ARRAY, name, GL.GL_NEAREST)
        return texture

    def _frame(self, colours: dict[int, Any], depths: Any = None) -> Any:
        from OpenGL import GL

        frame = GL.glGenFramebuffers(1)
        self._frames.append(frame)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, frame)
        attached = [GL.GL_NONE] * 3
        for place, texture in colours.items():
            attached[place] = GL.GL_COLOR_ATTACHMENT0 + place
            GL.glFramebufferTexture(GL.GL_FRAMEBUFFER, attached[place], texture, 0)
        if depths is not None:
            GL.glFramebufferTexture(GL.GL_FRAMEBUFFER, GL.GL_DEPTH_ATTACHMENT, depths, 0)
        GL.glDrawBuffers(3, attached)
        status = GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER)
        if status != GL.GL_FRAMEBUFFER_COMPLETE:
            width, height = self.size
            message = f"OpenGL has no room for {self.layers} pictures of {width} x {height}"
            raise RenderError(f"{message} (status {status:#x})")
        return frame

    def begin_surfaces(self) -> None:
        """Draw surfaces from now on; they are cleared."""
        from OpenGL import GL

        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._surfaces)
        GL.glViewport(0, 0, *self._sampled)
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glDepthFunc(GL.GL_GREATER)
        GL.glDepthMask(True)
        GL.glDisable(GL.GL_BLEND)
        GL.glEnable(GL.GL_CULL_FACE)
        GL.glFrontFace(GL.GL_CW)  # pictures are drawn upside down: their first row is the top
        GL.glClearBufferfv(GL.GL_DEPTH, 0, np.zeros(1, np.float32))
        GL.glClearBufferuiv(GL.GL_COLOR, 0, np.array([0, 0xFFFF, 0, 0], np.uint32))

    def begin_overlay(self) -> None:
        """Draw transparent surfaces from now on, those behind first; they are cleared."""
        from OpenGL import GL

        if self._overlay is None:
            self._overlay = self._texture("GL_RGBA8", self._sampled)
            self._overlay_frame = self._frame({0: self._overlay}, self._depths)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._overlay_frame)
        GL.glClearBufferfv(GL.GL_COLOR, 0, np.zeros(4, np.float32))
        GL.glDepthMask(False)
        GL.glEnable(GL.GL_BLEND)
        GL.glBlendFunc(GL.GL_ONE, GL.GL_ONE_MINUS_SRC_ALPHA)

    def begin_pictures(self) -> None:
        """Draw all outputs from now on, and depths that say what pixels need in addition."""
        from OpenGL import GL

        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._pictures)
        GL.glViewport(0, 0, *self.size)
        GL.glDepthMask(True)
        GL.glDepthFunc(GL.GL_ALWAYS)
        GL.glDisable(GL.GL_CULL_FACE)
        GL.glDisable(GL.GL_BLEND)
        _bind(UNITS["surfaces"], self._surface)
        _bind(UNITS["distances"], self._depths)

    def add(self) -> None:
        """Add colours from now on, to pixels that need them."""
        self._add("GL_ONE", "GL_ONE")

    def add_behind(self) -> None:
        """Draw colours from now on behind those that are there, where alpha is below 1."""
        self._add("GL_ONE_MINUS_DST_ALPHA", "GL_ONE")

    def add_over(self) -> None:
        """Lay transparent surfaces over all pixels from now on."""
        from OpenGL import GL

        self._add("GL_ONE", "GL_ONE_MINUS_SRC_ALPHA")
        GL.glDepthFunc(GL.GL_ALWAYS)
        _bind(UNITS["overlay"], self._overlay)

    def _add(self, source: str, destination: str) -> None:
        from OpenGL import GL

        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._colours)
        GL.glDepthFunc(GL.GL_LESS)
        GL.glDepthMask(False)
        GL.glEnable(GL.GL_BLEND)
        GL.glBlendFunc(getattr(GL, source), getattr(GL, destination))

    def read(self, name: str) -> NDArray[Any]:
        """Read an output: (layers, height, width, ...)."""
        from OpenGL import GL

        _, layout, kind, dtype = _FORMATS[name]
        width, height = self.size
        shape: tuple[int, ...] = (self.layers, height, width)
        if name == "color":
            shape = (*shape, 4)
        into: NDArray[Any] = np.empty(shape, dtype)
        _bind(_SPARE_UNIT, self._read[name])
        GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
        GL.glGetTexImage(GL.GL_TEXTURE_2D_ARRAY, 0, getattr(GL, layout), getattr(GL, kind), into)
        return into

    def close(self) -> None:
        """Free its memory."""
        from OpenGL import GL

        GL.glDeleteFramebuffers(len(self._frames), self._frames)
        GL.glDeleteTextures(len(self._textures), self._textures)


def picture_bytes(width: int, height: int, samples: int) -> int:
    """Bytes of one picture in a target, and of its outputs when they are read."""
    return width * height * (_SAMPLE_BYTES * samples**2 + 2 * OUTPUT_BYTES * len(_FORMATS))


def _bind(unit: int, texture: Any) -> None:
    from OpenGL import GL

    GL.glActiveTexture(GL.GL_TEXTURE0 + unit)
    GL.glBindTexture(GL.GL_TEXTURE_2D_ARRAY, texture)


class ShadowMaps:
    """Distances that lights see, one square a layer.

    Args:
        pixels: Of a side.
        layers: How many.
    """

    def __init__(self, pixels: int, layers: int) -> None:
        from OpenGL import GL

        self.pixels = pixels
        self.layers = layers
        self._texture = GL.glGenTextures(1)
        self._frame = GL.glGenFramebuffers(1)
        _bind(UNITS["shadowMaps"], self._texture)
        kind = GL.GL_TEXTURE_2D_ARRAY
        GL.glTexStorage3D(kind, 1, GL.GL_DEPTH_COMPONENT32F, pixels, pixels, layers)
        for name, value in (
            (GL.GL_TEXTURE_COMPARE_MODE, GL.GL_COMPARE_REF_TO_TEXTURE),
            (GL.GL_TEXTURE_COMPARE_FUNC, GL.GL_LEQUAL),
            (GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR),
            (GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR),
            (GL.GL_TEXTURE_WRAP_S, GL.GL_CLAMP_TO_EDGE),
            (GL.GL_TEXTURE_WRAP_T, GL.GL_CLAMP_TO_EDGE),
        ):
            GL.glTexParameteri(kind, name, value)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._frame)
        GL.glFramebufferTexture(GL.GL_FRAMEBUFFER, GL.GL_DEPTH_ATTACHMENT, self._texture, 0)
        GL.glDrawBuffer(GL.GL_NONE)

    def begin(self) -> None:
        """Draw the far sides of solids from now on; it is cleared.

        Near sides would shadow themselves: they are simplified, and a map's distances are coarse.
        """
        from OpenGL import GL

        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._frame)
        GL.glViewport(0, 0, self.pixels, self.pixels)
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glDepthFunc(GL.GL_LESS)
        GL.glDepthMask(True)
        GL.glEnable(GL.GL_CULL_FACE)
        GL.glFrontFace(GL.GL_CW)  # front and back change places
        # Thin parts: as far behind as a surface falls away over the texels that are compared.
        GL.glEnable(GL.GL_POLYGON_OFFSET_FILL)
        GL.glPolygonOffset(3.0, 4.0)
        GL.glClearBufferfv(GL.GL_DEPTH, 0, np.ones(1, np.float32))

    def end(self) -> None:
        """Draw without an offset again."""
        from OpenGL import GL

        GL.glDisable(GL.GL_POLYGON_OFFSET_FILL)

    def open_surfaces(self) -> None:
        """Draw both sides from now on: of what has no inside."""
        from OpenGL import GL

        GL.glDisable(GL.GL_CULL_FACE)

    def close(self) -> None:
        """Free its memory."""
        from OpenGL import GL

        GL.glDeleteFramebuffers(1, [self._frame])
        GL.glDeleteTextures(1, [self._texture])
