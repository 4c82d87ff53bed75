"""`ClassicRenderer`: draws picture after picture with MuJoCo's own renderer.

For OpenGL without layered rendering (macOS, old drivers).
"""

from __future__ import annotations

import copy
import ctypes
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.gl import context_class, hint
from embodichain.lab.sim.drawing.marks import MarkedState
from embodichain.lab.sim.drawing.overlays import add_geoms
from embodichain.lab.sim.drawing.states import DRAWN_FIELDS, DRAWN_POSES
from embodichain.lab.sim.drawing.views import DrawnState, Optics, Pictures, View
from embodichain.utils.errors import RenderError

__all__ = ["ClassicRenderer"]

_MOST_GEOMS = 10_000
_SHADOW_PIXELS = 2048
"""Largest side of a shadow map; enough for a film, and half the time of 4096."""
_EXPENSIVE = [int(mujoco.mjtRndFlag.mjRND_SHADOW), int(mujoco.mjtRndFlag.mjRND_REFLECTION)]
_NUMBERED = [int(mujoco.mjtRndFlag.mjRND_SEGMENT), int(mujoco.mjtRndFlag.mjRND_IDCOLOR)]
"""Flags for colours that are the numbers of geoms in the scene."""
_EVERYTHING = int(mujoco.mjtCatBit.mjCAT_ALL.value)
_NONE = int(mujoco.mjtGeom.mjGEOM_NONE)
_GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)


