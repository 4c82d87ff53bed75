"""The OpenGL objects of the renderer: a context, programs, buffers of numbers and of triangles.

With `targets` and `textures` the only modules that import `OpenGL.GL`, when something is drawn for
the first time. All of it must run in one thread.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.utils.errors import RenderError
from embodichain.utils.system.display import has_display

__all__ = [
    "VARIABLE",
    "Context",
    "NumberTexture",
    "Program",
    "VertexBuffers",
    "context_class",
    "hint",
]

VARIABLE = "EMBODICHAIN_RENDERER"
"""Environment variable that names the only renderer to try."""
_EGL = "EGL: `apt-get install libegl1 libgl1-mesa-dri libopengl0` (Debian, Ubuntu)"
_NEEDED = "GL_ARB_shader_viewport_layer_array"
_VERSION = (4, 5)
_WITHOUT_DISPLAY = ("egl", "osmesa")
"""Values of MUJOCO_GL."""


class Context:
    """An OpenGL context without a window, current in the thread that made it.

    Attributes:
        vendor, renderer, version: What OpenGL says of itself.
        max_layers: Pictures that one target may have.
        max_pixels: The longest side of a target.

    Raises:
        RenderError: If there is no OpenGL here, or one without layered rendering.
    """

    def __init__(self) -> None:
        try:
            self._context = context_class()(16, 16)
            self._context.make_current()
            from OpenGL import GL
        except (ImportError, AttributeError, OSError, RuntimeError) as error:
            raise RenderError(f"no picture can be made here ({error}); {hint()}") from error
        try:
            self.vendor = _text(GL.glGetString(GL.GL_VENDOR) or b"unknown")
            self.renderer = _text(GL.glGetString(GL.GL_RENDERER) or b"unknown")
            self.version = _text(GL.glGetString(GL.GL_VERSION) or b"unknown")
        except ctypes.ArgumentError as error:  # EGL is installed, libOpenGL is not
            self.close()
            raise RenderError(f"no picture can be made here ({error}); {hint()}") from error
        major = int(GL.glGetIntegerv(GL.GL_MAJOR_VERSION))
        minor = int(GL.glGetIntegerv(GL.GL_MINOR_VERSION))
        count = int(GL.glGetIntegerv(GL.GL_NUM_EXTENSIONS))
        extensions = {_text(GL.glGetStringi(GL.GL_EXTENSIONS, i)) for i in range(count)}
        if (major, minor) < _VERSION or _NEEDED not in extensions:
            self.close()
            opengl = f"OpenGL {self.version} of {self.renderer}"
            raise RenderError(f"{opengl}: the batch renderer needs 4.5 and {_NEEDED}")
        self.max_layers = min(
            int(GL.glGetIntegerv(name))
            for name in (GL.GL_MAX_ARRAY_TEXTURE_LAYERS, GL.GL_MAX_FRAMEBUFFER_LAYERS)
        )
        GL.glClipControl(GL.GL_LOWER_LEFT, GL.GL_ZERO_TO_ONE)
        self.max_pixels = int(GL.glGetIntegerv(GL.GL_MAX_TEXTURE_SIZE))

    def make_current(self) -> None:
        """Direct the calls of this thread to it: other renderers have contexts of their own."""
        self._context.make_current()

    def close(self) -> None:
        """Free it."""
        self._context.free()


def hint() -> str:
    """What to do where no context can be made."""
    mujoco_gl = _mujoco_gl()
    if mujoco_gl not in ("", "egl"):
        return f"MUJOCO_GL is {mujoco_gl!r}: unset it, and install {_EGL}"
    return f"off-screen rendering needs {_EGL}, or set MUJOCO_GL to a library that works here"


def context_class() -> Any:
    """EGL's on Linux unless MUJOCO_GL names another, else MuJoCo's choice.

    MuJoCo's own default on Linux, GLFW, needs a display, and the main thread.

    Raises:
        RuntimeError: If MUJOCO_GL turns OpenGL off, or GLFW has no display.
    """
    mujoco_gl = _mujoco_gl()
    if sys.platform.startswith("linux") and not mujoco_gl:
        from mujoco.egl import GLContext

        return GLContext
    import mujoco

    if not hasattr(mujoco, "GLContext"):
        raise RuntimeError("MUJOCO_GL turns OpenGL off")
    if mujoco_gl not in _WITHOUT_DISPLAY and not has_display():
        raise RuntimeError("GLFW needs a display")
    return mujoco.GLContext


def _mujoco_gl() -> str:
    """Return MUJOCO_GL, as MuJoCo reads it."""
    return os.environ.get("MUJOCO_GL", "").lower().strip()


def _text(message: Any) -> str:
    return message.decode() if isinstance(message, bytes) else str(message)


class Program:
    """A linked program.

    Args:
        vertex: GLSL of the vertex shader.
        fragment: GLSL of the fragment shader; empty writes depth only.

    Raises:
        RenderError: If OpenGL does not compile it.
    """

    def __init__(self, vertex: str, fragment: str) -> None:
        from OpenGL import GL

        sources = [(GL.GL_VERTEX_SHADER, vertex)]
        if fragment:
            sources.append((GL.GL_FRAGMENT_SHADER, fragment))
        self._program = GL.glCreateProgram()
        for kind, source in sources:
            shader = GL.glCreateShader(kind)
            GL.glShaderSource(shader, source)
            GL.glCompileShader(shader)
            if not GL.glGetShaderiv(shader, GL.GL_COMPILE_STATUS):
                raise RenderError(f"a shader: {_text(GL.glGetShaderInfoLog(shader))}")
            GL.glAttachShader(self._program, shader)
            GL.glDeleteShader(shader)  # goes with the program
        GL.glLinkProgram(self._program)
        if not GL.glGetProgramiv(self._program, GL.GL_LINK_STATUS):
            raise RenderError(f"a program: {_text(GL.glGetProgramInfoLog(self._program))}")
        self._locations: dict[str, int] = {}
        self._values: dict[str, Any] = {}

    def use(self, values: Mapping[str, int | float | tuple[float, float, float]]) -> None:
        """Make it current, and set uniforms; those that the compiler left out are passed over."""
        from OpenGL import GL

        GL.glUseProgram(self._program)
        for name, value in values.items():
            if self._values.get(name) == value:
                continue
            self._values[name] = value
            location = self._locations.get(name)
            if location is None:
                location = GL.glGetUniformLocation(self._program, name)
                self._locations[name] = location
            if location < 0:
                continue
            if isinstance(value, int):
                GL.glUniform1i(location, value)
            elif isinstance(value, float):
                GL.glUniform1f(location, value)
            else:
                GL.glUniform3f(location, *value)

    def close(self) -> None:
        """Free it."""
        from OpenGL import GL

        GL.glDeleteProgram(self._program)


class NumberTexture:
    """Floats that shaders read by index, four at a time, bound to a texture unit.

    Args:
        unit: The texture unit.
    """

    def __init__(self, unit: int) -> None:
        from OpenGL import GL

        self._buffer = GL.glGenBuffers(1)
        self._texture = GL.glGenTextures(1)
        GL.glBindBuffer(GL.GL_TEXTURE_BUFFER, self._buffer)
        GL.glActiveTexture(GL.GL_TEXTURE0 + unit)
        GL.glBindTexture(GL.GL_TEXTURE_BUFFER, self._texture)
        GL.glTexBuffer(GL.GL_TEXTURE_BUFFER, GL.GL_RGBA32F, self._buffer)
        self._uploaded: NDArray[np.float32] | None = None

    def upload(self, values: NDArray[np.float32]) -> None:
        """Replace the numbers: float32, contiguous, a multiple of four, not written to later."""
        from OpenGL import GL

        if values is self._uploaded:
            return
        self._uploaded = values
        GL.glBindBuffer(GL.GL_TEXTURE_BUFFER, self._buffer)
        GL.glBufferData(GL.GL_TEXTURE_BUFFER, values.nbytes, values, GL.GL_STREAM_DRAW)

    def close(self) -> None:
        """Free it."""
        from OpenGL import GL

        GL.glDeleteTextures(1, [self._texture])
        GL.glDeleteBuffers(1, [self._buffer])


class VertexBuffers:
    """Vertices, and lists of their triangles.

    Args:
        vertices: (V,) of a structured type whose fields are float32, in the order of locations.
    """

    def __init__(self, vertices: NDArray[Any]) -> None:
        from OpenGL import GL

        self._array = GL.glGenVertexArrays(1)
        GL.glBindVertexArray(self._array)
        self._vertices = GL.glGenBuffers(1)
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, self._vertices)
        GL.glBufferData(GL.GL_ARRAY_BUFFER, vertices.nbytes, vertices, GL.GL_STATIC_DRAW)
        fields: Mapping[str, Any] = vertices.dtype.fields or {}
        for location, (kind, offset, *_) in enumerate(fields.values()):
            GL.glEnableVertexAttribArray(location)
            GL.glVertexAttribPointer(
                location,
                int(np.prod(kind.shape, dtype=np.int64)),
                GL.GL_FLOAT,
                False,
                vertices.itemsize,
                ctypes.c_void_p(offset),
            )
        self._lists: dict[Hashable, tuple[Any, int]] = {}

    def has(self, key: Hashable) -> bool:
        """Whether there is a list of this name."""
        return key in self._lists

    def put(self, key: Hashable, triangles: Sequence[NDArray[np.uint32]]) -> None:
        """Store a list: parts of (T, 3) indices of vertices."""
        from OpenGL import GL

        flat = np.concatenate([np.zeros((0, 3), np.uint32), *triangles])
        buffer = self._lists[key][0] if key in self._lists else GL.glGenBuffers(1)
        GL.glBindVertexArray(self._array)
        GL.glBindBuffer(GL.GL_ELEMENT_ARRAY_BUFFER, buffer)
        GL.glBufferData(GL.GL_ELEMENT_ARRAY_BUFFER, flat.nbytes, flat, GL.GL_STATIC_DRAW)
        self._lists[key] = buffer, flat.size

    def draw(self, key: Hashable, instances: int) -> None:
        """Draw the triangles of a list, as many times as there are instances."""
        from OpenGL import GL

        buffer, count = self._lists[key]
        if not count:
            return
        GL.glBindVertexArray(self._array)
        GL.glBindBuffer(GL.GL_ELEMENT_ARRAY_BUFFER, buffer)
        GL.glDrawElementsInstanced(GL.GL_TRIANGLES, count, GL.GL_UNSIGNED_INT, None, instances)

    def draw_whole(self, instances: int) -> None:
        """Draw one triangle whose corners a shader chooses, for all of a picture."""
        from OpenGL import GL

        GL.glBindVertexArray(self._array)
        GL.glDrawArraysInstanced(GL.GL_TRIANGLES, 0, 3, instances)

    def close(self) -> None:
        """Free them."""
        from OpenGL import GL

        buffers = [self._vertices, *(buffer for buffer, _ in self._lists.values())]
        GL.glDeleteVertexArrays(1, [self._array])
        GL.glDeleteBuffers(len(buffers), buffers)
