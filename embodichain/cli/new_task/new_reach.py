"""`ToolReach`: where the tool of a new task's robot can go.

A marker that the tool cannot reach is an episode that no policy ends in success.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

__all__ = ["ToolReach"]

_CLOSE = 0.1
"""Of the radius: a corner counts as reached from this distance."""
_SMALLEST = 0.01
"""m: no smaller radius is tried."""
_SMALLER = 0.9
"""Of a radius: the next one."""
_ITERATIONS = 40
_DAMPING = 1e-4
"""m^2, of damped least squares (Wampler, 1986)."""


class ToolReach:
    """Moves the tool of a robot by its joints, without dynamics.

    Args:
        model: The robot.
        data: Its initial state; kept.
        tool: "link" or "site", and its name.
        joints: (K,) names of the joints that the action moves.
        scale: (K,) the most that each moves from a pose, rad or m.

    Attributes:
        low, high: (K,) limits of the joints; infinite where there is none.
        home: (K,) their positions at first.
        axes: (3,) axes of the world along which the tool can move: two of an arm in a plane.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        tool: tuple[str, str],
        joints: list[str],
        scale: NDArray[np.float64],
    ) -> None:
        import mujoco

        self.model, self.data = model, mujoco.MjData(model)
        self.data.qpos[:] = data.qpos
        kind, name = tool
        self._site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name)
        self._body = model.body(name).id if kind == "link" else -1
        ids = [model.joint(joint).id for joint in joints]
        self._qpos, self._dofs = model.jnt_qposadr[ids], model.jnt_dofadr[ids]
        self._scale = scale
        limited = model.jnt_limited[ids].astype(bool)
        self.low = np.where(limited, model.jnt_range[ids, 0], -np.inf)
        self.high = np.where(limited, model.jnt_range[ids, 1], np.inf)
        self.home: NDArray[np.float64] = data.qpos[self._qpos].copy()
        self.axes = self._axes()

    def place(self, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3,) where the tool is with joints at `angles`, (K,), m; `data` is left there."""
        import mujoco

        self.data.qpos[self._qpos] = angles
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        places = self.data.site_xpos if self._body < 0 else self.data.xpos
        place: NDArray[np.float64] = places[self._site if self._body < 0 else self._body]
        return place.copy()

    def jacobian(self) -> NDArray[np.float64]:
        """(3, K) velocity of the tool by the joints' velocities, where `place` left it."""
        import mujoco

        jacobian = np.zeros((3, self.model.nv))
        if self._body < 0:
            mujoco.mj_jacSite(self.model, self.data, jacobian, None, self._site)
        else:
            mujoco.mj_jacBody(self.model, self.data, jacobian, None, self._body)
        return jacobian[:, self._dofs]

    def radius(self, home: NDArray[np.float64], largest: float) -> float:
        """Half of the side of the largest cube around the tool that it reaches, m.

        Reached are its corners, the middles of its edges and of its faces; a square or a line
        where the tool moves along two axes or one only.

        Args:
            home: (K,) the pose around which the action moves the joints, rad or m.
            largest: No larger radius is tried, m.

        Returns:
            The radius, m; 0 if no cube of 2 cm is reached either.
        """
        corners = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3))) * self.axes
        size = largest
        while size >= _SMALLEST:
            if all(self._misses(home, size * corner) < _CLOSE * size for corner in corners):
                return size
            size *= _SMALLER
        return 0.0

    def _axes(self) -> NDArray[np.bool_]:
        moves = np.zeros(3, bool)
        for bend in (0.0, 0.3):  # at full stretch an arm does not move along itself
            self.place(np.clip(self.home + bend * self._scale, self.low, self.high))
            moves |= np.abs(self.jacobian()).max(axis=1) > 1e-6
        return moves

    def _misses(self, home: NDArray[np.float64], offset: NDArray[np.float64]) -> float:
        """How far the tool remains from a place, m; `offset` is from where it is at `home`."""
        low = np.maximum(home - self._scale, self.low)
        high = np.minimum(home + self._scale, self.high)
        wanted = self.place(home) + offset
        angles, best = home.copy(), np.inf
        for _ in range(_ITERATIONS):
            error = wanted - self.place(angles)
            best = min(best, float(np.linalg.norm(error)))
            columns = self.jacobian()
            # Joints at an end of their range that would leave it do not take part.
            towards = columns.T @ error
            stuck = (angles <= low) & (towards < 0) | (angles >= high) & (towards > 0)
            columns = np.where(stuck, 0.0, columns)
            step = columns.T @ np.linalg.solve(columns @ columns.T + _DAMPING * np.eye(3), error)
            angles = np.clip(angles + step, low, high)
        return best