class ClassicRenderer:
    """Draws a scene, one picture after the other. Call it from the render thread only.

    One OpenGL context, one MjModel and one MjData serve environments and sizes in turn. Sites and
    tendons are not drawn, as in `BatchRenderer`.

    Args:
        model: The compiled scene.

    Attributes:
        about: OpenGL's renderer and version.

    Raises:
        RenderError: If OpenGL does not work here.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = copy.copy(model)
        quality = self._model.vis.quality
        quality.shadowsize = min(quality.shadowsize, _SHADOW_PIXELS)
        self._data = mujoco.MjData(self._model)
        self._scene = mujoco.MjvScene(self._model, _MOST_GEOMS)
        self._camera = mujoco.MjvCamera()
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0
        try:
            self._gl = context_class()(16, 16)
            self._gl.make_current()
            self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except (ImportError, AttributeError, OSError, RuntimeError, mujoco.FatalError) as error:
            raise RenderError(f"no picture can be made here ({error}); {hint()}") from error
        self.about = _about()
        mujoco.mjr_setBuffer(int(mujoco.mjtFramebuffer.mjFB_OFFSCREEN), self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR

    def draw(
        self, state: DrawnState, views: Sequence[View], envs: NDArray[np.int64] | None = None
    ) -> list[Pictures]:
        """Draw every view of n environments; see `Renderer`."""
        rows = np.arange(state.num_envs) if envs is None else envs
        self._gl.make_current()
        pictures = [_empty(view, len(rows)) for view in views]
        poses = {name: state.derived(name) for name in DRAWN_POSES}
        fields = {name: state.model_values(name) for name in DRAWN_FIELDS}
        for place, row in enumerate(rows.tolist()):
            for name, values in poses.items():
                part = getattr(self._data, name)
                part[...] = values[row].reshape(part.shape)
            for name, values in fields.items():
                part = getattr(self._model, name)
                part[...] = _of_row(values, row).reshape(part.shape)
            for view, pictures_of_view in zip(views, pictures, strict=True):
                self._fill(view, row)
                if isinstance(state, MarkedState):
                    add_geoms(self._scene, state.overlay.viewer_geoms(row))
                for name, picture in self._draw(view).items():
                    pictures_of_view[name][place] = picture
        return pictures

    def _fill(self, view: View, row: int) -> None:
        """Fill the scene with one environment, as its camera sees it."""
        scene = self._scene
        self._aim(view, row)  # an endless plane is drawn around the camera before the update
        mujoco.mjv_updateScene(
            self._model,
            self._data,
            self._option,
            None,  # nothing is dragged by a mouse
            self._camera,
            _EVERYTHING,
            scene,
        )
        self._aim(view, row)
        scene.flags[_EXPENSIVE] = int(view.look == "full")

    def _aim(self, view: View, row: int) -> None:
        """Set the scene's cameras, and the light at the camera."""
        scene = self._scene
        optics = view.optics
        position = _of_row(view.position, row)
        axes = _of_row(view.axes, row)
        fx, fy, cx, cy = _of_row(view.lens, row)
        near = optics.near
        for camera in scene.camera:
            camera.pos = position
            camera.forward = -axes[:, 2]
            camera.up = axes[:, 1]
            camera.frustum_near = near
            camera.frustum_far = optics.far
            camera.frustum_top = near * cy / fy
            camera.frustum_bottom = -near * (optics.height - cy) / fy
            camera.frustum_width = near * 0.5 * optics.width / fx
            camera.frustum_center = near * (0.5 * optics.width - cx) / fx
        for light in scene.lights[: scene.nlight]:
            if light.headlight:
                light.pos = position
                light.dir = -axes[:, 2]

    def _draw(self, view: View) -> Pictures:
        """Draw one picture of each output, of the scene as it is."""
        optics = view.optics
        context = self._context
        if optics.width > context.offWidth or optics.height > context.offHeight:
            width = max(optics.width, context.offWidth)
            height = max(optics.height, context.offHeight)
            mujoco.mjr_resizeOffscreen(width, height, context)
        pictures: Pictures = {}
        # Geometry comes last: it takes transparent geoms out of the scene.
        if "color" in view.outputs:
            pictures["color"] = self._draw_colour(optics)
        if "depth" in view.outputs or "mask" in view.outputs:
            depth, mask = self._draw_geometry(optics)
            if "depth" in view.outputs:
                pictures["depth"] = depth
            if "mask" in view.outputs:
                pictures["mask"] = mask
        return pictures

    def _draw_colour(self, optics: Optics) -> NDArray[np.uint8]:
        """(H, W, 4) RGBA."""
        rect = mujoco.MjrRect(0, 0, optics.width, optics.height)
        pixels = np.empty((optics.height, optics.width, 3), np.uint8)
        mujoco.mjr_render(rect, self._scene, self._context)
        mujoco.mjr_readPixels(pixels, None, rect, self._context)
        colour = np.full((optics.height, optics.width, 4), 255, np.uint8)
        colour[..., :3] = pixels[::-1]
        return colour

    def _draw_geometry(self, optics: Optics) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """(H, W) depth in metres, and (H, W) geom ids."""
        self._remove_transparent_geoms()
        scene = self._scene
        rect = mujoco.MjrRect(0, 0, optics.width, optics.height)
        pixels = np.empty((optics.height, optics.width, 3), np.uint8)
        depth = np.empty((optics.height, optics.width), np.float32)
        scene.flags[_NUMBERED] = 1
        mujoco.mjr_render(rect, scene, self._context)
        mujoco.mjr_readPixels(pixels, depth, rect, self._context)
        scene.flags[_NUMBERED] = 0

        mask = self._geom_ids(pixels)
        near = np.float64(optics.near)
        far = np.float64(optics.far)
        # Depth runs from 1 at `near` to 0 at `far`, linear in 1 / distance.
        metres = near * far / (near + depth.astype(np.float64) * (far - near))
        metres[mask < 0] = 0.0
        # OpenGL's first row is the bottom of the picture.
        return metres[::-1].astype(np.float32), mask[::-1]

    def _remove_transparent_geoms(self) -> None:
        """Take geoms that light passes out of the scene until it is filled again."""
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.rgba[3] < 1.0:
                geom.type = _NONE

    def _geom_ids(self, pixels: NDArray[np.uint8]) -> NDArray[np.int32]:
        """(H, W) geom ids of a picture whose colours are numbers in the scene, plus 1; else -1."""
        number = pixels.astype(np.int64) @ np.array([1, 2**8, 2**16])
        ids = np.full(self._scene.ngeom + 1, -1, np.int32)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.segid >= 0 and geom.objtype == _GEOM:
                ids[geom.segid + 1] = geom.objid
        return ids[number]

    def close(self) -> None:
        """Free the context and everything in it."""
        self._gl.make_current()
        self._context.free()
        self._gl.free()


def _of_row(values: NDArray[Any], row: int) -> NDArray[Any]:
    """Return the values of one environment; a single row is that of all."""
    if len(values) == 1:
        return values[0]
    return values[row]


def _about() -> str:
    """What OpenGL says of itself."""
    try:
        from OpenGL import GL

        name = GL.glGetString(GL.GL_RENDERER).decode()
        version = GL.glGetString(GL.GL_VERSION).decode()
    except (ImportError, AttributeError, OSError, ctypes.ArgumentError):
        return "OpenGL"  # MuJoCo needs the module only for EGL and OSMesa, the library never
    return f"{name}, OpenGL {version}"


def _empty(view: View, count: int) -> Pictures:
    """Arrays for the outputs of a view in `count` environments."""
    size = (count, view.optics.height, view.optics.width)
    pictures: Pictures = {}
    for name in view.outputs:
        if name == "color":
            pictures[name] = np.empty((*size, 4), np.uint8)
        elif name == "depth":
            pictures[name] = np.empty(size, np.float32)
        else:
            pictures[name] = np.empty(size, np.int32)
    return pictures
