"""`find_work_areas`: where on the floor a robot's tool can work, and the pose to begin from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from embodichain.utils.random import RandomStreams

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

    from embodichain.cli.new_task.embodied_robot import EmbodiedRobot
    from embodichain.cli.new_task.new_reach import ToolFrame

    F64 = NDArray[np.float64]

__all__ = ["Layout", "WorkArea", "find_work_areas"]

_SIZES = (1.0, 0.75, 0.6, 0.5, 0.4, 0.3, 0.25)
"""Sizes of the layout that are tried, as shares of the one on the page, largest first."""
_DISTANCES = 12
"""Places of the middle of the layout that are tried, between the base and the longest reach."""
_RESTARTS = 12
_ITERATIONS = 80
_ARRIVED = 2e-3
"""m, and rad: an error that is smaller counts as none."""
_EXACT = 1e-6
"""Likewise, of a home: five joints follow a line only from where the tool points down exactly."""
_DAMPING = 1e-5
_LONGEST_STEP = 0.3
_MARGIN = 0.03
"""Share of a joint's range that is left free at both ends."""
_TURNED = 0.9
"""Least cosine between the tool's axis and straight down, for arms that cannot point it down."""


@dataclass(frozen=True)
class Layout:
    """Places at which a tool works, from the middle of the layout on the floor.

    Attributes:
        home: (3,) where the tool begins, m.
        places: (n, 3) where it has to get, m.
        clearance: Height in metres of the tool above the floor, added to all of them.
    """

    home: tuple[float, float, float]
    places: tuple[tuple[float, float, float], ...]
    clearance: float


@dataclass(frozen=True, eq=False)
class WorkArea:
    """A place on the floor at which a robot's tool can work.

    Attributes:
        x: Distance in metres of the middle of the layout from the robot's root.
        size: Size of the layout, 1 is the one on the page.
        qpos: Joint -> position in which the tool is at its home, rad or m.
        tool: (3,) the tool's home in the scene, m.
        points_down: Whether the tool's axis points down there.
    """

    x: float
    size: float
    qpos: dict[str, float]
    tool: F64
    points_down: bool


