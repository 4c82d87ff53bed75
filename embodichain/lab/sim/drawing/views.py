"""`View`: what a renderer draws: a pinhole camera of N environments, its outputs and its look.

`Renderer` is the contract of everything that draws; `DrawnState` is what it draws.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

__all__ = ["DrawnState", "Look", "Optics", "Output", "Pictures", "Renderer", "View"]

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

    def derived(self, name: str) -> NDArray[np.float64]:
        """(N, ...) a field of MjData at the current positions: ``geom_xpos``, ``cam_xmat``..."""
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
        centre: (N, 2) cx, cy in pixels instead of those of `optics`, or None.
        outputs: What is wanted.
        look: ``fast`` or ``full``.
    """

    optics: Optics
    position: NDArray[Any]
    axes: NDArray[Any]
    focal: NDArray[Any] | None = None
    centre: NDArray[Any] | None = None
    outputs: tuple[Output, ...] = ("color",)
    look: Look = "fast"


Pictures = dict[str, NDArray[Any]]
"""Output -> array: ``color`` (n, H, W, 4) uint8 RGBA; ``depth`` (n, H, W) float32 metres along the
camera's axis, 0 where nothing is hit; ``mask`` (n, H, W) int32 geom ids, -1 where nothing is hit.
The first row is the top of the picture."""


class Renderer(Protocol):
    """Draws N environments x M cameras in one call."""

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
