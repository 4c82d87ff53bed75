"""`Grasp`: what one arm's gripper holds, and whether its fingers still move."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.expert.targets import TargetPoses
from embodichain.lab.gym.expert.touches import is_touching
from embodichain.lab.gym.expert.trajectories import ToolPath, length
from embodichain.utils.math import quat_conjugate, quat_rotate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.expert.arms import Arm
    from embodichain.lab.gym.expert.fingers import Fingers
    from embodichain.lab.sim.engine.api import F64

    Rows = NDArray[np.int64]
    Mask = NDArray[np.bool_]

__all__ = ["NOTHING", "Grasp"]

NOTHING = -1
"""The number of what an empty gripper holds."""
_RESTING_MOTION = 0.003
"""Share of the gripper's opening: fingers that move less in a control step rest."""
_RESTING_STEPS = 2
"""Control steps after which fingers that rest have arrived."""
_CLOSED_ON_NOTHING = 0.01
"""Share of the gripper's opening that is left when it closes on nothing."""
_DROPPED_DISTANCE = 0.03
"""Metres: an object that moved farther in the gripper since it was grasped may be dropped."""


class Grasp:
    """The gripper of one arm in N environments; for an arm without one, nothing is ever held.

    Args:
        env: The environment.
        arm: The arm.
        path: Its tool, measured.
        fingers: Those of its gripper.
        objects: Everything that the steps grasp, for any arm.
        targets: Poses of the objects.

    Attributes:
        objects: See above; `object` numbers them.
        object: (N,) number of what is held, or `NOTHING`.
        position: (N, 3) where it is, in the tool's axes, when it was grasped.
        command: (N,) the gripper's action.
    """

    def __init__(
        self,
        env: BaseEnv,
        arm: Arm,
        path: ToolPath,
        fingers: Fingers,
        objects: Sequence[Any],
        targets: TargetPoses,
    ) -> None:
        count = env.num_envs
        self._env = env
        self._gripper = arm.gripper
        self._path = path
        self._finger_bodies = fingers.bodies
        self._targets = targets
        self.objects = objects
        self._object_bodies = [targets.bodies(target) for target in objects]
        self.object: Rows = np.full(count, NOTHING, np.int64)
        self.position: F64 = np.zeros((count, 3))
        self.command: F64 = np.zeros(count)
        self._opening: F64 = np.zeros(count)
        self._resting_steps: Rows = np.zeros(count, np.int64)

    def reset(self, rows: Rows) -> None:
        """Hold nothing, and command the gripper's home."""
        self.object[rows] = NOTHING
        if self._gripper is not None:
            self.command[rows] = self._gripper.home()

    def start(self, rows: Rows, opens: bool) -> None:
        """Begin to open or to close."""
        if self._gripper is None:
            raise ValueError("there is no gripper")
        ends = self._gripper.high if opens else self._gripper.low
        self.command[rows] = ends[0]
        self._resting_steps[rows] = 0
        if opens:
            self.object[rows] = NOTHING

    @property
    def is_measured(self) -> bool:
        """Whether the opening of the gripper can be read."""
        return self._gripper is not None and self._gripper.opening() is not None

    def measure(self) -> None:
        """Read the opening; count the control steps in which the fingers rested."""
        opening = None if self._gripper is None else self._gripper.opening()
        if opening is None:
            return
        rests = np.abs(opening - self._opening) < _RESTING_MOTION
        self._resting_steps = np.where(rests, self._resting_steps + 1, 0)
        self._opening = opening

    def has_come_to_rest(self) -> Mask:
        """(N,) whether the fingers no longer move."""
        return self._resting_steps >= _RESTING_STEPS

    def take(self, rows: Rows, target: Any) -> Rows:
        """Hold an object between closed fingers; return the environments where there is none."""
        opening = None if self._gripper is None else self._gripper.opening()
        empty = rows[:0]
        if opening is not None:
            is_empty = opening[rows] < _CLOSED_ON_NOTHING
            empty = rows[is_empty]
            rows = rows[~is_empty]
        self.object[rows] = self.objects.index(target)
        self.position[rows] = self._in_tool(target)[rows]
        return empty

    def dropped(self, is_watched: Mask) -> list[tuple[Any, Rows]]:
        """Return each object that was lost, with the environments.

        An object that only turned or slipped, and that fingers touch, is held where it is now.

        Args:
            is_watched: (N,) environments where this matters.
        """
        lost: list[tuple[Any, Rows]] = []
        for number, target in enumerate(self.objects):
            holds_this = self.object == number
            if not holds_this.any():
                continue
            position = self._in_tool(target)
            moved = holds_this & (length(position - self.position) > _DROPPED_DISTANCE)
            moved &= is_watched
            rows = [row for row in np.flatnonzero(moved).tolist() if not self._grips(row, number)]
            self.position[moved] = position[moved]
            if rows:
                lost.append((target, np.array(rows, np.int64)))
        return lost

    def held_bodies(self, row: int) -> frozenset[int]:
        """MuJoCo ids of the bodies of what is held in an environment."""
        number = self.object[row]
        return frozenset() if number == NOTHING else self._object_bodies[number]

    def _grips(self, row: int, number: int) -> bool:
        """Whether fingers touch an object in an environment."""
        bodies = self._object_bodies[number]
        return is_touching(self._env.sim.engine, row, self._finger_bodies, bodies)

    def _in_tool(self, target: Any) -> F64:
        """(N, 3) position of a target in the tool's axes."""
        position, _ = self._targets(target)
        return quat_rotate(quat_conjugate(self._path.quat), position - self._path.pos)
