"""`View`: what a renderer draws: a pinhole camera of N environments, its outputs and its look.

`Renderer` is the contract of everything that draws; `DrawnState` is what it draws. `view_of` makes
the view of a camera of the scene, or of a `Viewpoint`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.sim.drawing.commands import ShownCommand

__all__ = [
    "DrawnState",
    "Look",
    "Optics",
    "Output",
    "Pictures",
    "Renderer",
    "View",
    "Viewpoint",
    "camera_id",
    "camera_size",
    "lens_of",
    "view_of",
]

Look = Literal["fast", "full"]
"""``fast``: for observations. ``full``: with shadows, highlights and smooth edges, for films."""
Output = Literal["color", "depth", "mask"]


class DrawnState(Protocol):
    """N environments that can be drawn: an engine, or stored states of one."""

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled scene."""
        ...

    @property
    def num_envs(self) -> int:
        """N."""
        ...

    @property
    def commands(self) -> Sequence[ShownCommand]:
        """Commands in force, which pictures for people show."""
        ...

    def derived(self, name: str) -> NDArray[np.float64]:
        """(N, ...) a field of MjData at the current positions: ``geom_xpos``, ``cam_xmat``..."""
        ...

    def state(self, name: str) -> NDArray[np.float64]:
        """(N, ...) a component of the simulation's state: ``qpos``, ``qvel``..."""
        ...

    def model_values(self, name: str) -> NDArray[Any]:
        """(N or 1, ...) a field of MjModel; one row if the environments share it."""
        ...


@dataclass(frozen=True)
class Optics:
    """A pinhole camera.

    Attributes:
        width, height: Pixels.
        focal: fx, fy in pixels.
        centre: cx, cy in pixels from the top left corner.
        near, far: Metres along the axis.
    """

    width: int
    height: int
    focal: tuple[float, float]
    centre: tuple[float, float]
    near: float = 0.005
    far: float = 100.0

    @classmethod
    def of_fovy(
        cls, width: int, height: int, fovy: float, near: float = 0.005, far: float = 100.0
    ) -> Optics:
        """Square pixels, the axis in the middle; `fovy` in degrees."""
        focal = height / (2.0 * np.tan(np.radians(fovy) / 2.0))
        return cls(width, height, (focal, focal), (width / 2.0, height / 2.0), near, far)


@dataclass(frozen=True, eq=False)
class View:
    """One camera of all environments.

    Attributes:
        optics: Its lens; focal lengths and centre may differ between environments.
        position: (N or 1, 3) m.
        axes: (N or 1, 3, 3) rotation matrix: columns are right, up and backwards (OpenGL).
        focal: (N, 2) fx, fy in pixels instead of those of `optics`, or None.
        outputs: Of ``color``, ``depth``, ``mask``.
        look: ``fast`` or ``full``.
        centre: (N, 2) cx, cy in pixels instead of those of `optics`, or None.
        marks: Whether it shows halos, what is reached, and commands, for people.
    """

    optics: Optics
    position: NDArray[Any]
    axes: NDArray[Any]
    focal: NDArray[Any] | None = None
    outputs: tuple[Output, ...] = ("color",)
    look: Look = "fast"
    centre: NDArray[Any] | None = None
    marks: bool = False

    @property
    def lens(self) -> NDArray[np.float64]:
        """(N or 1, 4) fx, fy, cx, cy in pixels."""
        focal = np.asarray(self.optics.focal)[None] if self.focal is None else self.focal
        centre = np.asarray(self.optics.centre)[None] if self.centre is None else self.centre
        lens = np.empty((max(len(focal), len(centre)), 4))
        lens[:, :2] = focal
        lens[:, 2:] = centre
        return lens


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A place to look from, for pictures of any size.

    Attributes:
        position: (N or 1, 3) m.
        axes: (N or 1, 3, 3) as in `View`.
        fovy: Vertical field of view in degrees.
    """

    position: NDArray[np.float64]
    axes: NDArray[np.float64]
    fovy: float = 45.0

    @classmethod
    def look_at(
        cls,
        eye: Sequence[float],
        target: Sequence[float],
        up: Sequence[float] = (0.0, 0.0, 1.0),
        fovy: float = 45.0,
    ) -> Viewpoint:
        """A view from one point to another; +x is up if `up` is parallel to the view.

        Raises:
            ValueError: If the points are the same.
        """
        position = np.asarray(eye, np.float64)
        back = position - np.asarray(target, np.float64)
        length = float(np.linalg.norm(back))
        if length < 1e-9:
            raise ValueError(f"the eye is at the target, {list(eye)}")
        back /= length
        for upwards in (up, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
            right = np.cross(np.asarray(upwards, np.float64), back)
            size = float(np.linalg.norm(right))
            if size > 1e-6:
                right /= size
                axes = np.stack([right, np.cross(back, right), back], axis=1)
                return cls(position[None], axes[None], fovy)
        raise ValueError("no direction is at right angles to the view")


Pictures = dict[str, NDArray[Any]]
"""Output -> array: ``color`` (n, H, W, 4) uint8 RGBA; ``depth`` (n, H, W) float32 metres along the
camera's axis, 0 where nothing is hit; ``mask`` (n, H, W) int32 geom ids, -1 where nothing is hit.
The first row is the top of the picture."""


class Renderer(Protocol):
    """Draws N environments x M cameras in one call; see `renderer_register`."""

    @property
    def about(self) -> str:
        """What draws, for people and for logs: OpenGL's renderer and version."""
        ...

    def draw(
        self, state: DrawnState, views: Sequence[View], envs: NDArray[np.int64] | None = None
    ) -> list[Pictures]:
        """Draw every view of n environments.

        Args:
            state: The environments.
            views: The cameras.
            envs: (n,) indices of the environments; None is all N.

        Returns:
            The pictures of each view, n rows each. They depend neither on N nor on other
            environments.

        Raises:
            RenderError: If the renderer cannot draw an output here; names what to install.
        """
        ...

    def close(self) -> None:
        """Free the renderer's memory."""
        ...


