"""`ToolReach`: where the tool of a new task's robot can go.

A marker that the tool cannot reach is an episode that no policy ends in success.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

__all__ = ["ToolFrame", "ToolReach"]

_REACHED_SHARE = 0.1
"""Share of the radius: a corner counts as reached from this distance."""
_SMALLEST_RADIUS = 0.01
"""No smaller radius is tried, m."""
_SHRINKING = 0.9
"""The next radius to try, by the one before."""
_STRETCHED_AND_BENT = (0.0, 0.3)
"""Poses that show how a tool moves, by the joints' scale from home."""
_STILL = 1e-6
"""Velocity below which a tool does not move along an axis, m/s at 1 rad/s."""
_ITERATIONS = 40
_DAMPING = 1e-4
"""Damping of the least squares (Wampler, 1986), m^2."""


@dataclass(frozen=True, order=True)
class ToolFrame:
    """The point of a robot that has to reach the marker.

    Attributes:
        kind: Whether it is a link's origin or a site.
        name: The name of the link or site.
    """

    kind: Literal["link", "site"]
    name: str

    def pos(self, data: mujoco.MjData) -> NDArray[np.float64]:
        """(3,) where it is in a state, m, as a view of it."""
        if self.kind == "link":
            return data.body(self.name).xpos
        return data.site(self.name).xpos


class ToolReach:
    """Moves the tool of a robot by its joints, without dynamics.

    Args:
        model: The robot.
        data: Its initial state, which is copied.
        tool: The point that is moved.
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
        tool: ToolFrame,
        joints: list[str],
        scale: NDArray[np.float64],
    ) -> None:
        import mujoco

        self.model = model
        self.data = mujoco.MjData(model)
        self.data.qpos[:] = data.qpos
        self._tool = tool
        self._scale = scale
        joint_ids = [model.joint(joint).id for joint in joints]
        self._qpos_ids = model.jnt_qposadr[joint_ids]
        self._dof_ids = model.jnt_dofadr[joint_ids]
        is_limited = model.jnt_limited[joint_ids].astype(bool)
        self.low = np.where(is_limited, model.jnt_range[joint_ids, 0], -np.inf)
        self.high = np.where(is_limited, model.jnt_range[joint_ids, 1], np.inf)
        self.home: NDArray[np.float64] = data.qpos[self._qpos_ids].copy()
        self.axes = self._movable_axes()

    def place(self, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3,) where the tool is with joints at `angles`, (K,), m; `data` is left there."""
        import mujoco

        self.data.qpos[self._qpos_ids] = angles
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)  # the Jacobian needs it
        return self._tool.pos(self.data).copy()

    def jacobian(self) -> NDArray[np.float64]:
        """(3, K) velocity of the tool by the joints' velocities, where `place` left it."""
        import mujoco

        jacobian = np.zeros((3, self.model.nv))
        if self._tool.kind == "link":
            body = self.model.body(self._tool.name).id
            mujoco.mj_jacBody(self.model, self.data, jacobian, None, body)
        else:
            site = self.model.site(self._tool.name).id
            mujoco.mj_jacSite(self.model, self.data, jacobian, None, site)
        return jacobian[:, self._dof_ids]

    def radius(self, home: NDArray[np.float64], largest: float) -> float:
        """Half of the side of the largest cube around the tool that it reaches, m.

        The tool has to reach its corners, and the middles of its edges and faces. Where the tool
        moves along two axes or one only, the cube is a square or a line.

        Args:
            home: (K,) the pose around which the action moves the joints, rad or m.
            largest: No larger radius is tried, m.

        Returns:
            The radius, m; 0 if no cube of 2 cm is reached either.
        """
        corners = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3))) * self.axes
        radius = largest
        while radius >= _SMALLEST_RADIUS:
            tolerance = _REACHED_SHARE * radius
            if all(self._distance(home, radius * corner) < tolerance for corner in corners):
                return radius
            radius *= _SHRINKING
        return 0.0

    def _movable_axes(self) -> NDArray[np.bool_]:
        """(3,) axes of the world along which the tool can move."""
        is_movable = np.zeros(3, bool)
        for bend in _STRETCHED_AND_BENT:  # at full stretch an arm does not move along itself
            self.place(np.clip(self.home + bend * self._scale, self.low, self.high))
            is_movable |= np.abs(self.jacobian()).max(axis=1) > _STILL
        return is_movable

    def _distance(self, home: NDArray[np.float64], offset: NDArray[np.float64]) -> float:
        """Distance in metres between the tool and a place, after inverse kinematics.

        Args:
            home: (K,) the pose around which the action moves the joints, rad or m.
            offset: (3,) the place, from where the tool is at `home`, m.
        """
        low = np.maximum(home - self._scale, self.low)
        high = np.minimum(home + self._scale, self.high)
        goal = self.place(home) + offset
        angles = home.copy()
        smallest = np.inf
        for _ in range(_ITERATIONS):
            error = goal - self.place(angles)
            smallest = min(smallest, float(np.linalg.norm(error)))
            jacobian = self.jacobian()
            # Joints at an end of their range that would leave it do not take part.
            direction = jacobian.T @ error
            leaves_below = (angles <= low) & (direction < 0)
            leaves_above = (angles >= high) & (direction > 0)
            jacobian = np.where(leaves_below | leaves_above, 0.0, jacobian)
            damped = jacobian @ jacobian.T + _DAMPING * np.eye(3)
            step = jacobian.T @ np.linalg.solve(damped, error)
            angles = np.clip(angles + step, low, high)
        return smallest
