"""The OpenGL calls of the renderer: a context, programs, buffers of numbers, layered targets.

The only module that imports `OpenGL.GL`; it is imported when something is drawn for the first time.
All of it must run in one thread, see `RenderThread`.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.utils.errors import RenderError

__all__ = [
    "HINT",
    "Context",
    "LayeredTarget",
    "NumberTexture",
    "Program",
    "ShadowMap",
    "VertexBuffers",
    "context_class",
]

HINT = (
    "off-screen rendering needs EGL: `apt-get install libegl1 libgl1-mesa-dri` (Debian, Ubuntu), "
    "or set MUJOCO_GL to a library that works here"
)
"""What to do where no context can be made."""
_NEEDED = ("GL_ARB_shader_viewport_layer_array",)
_FORMATS = {
    "color": ("GL_RGBA8", "GL_RGBA", "GL_UNSIGNED_BYTE", np.uint8),
    "depth": ("GL_R32F", "GL_RED", "GL_FLOAT", np.float32),
    "mask": ("GL_R32I", "GL_RED_INTEGER", "GL_INT", np.int32),
}


_SPARE_UNIT = 15
"""For textures that no program reads."""


class Context:
    """An OpenGL context without a window, current in the thread that made it.

    Attributes:
        vendor, renderer, version: What OpenGL says of itself.
        max_layers: Pictures that one target may have.

    Raises:
        RenderError: If there is no OpenGL here, or one without layered rendering.
    """

    def __init__(self) -> None:
        try:
            self._context = context_class()(16, 16)
            self._context.make_current()
            from OpenGL import GL
        except (ImportError, AttributeError, OSError, RuntimeError) as error:
            raise RenderError(f"no picture can be made here ({error}); {HINT}") from error
        self.vendor, self.renderer, self.version = (
            GL.glGetString(name).decode() for name in (GL.GL_VENDOR, GL.GL_RENDERER, GL.GL_VERSION)
        )
        count = GL.glGetIntegerv(GL.GL_NUM_EXTENSIONS)
        known = {GL.glGetStringi(GL.GL_EXTENSIONS, i).decode() for i in range(int(count))}
        lacking = [name for name in _NEEDED if name not in known]
        if lacking:
            self.close()
            raise RenderError(f"OpenGL {self.version} of {self.renderer} lacks {lacking[0]}")
        layers = GL.glGetIntegerv(GL.GL_MAX_ARRAY_TEXTURE_LAYERS)
        self.max_layers = int(layers)

    def make_current(self) -> None:
        """Make it the one that calls of this thread go to."""
        self._context.make_current()

    def close(self) -> None:
        """Free it."""
        self._context.free()


def context_class() -> Any:
    """EGL's on Linux unless MUJOCO_GL names another, else MuJoCo's choice.

    MuJoCo's own default on Linux, GLFW, needs a display, and the main thread.
    """
    if sys.platform.startswith("linux") and not os.environ.get("MUJOCO_GL"):
        from mujoco.egl import GLContext

        return GLContext
    import mujoco

    return mujoco.GLContext


class Program:
    """A linked program, and the uniforms that it uses.

    Args:
        vertex: GLSL of the vertex shader.
        fragment: GLSL of the fragment shader; empty writes depth only.

    Raises:
        RenderError: If OpenGL does not compile it.
    """

    def __init__(self, vertex: str, fragment: str = "") -> None:
        from OpenGL import GL

        sources = [(GL.GL_VERTEX_SHADER, vertex)]
        sources += [(GL.GL_FRAGMENT_SHADER, fragment)] if fragment else []
        self._program = GL.glCreateProgram()
        for kind, source in sources:
            shader = GL.glCreateShader(kind)
            GL.glShaderSource(shader, source)
            GL.glCompileShader(shader)
            if not GL.glGetShaderiv(shader, GL.GL_COMPILE_STATUS):
                raise RenderError(f"a shader: {_text(GL.glGetShaderInfoLog(shader))}")
            GL.glAttachShader(self._program, shader)
        GL.glLinkProgram(self._program)
        if not GL.glGetProgramiv(self._program, GL.GL_LINK_STATUS):
            raise RenderError(f"a program: {_text(GL.glGetProgramInfoLog(self._program))}")
        self._places: dict[str, int] = {}

    def use(self, values: Mapping[str, Any] | None = None) -> None:
        """Make it current, and set uniforms: int, float triples, (n, 4) floats, (n,) integers."""
        from OpenGL import GL

        GL.glUseProgram(self._program)
        for name, value in (values or {}).items():
            place = self._places.get(name)
            if place is None:
                place = self._places[name] = GL.glGetUniformLocation(self._program, name)
            if place < 0:
                continue  # the compiler left it out
            if isinstance(value, (int, np.integer)):
                GL.glUniform1i(place, int(value))
                continue
            array = np.asarray(value)
            if array.ndim == 2:
                GL.glUniform4fv(place, len(array), np.ascontiguousarray(array, np.float32))
            elif array.dtype.kind == "i":
                GL.glUniform1iv(place, len(array), np.ascontiguousarray(array, np.int32))
            else:
                GL.glUniform3f(place, *map(float, array))


def _text(message: Any) -> str:
    return message.decode() if isinstance(message, bytes) else str(message)


class NumberTexture:
    """Floats that shaders read by index, four at a time, bound to a texture unit.

    Args:
        unit: The texture unit.
    """

    def __init__(self, unit: int) -> None:
        from OpenGL import GL

        self._unit = unit
        self._buffer, self._texture = GL.glGenBuffers(1), GL.glGenTextures(1)

    def upload(self, values: NDArray[np.float32]) -> None:
        """Replace the numbers: float32, contiguous, a multiple of four."""
        from OpenGL import GL

        GL.glBindBuffer(GL.GL_TEXTURE_BUFFER, self._buffer)
        GL.glBufferData(GL.GL_TEXTURE_BUFFER, values.nbytes, values, GL.GL_STREAM_DRAW)
        GL.glActiveTexture(GL.GL_TEXTURE0 + self._unit)
        GL.glBindTexture(GL.GL_TEXTURE_BUFFER, self._texture)
        GL.glTexBuffer(GL.GL_TEXTURE_BUFFER, GL.GL_RGBA32F, self._buffer)


class VertexBuffers:
    """Vertices and triangles, uploaded once.

    Args:
        vertices: (V,) of a structured type whose fields are float32, in the order of locations.
        triangles: (T, 3) uint32.
    """

    def __init__(self, vertices: NDArray[Any], triangles: NDArray[np.uint32]) -> None:
        from OpenGL import GL

        self._array = GL.glGenVertexArrays(1)
        GL.glBindVertexArray(self._array)
        points, faces = GL.glGenBuffers(2)
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, points)
        GL.glBufferData(GL.GL_ARRAY_BUFFER, vertices.nbytes, vertices, GL.GL_STATIC_DRAW)
        GL.glBindBuffer(GL.GL_ELEMENT_ARRAY_BUFFER, faces)
        flat = np.ascontiguousarray(triangles)
        GL.glBufferData(GL.GL_ELEMENT_ARRAY_BUFFER, flat.nbytes, flat, GL.GL_STATIC_DRAW)
        fields = (vertices.dtype.fields or {}).values()
        for place, (kind, offset) in enumerate(field[:2] for field in fields):
            size = int(np.prod(kind.shape, dtype=np.int64))
            GL.glEnableVertexAttribArray(place)
            start = ctypes.c_void_p(offset)
            GL.glVertexAttribPointer(place, size, GL.GL_FLOAT, False, vertices.itemsize, start)

    def draw(self, first: int, count: int, instances: int) -> None:
        """Draw `count` triangles from `first` on, as many times as there are instances."""
        from OpenGL import GL

        GL.glBindVertexArray(self._array)
        start = ctypes.c_void_p(12 * first)
        GL.glDrawElementsInstanced(GL.GL_TRIANGLES, 3 * count, GL.GL_UNSIGNED_INT, start, instances)

    def draw_background(self, instances: int) -> None:
        """Draw one triangle behind everything else of every picture."""
        from OpenGL import GL

        GL.glBindVertexArray(self._array)
        GL.glDepthFunc(GL.GL_LEQUAL)
        GL.glDisable(GL.GL_CULL_FACE)
        GL.glDrawArraysInstanced(GL.GL_TRIANGLES, 0, 3, instances)
        GL.glEnable(GL.GL_CULL_FACE)
        GL.glDepthFunc(GL.GL_LESS)


class LayeredTarget:
    """Pictures of one size, one a layer, with the outputs that are asked for.

    Args:
        width: Pixels.
        height: Pixels.
        layers: How many pictures.
        outputs: Of ``color``, ``depth``, ``mask``.
        halved: Whether pictures are drawn at twice the size, and averaged when they are read: for
            ``color`` alone.
    """

    def __init__(
        self, width: int, height: int, layers: int, outputs: Sequence[str], halved: bool = False
    ) -> None:
        from OpenGL import GL

        self.size = width, height
        self.outputs = tuple(outputs)
        self.halved = halved
        self._layers = layers
        factor = 2 if halved else 1
        self._drawn = factor * width, factor * height
        self._frame = GL.glGenFramebuffers(1)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._frame)
        self._textures: dict[str, Any] = {}
        attached = [GL.GL_NONE] * 3
        for name in self.outputs:
            place = list(_FORMATS).index(name)
            levels = 2 if halved and name == "color" else 1
            self._textures[name] = self._texture(getattr(GL, _FORMATS[name][0]), levels)
            attached[place] = GL.GL_COLOR_ATTACHMENT0 + place
            GL.glFramebufferTexture(GL.GL_FRAMEBUFFER, attached[place], self._textures[name], 0)
        self._z = self._texture(GL.GL_DEPTH_COMPONENT32F, 1)
        GL.glFramebufferTexture(GL.GL_FRAMEBUFFER, GL.GL_DEPTH_ATTACHMENT, self._z, 0)
        GL.glDrawBuffers(3, attached)
        status = GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER)
        if status != GL.GL_FRAMEBUFFER_COMPLETE:
            raise RenderError(f"no target of {layers} pictures of {width} x {height}: {status:#x}")

    def _texture(self, kind: Any, levels: int) -> Any:
        from OpenGL import GL

        texture = GL.glGenTextures(1)
        GL.glActiveTexture(GL.GL_TEXTURE0 + _SPARE_UNIT)
        GL.glBindTexture(GL.GL_TEXTURE_2D_ARRAY, texture)
        GL.glTexStorage3D(GL.GL_TEXTURE_2D_ARRAY, levels, kind, *self._drawn, self._layers)
        return texture

    def begin(self) -> None:
        """Draw into it from now on; everything is cleared."""
        from OpenGL import GL

        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._frame)
        GL.glViewport(0, 0, *self._drawn)
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glEnable(GL.GL_CULL_FACE)
        GL.glFrontFace(GL.GL_CW)  # pictures are drawn upside down: their first row is the top
        GL.glDepthMask(True)
        GL.glDisable(GL.GL_BLEND)
        GL.glClear(GL.GL_DEPTH_BUFFER_BIT)
        if "color" in self._textures:
            GL.glClearBufferfv(GL.GL_COLOR, 0, np.array([0, 0, 0, 1], np.float32))
        if "depth" in self._textures:
            GL.glClearBufferfv(GL.GL_COLOR, 1, np.zeros(4, np.float32))
        if "mask" in self._textures:
            GL.glClearBufferiv(GL.GL_COLOR, 2, np.full(4, -1, np.int32))

    @contextmanager
    def color_alone(self, blended: bool = False) -> Iterator[None]:
        """Within it, only colour is written; blended, it mixes with what is behind."""
        from OpenGL import GL

        for place in (1, 2):
            GL.glColorMaski(place, False, False, False, False)
        if blended:
            GL.glDepthMask(False)
            GL.glEnablei(GL.GL_BLEND, 0)
            GL.glBlendFunc(GL.GL_SRC_ALPHA, GL.GL_ONE_MINUS_SRC_ALPHA)
        try:
            yield
        finally:
            for place in (1, 2):
                GL.glColorMaski(place, True, True, True, True)
            GL.glDisablei(GL.GL_BLEND, 0)
            GL.glDepthMask(True)

    def read(self, name: str, into: NDArray[Any]) -> None:
        """Read an output, (layers, height, width, ...)."""
        from OpenGL import GL

        _, layout, kind, _ = _FORMATS[name]
        GL.glActiveTexture(GL.GL_TEXTURE0 + _SPARE_UNIT)
        GL.glBindTexture(GL.GL_TEXTURE_2D_ARRAY, self._textures[name])
        level = 0
        if self.halved and name == "color":
            GL.glGenerateMipmap(GL.GL_TEXTURE_2D_ARRAY)
            level = 1
        GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
        GL.glGetTexImage(
            GL.GL_TEXTURE_2D_ARRAY, level, getattr(GL, layout), getattr(GL, kind), into
        )

    def empty(self, name: str) -> NDArray[Any]:
        """An array that `read` fills."""
        width, height = self.size
        shape = (self._layers, height, width)
        found: NDArray[Any] = np.empty((*shape, 4) if name == "color" else shape, _FORMATS[name][3])
        return found

    def close(self) -> None:
        """Free its memory."""
        from OpenGL import GL

        GL.glDeleteFramebuffers(1, [self._frame])
        GL.glDeleteTextures(len(self._textures) + 1, [*self._textures.values(), self._z])


class ShadowMap:
    """Depths that a light sees, one square a layer, bound to a texture unit for comparing.

    Args:
        pixels: Of a side.
        layers: How many.
        unit: The texture unit.
    """

    def __init__(self, pixels: int, layers: int, unit: int) -> None:
        from OpenGL import GL

        self.layers = layers
        self._pixels, self._unit = pixels, unit
        self._texture, self._frame = GL.glGenTextures(1), GL.glGenFramebuffers(1)
        GL.glActiveTexture(GL.GL_TEXTURE0 + unit)
        kind = GL.GL_TEXTURE_2D_ARRAY
        GL.glBindTexture(kind, self._texture)
        GL.glTexStorage3D(kind, 1, GL.GL_DEPTH_COMPONENT24, pixels, pixels, layers)
        GL.glTexParameteri(kind, GL.GL_TEXTURE_COMPARE_MODE, GL.GL_COMPARE_REF_TO_TEXTURE)
        GL.glTexParameteri(kind, GL.GL_TEXTURE_COMPARE_FUNC, GL.GL_LEQUAL)
        GL.glTexParameteri(kind, GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR)
        GL.glTexParameteri(kind, GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._frame)
        GL.glFramebufferTexture(GL.GL_FRAMEBUFFER, GL.GL_DEPTH_ATTACHMENT, self._texture, 0)
        GL.glDrawBuffer(GL.GL_NONE)

    def begin(self) -> None:
        """Draw into it from now on."""
        from OpenGL import GL

        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._frame)
        GL.glViewport(0, 0, self._pixels, self._pixels)
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glDepthMask(True)
        GL.glDisable(GL.GL_CULL_FACE)
        GL.glClear(GL.GL_DEPTH_BUFFER_BIT)

    def end(self) -> None:
        """Bind it for reading."""
        from OpenGL import GL

        GL.glActiveTexture(GL.GL_TEXTURE0 + self._unit)
        GL.glBindTexture(GL.GL_TEXTURE_2D_ARRAY, self._texture)
        GL.glActiveTexture(GL.GL_TEXTURE0)

    def close(self) -> None:
        """Free its memory."""
        from OpenGL import GL

        GL.glDeleteFramebuffers(1, [self._frame])
        GL.glDeleteTextures(1, [self._texture])