def camera_id(model: mujoco.MjModel, camera: str | int) -> int:
    """The index of a camera of the scene.

    Raises:
        ValueError: If there is no such camera; lists the cameras.
    """
    names = [model.camera(i).name for i in range(model.ncam)]
    if isinstance(camera, str) and camera in names:
        return names.index(camera)
    if not isinstance(camera, str) and camera in range(len(names)):
        return camera
    raise ValueError(
        f"no camera {camera!r}; there are: {', '.join(names) or 'none'}."
        f"{did_you_mean(str(camera), names)}"
    )


def camera_size(model: mujoco.MjModel, camera: int) -> tuple[int, int]:
    """Width and height in pixels of a camera of the scene; 640 x 480 if it has no resolution."""
    width, height = model.cam_resolution[camera].tolist()
    if min(width, height) <= 1:  # MuJoCo's default is 1 x 1
        return (640, 480)
    return (width, height)


def lens_of(
    model: mujoco.MjModel,
    camera: int,
    width: int,
    height: int,
    values: Callable[[str], NDArray[Any]] | None = None,
) -> NDArray[np.float64]:
    """(N or 1, 4) fx, fy, cx, cy in pixels of a camera of the scene, see `view_of`.

    Args:
        model: The compiled scene.
        camera: Index of a camera.
        width: Pixels.
        height: Pixels.
        values: Returns (N or 1, ...) values of a field of the model, where arrays are; None is
            those compiled.

    Raises:
        ValueError: If the camera is orthographic.
    """
    if model.cam_projection[camera] != int(mujoco.mjtProjection.mjPROJ_PERSPECTIVE):
        name = model.camera(camera).name
        raise ValueError(f"camera {name!r} is orthographic: only pinhole cameras can be drawn")
    if values is None:
        values = lambda name: np.asarray(getattr(model, name))[None]  # noqa: E731
    pixels = np.array([width, height], np.float64)
    sensor = np.asarray(model.cam_sensorsize[camera], np.float64)
    if sensor.all():
        intrinsic = values("cam_intrinsic")[:, camera].astype(np.float64)
        focal = intrinsic[:, :2] / sensor * pixels
        offset = intrinsic[:, 2:] / sensor * pixels
        centre = 0.5 * pixels - offset
    else:
        fovy = values("cam_fovy")[:, camera].astype(np.float64)
        focal = np.repeat(height / (2.0 * np.tan(np.radians(fovy) / 2.0))[:, None], 2, axis=1)
        centre = np.broadcast_to(0.5 * pixels, focal.shape)
    return np.concatenate([focal, centre], axis=1)


def view_of(
    state: DrawnState,
    camera: str | int | Viewpoint,
    width: int,
    height: int,
    *,
    near: float | None = None,
    far: float | None = None,
    outputs: tuple[Output, ...] = ("color",),
    look: Look = "fast",
    marks: bool = False,
) -> View:
    """The view of a camera of the scene, with each environment's pose and optics.

    A camera with a sensor size has its own focal lengths and axis, and its sensor covers the
    picture: pixels are not square if the picture has other proportions. MuJoCo's principal point is
    the offset of the picture's middle from the axis, to the right and down.

    Args:
        state: The environments.
        camera: Name or index of a camera, or a viewpoint.
        width: Pixels.
        height: Pixels.
        near: Metres along the axis; None is the model's ``vis.map.znear``, in units of its extent.
        far: Likewise; None is ``vis.map.zfar``.
        outputs: Of ``color``, ``depth``, ``mask``.
        look: ``fast`` or ``full``.
        marks: Whether it shows halos, what is reached, and commands, for people.

    Raises:
        ValueError: If there is no such camera, or it is orthographic.
    """
    model = state.model
    if near is None:
        near = model.vis.map.znear * model.stat.extent
    if far is None:
        far = model.vis.map.zfar * model.stat.extent
    if isinstance(camera, Viewpoint):
        return View(
            optics=Optics.of_fovy(width, height, camera.fovy, near=near, far=far),
            position=camera.position,
            axes=camera.axes,
            outputs=outputs,
            look=look,
            marks=marks,
        )
    index = camera_id(model, camera)
    lens = lens_of(model, index, width, height, values=state.model_values)
    focal = lens[:, :2]
    centre = lens[:, 2:]
    differs = len(lens) > 1
    return View(
        optics=Optics(
            width=width,
            height=height,
            focal=(focal[0, 0], focal[0, 1]),
            centre=(centre[0, 0], centre[0, 1]),
            near=near,
            far=far,
        ),
        position=state.derived("cam_xpos")[:, index],
        axes=state.derived("cam_xmat").reshape(state.num_envs, -1, 3, 3)[:, index],
        focal=focal if differs else None,
        centre=centre if differs else None,
        outputs=outputs,
        look=look,
        marks=marks,
    )