def find_work_areas(
    robot: EmbodiedRobot,
    joints: list[str],
    tool: ToolFrame,
    layout: Callable[[float], Layout],
    *,
    range_of: Callable[[list[str]], F64],
    down_only: bool,
) -> Iterator[WorkArea]:
    """Yield the work areas of a robot, the largest first, one of each size.

    Args:
        robot: The robot.
        joints: (k,) the joints that move the tool.
        tool: The tool.
        layout: Size -> the places.
        range_of: (k,) how far the action moves each joint from home, rad or m.
        down_only: Whether an arm that cannot point its tool down is left out.
    """
    arm = _Arm(robot, joints, tool)
    farthest = arm.reach()
    ranges = range_of(joints)
    for points_down in (True, False) if not down_only else (True,):
        was_found = False
        for size in _SIZES:
            areas = []
            for x in np.round(np.linspace(0.15, 1.0, _DISTANCES) * farthest, 2):
                area = _area_at(
                    arm, layout(size), size=size, x=x, ranges=ranges, is_down=points_down
                )
                if area is not None:
                    areas.append(area)
            if areas:
                was_found = True
                yield areas[len(areas) // 2]  # as far from the edges of the reach as there is
        if was_found:
            return


def _area_at(
    arm: _Arm, layout: Layout, *, size: float, x: float, ranges: F64, is_down: bool
) -> WorkArea | None:
    """The work area at a distance from the base, if all of its places are in reach there."""
    middle = np.array([x, 0.0, 0.0])
    lift = np.array([0.0, 0.0, layout.clearance])
    home = arm.to_model(middle + np.array(layout.home) + lift)
    for qpos in arm.solutions(home, is_down=is_down):
        low = np.maximum(arm.low, qpos - ranges)
        high = np.minimum(arm.high, qpos + ranges)
        if all(
            arm.gets_to(
                arm.to_model(middle + np.array(place) + lift),
                qpos,
                is_down=is_down,
                low=low,
                high=high,
            )
            for place in layout.places
        ):
            arm.place(qpos)
            return WorkArea(
                x=x,
                size=size,
                qpos=dict(zip(arm.joints, qpos.tolist(), strict=True)),
                tool=middle + np.array(layout.home) + lift,
                points_down=is_down,
            )
    return None


class _Arm:
    """The joints that move a robot's tool, without dynamics."""

    def __init__(self, robot: EmbodiedRobot, joints: list[str], tool: ToolFrame) -> None:
        import mujoco

        self.joints = joints
        self._model: mujoco.MjModel = robot.model
        self._data = mujoco.MjData(robot.model)
        self._data.qpos[:] = robot.data.qpos
        self._tool = tool
        self._shift = robot.shift
        ids = [self._model.joint(name).id for name in joints]
        self._columns = self._model.jnt_qposadr[ids]
        self._dofs = self._model.jnt_dofadr[ids]
        is_limited = self._model.jnt_limited[ids].astype(bool)
        margin = _MARGIN * (self._model.jnt_range[ids, 1] - self._model.jnt_range[ids, 0])
        self.low = np.where(is_limited, self._model.jnt_range[ids, 0] + margin, -np.pi)
        self.high = np.where(is_limited, self._model.jnt_range[ids, 1] - margin, np.pi)
        self._first = np.clip(self._data.qpos[self._columns], self.low, self.high)
        shares = RandomStreams(0, 1).uniform("work_area", (_RESTARTS, len(joints)))[0]
        self._starts = [self._first, *(self.low + (self.high - self.low) * shares)]
        self._contacts = self._touching(self._first)

    def to_model(self, place: F64) -> F64:
        """(3,) a place of the scene in the robot's model alone."""
        return place - self._shift

    def reach(self) -> float:
        """The longest distance of the tool from the root's axis that is found, m."""
        draws = RandomStreams(0, 1).uniform("reach", (200, len(self.joints)))[0]
        farthest = 0.0
        for share in draws:
            pos, _ = self.place(self.low + (self.high - self.low) * share)
            farthest = max(farthest, float(np.hypot(*(pos + self._shift)[:2])))
        return farthest

    def place(self, qpos: F64) -> tuple[F64, F64]:
        """Move the joints; returns the tool's position (3,), m, and its z axis (3,)."""
        import mujoco

        self._data.qpos[self._columns] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        element = self._data.body if self._tool.kind == "link" else self._data.site
        frame = element(self._tool.name)
        return frame.xpos.copy(), frame.xmat.reshape(3, 3)[:, 2].copy()

    def solutions(self, place: F64, *, is_down: bool) -> Iterator[F64]:
        """Yield different poses, (k,), in which the tool is at a place, m, and nothing touches."""
        found: list[F64] = []
        for start in self._starts:
            qpos = self._solve(
                place, start, is_down=is_down, low=self.low, high=self.high, tolerance=_EXACT
            )
            if qpos is None or any(np.abs(qpos - other).max() < 0.1 for other in found):
                continue
            found.append(qpos)
            if self._touching(qpos) <= self._contacts and not self._is_in_floor(qpos):
                yield qpos

    def gets_to(self, place: F64, start: F64, *, is_down: bool, low: F64, high: F64) -> bool:
        """Whether the tool gets to a place, m, from a pose (k,), with joints between bounds."""
        return self._solve(place, start, is_down=is_down, low=low, high=high) is not None

    def _solve(
        self,
        place: F64,
        start: F64,
        *,
        is_down: bool,
        low: F64,
        high: F64,
        tolerance: float = _ARRIVED,
    ) -> F64 | None:
        """The pose in which the tool is at a place, by damped least squares, or None."""
        import mujoco

        qpos = start.copy()
        body = self._body()
        for _ in range(_ITERATIONS):
            pos, axis = self.place(qpos)
            # With its axis down, the tool may turn about it: two angles count.
            turn = np.cross(axis, [0.0, 0.0, -1.0])[:2] if is_down else np.zeros(0)
            if is_down and axis[2] > 0:
                turn = turn / max(float(np.linalg.norm(turn)), 1e-3)
            error = np.concatenate([place - pos, turn])
            if float(np.abs(error).max()) < tolerance:
                return qpos
            linear = np.zeros((3, self._model.nv))
            angular = np.zeros((3, self._model.nv))
            mujoco.mj_jac(self._model, self._data, linear, angular, pos, body)
            rows = np.concatenate([linear, angular[: len(turn)]])[:, self._dofs]
            is_stuck = ((qpos <= low) & (rows.T @ error < 0)) | (
                (qpos >= high) & (rows.T @ error > 0)
            )
            rows = np.where(is_stuck, 0.0, rows)
            step = rows.T @ np.linalg.solve(rows @ rows.T + _DAMPING * np.eye(len(error)), error)
            step *= min(1.0, _LONGEST_STEP / max(float(np.abs(step).max()), 1e-9))
            qpos = np.clip(qpos + step, low, high)
        return None

    def _body(self) -> int:
        if self._tool.kind == "site":
            return int(self._model.site(self._tool.name).bodyid[0])
        return int(self._model.body(self._tool.name).id)

    def _touching(self, qpos: F64) -> set[tuple[int, int]]:
        """Pairs of shapes that touch in a pose."""
        import mujoco

        self.place(qpos)
        mujoco.mj_collision(self._model, self._data)
        contacts = self._data.contact
        return set(zip(contacts.geom1.tolist(), contacts.geom2.tolist(), strict=True))

    def _is_in_floor(self, qpos: F64) -> bool:
        """Whether a moving part is below the floor in a pose."""
        from embodichain.cli.new_task.new_home import lowest_point

        self.place(qpos)
        lowest = lowest_point(self._model, self._data) + float(self._shift[2])
        return lowest < -1e-3
