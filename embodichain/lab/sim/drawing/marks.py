"""`MarkedState`: a state as pictures for people show it, with halos and what is reached."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.marks import HALO, Mark, Reached
from embodichain.lab.sim.drawing.views import DrawnState

__all__ = ["MarkedState"]

_HALO_ALPHA = 0.35


class MarkedState:
    """A state whose marked objects look as they should; all else is as in the state.

    Args:
        state: The environments.
        marks: Of its model.
    """

    def __init__(self, state: DrawnState, marks: list[Mark]) -> None:
        self._state = state
        self._marks = marks

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled scene."""
        return self._state.model

    @property
    def num_envs(self) -> int:
        """N."""
        return self._state.num_envs

    def derived(self, name: str) -> NDArray[np.float64]:
        """(N, ...) a field of MjData."""
        return self._state.derived(name)

    def model_values(self, name: str) -> NDArray[Any]:
        """(N or 1, ...) a field of MjModel; colours are those of the marks."""
        values = self._state.model_values(name)
        if name != "geom_rgba":
            return values
        shape = (self.num_envs, self.model.ngeom, 4)
        rgba = np.array(np.broadcast_to(values.reshape(len(values), -1, 4), shape))
        for mark in self._marks:
            self._paint(rgba, mark)
        return rgba

    def _paint(self, rgba: NDArray[Any], mark: Mark) -> None:
        """Write the colours of a marked object, (N, ngeom, 4)."""
        body = self.model.body(mark.uid).id
        geoms = np.flatnonzero(self.model.geom_bodyid == body)
        halo = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_GEOM, f"{mark.uid}/{HALO}")
        if halo >= 0:
            rgba[:, halo, 3] = _HALO_ALPHA
        if mark.reached is not None:
            envs = np.flatnonzero(self._is_reached(body, mark.reached))
            rgba[np.ix_(envs, geoms, [0, 1, 2])] = mark.reached.color

    def _is_reached(self, body: int, reached: Reached) -> NDArray[np.bool_]:
        """(N,) whether the point is near."""
        other = self.model.body(reached.body).id
        gaps = self._point_on(body, reached.offset) - self._point_on(other, reached.pos)
        return np.asarray(np.linalg.norm(gaps, axis=1) <= reached.within)

    def _point_on(self, body: int, pos: tuple[float, ...]) -> NDArray[np.float64]:
        """(N, 3) a point of a body, in the world."""
        origin = self.derived("xpos").reshape(self.num_envs, -1, 3)[:, body]
        axes = self.derived("xmat").reshape(self.num_envs, -1, 3, 3)[:, body]
        return np.asarray(origin + axes @ np.asarray(pos, np.float64))
