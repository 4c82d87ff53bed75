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
    from embodichain.lab.gym.expert.arms import ControlledArm
    from embodichain.lab.gym.expert.fingers import Fingers
    from embodichain.lab.sim.engine.api import F64
    from embodichain.utils.array_types import EnvIds

    Ints = NDArray[np.int64]
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
        arm: ControlledArm,
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
        self.object: Ints = np.full(count, NOTHING, np.int64)
        self.position: F64 = np.zeros((count, 3))
        self.command: F64 = np.zeros(count)
        self._opening: F64 = np.zeros(count)
        self._resting_steps: Ints = np.zeros(count, np.int64)

    def reset(self, env_ids: EnvIds) -> None:
        """Hold nothing, and command the gripper's home."""
        self.object[env_ids] = NOTHING
        if self._gripper is not None:
            self.command[env_ids] = self._gripper.home()

    def start(self, env_ids: EnvIds, opens: bool) -> None:
        """Begin to open or to close."""
        if self._gripper is None:
            raise ValueError("there is no gripper")
        ends = self._gripper.high if opens else self._gripper.low
        self.command[env_ids] = ends[0]
        self._resting_steps[env_ids] = 0
        if opens:
            self.object[env_ids] = NOTHING

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

    def take(self, env_ids: EnvIds, target: Any) -> EnvIds:
        """Hold an object between closed fingers; return the environments where there is none."""
        opening = None if self._gripper is None else self._gripper.opening()
        empty = env_ids[:0]
        if opening is not None:
            is_empty = opening[env_ids] < _CLOSED_ON_NOTHING
            empty = env_ids[is_empty]
            env_ids = env_ids[~is_empty]
        self.object[env_ids] = self.objects.index(target)
        self.position[env_ids] = self._in_tool(target)[env_ids]
        return empty

    def find_dropped(self, is_watched: Mask) -> list[tuple[Any, EnvIds]]:
        """Return each object that was lost, with the environments.

        An object that only turned or slipped, and that fingers touch, is held where it is now: its
        `position` is set anew.

        Args:
            is_watched: (N,) environments where this matters.
        """
        lost: list[tuple[Any, EnvIds]] = []
        for number, target in enumerate(self.objects):
            holds_this = self.object == number
            if not holds_this.any():
                continue
            position = self._in_tool(target)
            moved = holds_this & (length(position - self.position) > _DROPPED_DISTANCE)
            moved &= is_watched
            candidates = np.flatnonzero(moved).tolist()
            env_ids = [env_id for env_id in candidates if not self._is_touched(env_id, number)]
            self.position[moved] = position[moved]
            if env_ids:
                lost.append((target, np.array(env_ids, np.int64)))
        return lost

    def held_bodies(self, env_id: int) -> frozenset[int]:
        """MuJoCo ids of the bodies of what is held in an environment."""
        number = self.object[env_id]
        return frozenset() if number == NOTHING else self._object_bodies[number]

    def _is_touched(self, env_id: int, number: int) -> bool:
        """Whether fingers touch an object in an environment."""
        bodies = self._object_bodies[number]
        return is_touching(self._env.sim.engine, env_id, self._finger_bodies, bodies)

    def _in_tool(self, target: Any) -> F64:
        """(N, 3) position of a target in the tool's axes."""
        position, _ = self._targets(target)
        return quat_rotate(quat_conjugate(self._path.quat), position - self._path.pos)
