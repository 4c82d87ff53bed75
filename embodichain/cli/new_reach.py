"""`reachable_radius`: how far from the tool a new task may place its marker.

A marker that the tool cannot reach is an episode that no policy ends in success.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

__all__ = ["reachable_radius"]

_CLOSE = 0.1
"""Of the radius: a corner counts as reached from this distance."""
_SMALLEST = 0.01
"""m: no smaller radius is tried."""
_SMALLER = 0.9
"""Of a radius: the next one."""
_ITERATIONS = 40
_DAMPING = 1e-4
"""m^2, of damped least squares (Wampler, 1986)."""


def reachable_radius(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    tool: tuple[str, str],
    joints: list[str],
    scale: NDArray[np.float64],
    radius: float,
) -> float:
    """The largest radius, at most the given one, with a cube whose corners the tool reaches.

    Args:
        model: The robot.
        data: Its initial state; kept.
        tool: "link" or "site", and its name.
        joints: (K,) names of the joints that the action moves.
        scale: (K,) the most that each moves from the initial state, rad or m.
        radius: Half of the cube's side, m.

    Returns:
        The radius, m. It is the given one if no cube of 2 cm is reached either, as by
        arms that move in a plane.
    """
    corners = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3)))
    reach = _Reach(model, data, tool, joints, scale)
    size = radius
    while size >= _SMALLEST:
        if all(reach.misses(size * corner) < _CLOSE * size for corner in corners):
            return size
        size *= _SMALLER
    return radius


class _Reach:
    """Moves the tool as close to places as the joints' ranges allow."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        tool: tuple[str, str],
        joints: list[str],
        scale: NDArray[np.float64],
    ) -> None:
        import mujoco

        self._model, self._data = model, mujoco.MjData(model)
        self._data.qpos[:] = data.qpos
        kind, name = tool
        self._site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name)
        self._body = model.body(name).id if kind == "link" else -1
        ids = [model.joint(joint).id for joint in joints]
        self._qpos, self._dofs = model.jnt_qposadr[ids], model.jnt_dofadr[ids]
        self._home = data.qpos[self._qpos].copy()
        low, high = self._home - scale, self._home + scale
        limited = model.jnt_limited[ids].astype(bool)
        limits = model.jnt_range[ids]
        self._low = np.where(limited, np.maximum(low, limits[:, 0]), low)
        self._high = np.where(limited, np.minimum(high, limits[:, 1]), high)
        self._start = self._place(self._home).copy()

    def misses(self, offset: NDArray[np.float64]) -> float:
        """How far the tool remains from a place, m; `offset` is from where it starts."""
        import mujoco

        wanted = self._start + offset
        jacobian = np.zeros((3, self._model.nv))
        angles, best = self._home.copy(), np.inf
        for _ in range(_ITERATIONS):
            error = wanted - self._place(angles)
            best = min(best, float(np.linalg.norm(error)))
            if self._body >= 0:
                mujoco.mj_jacBody(self._model, self._data, jacobian, None, self._body)
            else:
                mujoco.mj_jacSite(self._model, self._data, jacobian, None, self._site)
            # Joints at an end of their range that would leave it do not take part.
            columns = jacobian[:, self._dofs]
            towards = columns.T @ error
            stuck = (angles <= self._low) & (towards < 0) | (angles >= self._high) & (towards > 0)
            columns = np.where(stuck, 0.0, columns)
            step = columns.T @ np.linalg.solve(columns @ columns.T + _DAMPING * np.eye(3), error)
            angles = np.clip(angles + step, self._low, self._high)
        return best

    def _place(self, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3,) where the tool is, m."""
        import mujoco

        self._data.qpos[self._qpos] = angles
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        found: NDArray[np.float64] = (
            self._data.xpos[self._body] if self._body >= 0 else self._data.site_xpos[self._site]
        )
        return found
