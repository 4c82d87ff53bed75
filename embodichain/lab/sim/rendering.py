"""Off-screen rendering of one environment: `SceneRenderer`, on `mujoco.Renderer`.

The OpenGL library is chosen at first use, so that importing this package needs none.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import mujoco
import numpy as np

from embodichain.utils.errors import RenderError
from embodichain.utils.suggest import did_you_mean

__all__ = ["Drawable", "SceneRenderer", "View"]

_HINT = (
    "off-screen rendering needs EGL: `apt-get install libegl1 libgl1-mesa-dri` (Debian, Ubuntu), "
    "or set MUJOCO_GL to a library that works here"
)


def _choose_opengl() -> None:
    """Use EGL if there is no display and the user chose no library.

    MuJoCo chooses at import, by MUJOCO_GL; its default, GLFW, needs a display. Importing EGL always
    would slow every start, so the class is replaced here.
    """
    headless = sys.platform.startswith("linux") and not os.environ.get("DISPLAY")
    if headless and not os.environ.get("MUJOCO_GL"):
        from mujoco.egl import GLContext
        from mujoco.rendering.classic import gl_context

        gl_context.GLContext = GLContext


class Drawable(Protocol):
    """An object that can be rendered: an engine, or a stored state of one."""

    def data_of(self, env_id: int) -> mujoco.MjData:
        """One environment's state with all derived fields; its ``model`` is rendered."""


@dataclass(frozen=True)
class View:
    """A viewpoint other than the scene's cameras.

    Attributes:
        eye: (3,) metres, environment's frame.
        forward: (3,) unit vector.
        up: (3,) unit vector perpendicular to `forward`.
        fovy: Vertical field of view in degrees.
    """

    eye: tuple[float, ...]
    forward: tuple[float, ...]
    up: tuple[float, ...]
    fovy: float

    @classmethod
    def look_at(
        cls, eye: Sequence[float], target: Sequence[float], up: Sequence[float], fovy: float
    ) -> View:
        """A view from one point to another; +x is up if ``up`` is parallel to the view.

        Raises:
            ValueError: If the points are the same.
        """
        forward = np.subtract(target, eye).astype(np.float64)
        length = float(np.linalg.norm(forward))
        if length < 1e-9:
            raise ValueError(f"the eye is at the target, {list(eye)}")
        forward /= length
        for upwards in (up, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
            side = np.cross(forward, upwards)
            size = float(np.linalg.norm(side))
            if size > 1e-6:
                above = np.cross(side / size, forward)
                return cls(tuple(eye), tuple(forward.tolist()), tuple(above.tolist()), fovy)
        raise ValueError("no direction is at right angles to the view")

    def aim(self, scene: mujoco.MjvScene) -> None:
        """Set the cameras of an updated scene to this view."""
        for camera in scene.camera:
            camera.pos, camera.forward, camera.up = self.eye, self.forward, self.up
            camera.frustum_top = camera.frustum_near * np.tan(np.radians(self.fovy) / 2)
            camera.frustum_bottom = -camera.frustum_top
            camera.frustum_center = camera.frustum_width = 0.0
        for light in scene.lights[: scene.nlight]:
            if light.headlight:
                light.pos, light.dir = self.eye, self.forward


class SceneRenderer:
    """An off-screen renderer of one size.

    Args:
        model: The compiled scene.
        width: Pixels.
        height: Pixels.

    Raises:
        RenderError: If no OpenGL library works here; names the package to install.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self.size = (width, height)
        self._option = mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()
        self._cameras = [model.camera(i).name for i in range(model.ncam)]
        model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
        model.vis.global_.offheight = max(model.vis.global_.offheight, height)
        try:
            _choose_opengl()
            self._renderer = mujoco.Renderer(model, height=height, width=width)
        except (ImportError, AttributeError, OSError, RuntimeError, mujoco.FatalError) as error:
            raise RenderError(f"no picture can be made here ({error}); {_HINT}") from error

    def draw(
        self, engine: Drawable, env_id: int, camera: str | int | View
    ) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """Return (height, width, 3) RGB of one environment, which does not change.

        Raises:
            ValueError: If there is no such camera; lists the cameras.
        """
        known = self._cameras if isinstance(camera, str) else range(len(self._cameras))
        if not isinstance(camera, View) and camera not in known:
            raise ValueError(
                f"no camera {camera!r}; there are: {', '.join(self._cameras) or 'none'}."
                f"{did_you_mean(str(camera), self._cameras)}"
            )
        if isinstance(camera, View):
            self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FREE, -1
        else:
            chosen = self._cameras.index(camera) if isinstance(camera, str) else camera
            self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, chosen
        data = engine.data_of(env_id)
        # Twice: an endless plane is drawn around the camera of the last update.
        for _ in range(2):
            # Not `Renderer.update_scene`: the environment has its own colours, lights and cameras.
            mujoco.mjv_updateScene(
                data.model,
                data,
                self._option,
                None,
                self._camera,
                mujoco.mjtCatBit.mjCAT_ALL.value,
                self._renderer.scene,
            )
            if isinstance(camera, View):
                camera.aim(self._renderer.scene)
        picture: np.ndarray[Any, np.dtype[np.uint8]] = self._renderer.render().copy()
        return picture

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()
