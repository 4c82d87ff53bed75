"""`ToolPath`: joint trajectories along straight lines of a tool, for all environments.

Positions on a line are solved by inverse kinematics. The way along it is a path parameter from 0 to
1 within limits of velocity, acceleration and jerk, by Ruckig (Berscheid and Kröger, "Jerk-limited
real-time trajectory generation with arbitrary target states", Robotics: Science and Systems XVII,
2021). No result depends on the number of environments.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.utils.math import (
    quat_conjugate,
    quat_multiply,
    quat_rotate,
    quat_to_rotvec,
    rotvec_to_quat,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.expert.arms import Arm
    from embodichain.lab.sim.engine.api import F64

__all__ = ["ToolPath", "as_place", "length"]

_WAYPOINTS = 16
"""Positions on a line that are solved by inverse kinematics."""
_LONGEST_LEAP = 0.6
"""Rad or m: a joint that moves farther between two of them has changed to another solution."""
_TOOL_SPEED, _TOOL_TURN = 1.0, 2.5
"""M/s and rad/s of the tool at most, even if the action could ask for more."""
_TOOL_ACCELERATION, _TURN_ACCELERATION = 5.0, 15.0
"""M/s^2 and rad/s^2 of the tool."""
_JOINT_ACCELERATION = 15.0
"""Rad/s^2 or m/s^2 of the joints."""
_RISE = 0.06
"""Seconds in which the acceleration reaches its limit: the limit of jerk."""
_MARGIN = 0.95
"""Share of the limits of velocity that is used."""
_SLOW = 0.02
"""M/s: what is missing is corrected only when the tool is slower."""
_CORRECTION = 0.5
"""Share of the error that is corrected in a control step."""
_LARGEST_CORRECTION = 0.05
"""M and rad."""


def length(vectors: F64) -> F64:
    """(n,) lengths of vectors (n, 3), added in a fixed order."""
    squares = vectors * vectors
    return np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2])


def as_place(pos: F64) -> str:
    """A position (3,) in messages."""
    spot = ", ".join(f"{x:.3f}" for x in pos)
    return f"({spot}) m"


class ToolPath:
    """Moves one tool in all environments.

    Args:
        arm: The arm.
        num_envs: N.
        step_dt: Seconds of a control step.

    Attributes:
        pos: (N, 3) measured position of the tool, m, in the environment's frame.
        quat: (N, 4) measured orientation.
        path_pos: (N, 3) where the tool is on its path.
        path_quat: (N, 4).
        steps: (N,) control steps of the present path.
        obstacles: Environment -> where its last line ended that could not be reached, and why.
    """

    def __init__(self, arm: Arm, num_envs: int, step_dt: float) -> None:
        self._arm, self._dt, self._count = arm, step_dt, num_envs
        self._solver = arm.term.solver
        self._free = arm.term.orientation == "free"
        width = len(self._solver.moving)
        self._joint_speeds = arm.term.joint_speeds * _MARGIN
        linear, angular = arm.term.tool_speeds
        self._speeds = min(linear * _MARGIN, _TOOL_SPEED), min(angular * _MARGIN, _TOOL_TURN)
        self._path: F64 = np.zeros((num_envs, 1, width))
        self.steps: NDArray[np.int64] = np.zeros(num_envs, np.int64)
        self._step: NDArray[np.int64] = np.zeros(num_envs, np.int64)
        self._shift: F64 = np.zeros((num_envs, 6))  # what is added to the path's pose
        self._last: F64 = np.zeros((num_envs, width))
        self._goal_pos: F64 = np.zeros((num_envs, 3))
        self._goal_quat: F64 = np.tile([1.0, 0.0, 0.0, 0.0], (num_envs, 1))
        self.pos, self.quat = self._solver.forward(arm.asset.read_qpos())
        self.path_pos, self.path_quat = self.pos.copy(), self.quat.copy()
        self._speed: F64 = np.zeros(num_envs)
        self.obstacles: dict[int, str] = {}

    def measure(self) -> None:
        """Read where the tool is."""
        before = self.pos
        self.pos, self.quat = self._solver.forward(self._arm.asset.read_qpos())
        self._speed = length(self.pos - before) / self._dt

    def rest(self, rows: NDArray[np.int64]) -> None:
        """Stay where the tool is in these environments, whose episodes begin."""
        qpos = self._arm.asset.read_qpos()[rows][:, self._solver.moving]
        self._last[rows], self._path[rows, 0] = qpos, qpos
        self.steps[rows], self._step[rows], self._shift[rows] = 1, 0, 0.0
        self.path_pos[rows], self.path_quat[rows] = self.pos[rows], self.quat[rows]
        self._goal_pos[rows], self._goal_quat[rows] = self.pos[rows], self.quat[rows]
        self._speed[rows] = 0.0

    # -- planning, once for each motion ------------------------------------------------------------

    def plan(self, rows: NDArray[np.int64], pos: F64, quat: F64, speed: float) -> NDArray[np.bool_]:
        """Plan a straight line from where the tool is on its path to a pose.

        Args:
            rows: (n,) environments.
            pos: (n, 3) m, in the environment's frame.
            quat: (n, 4).
            speed: Share of the largest speed.

        Returns:
            (n,) whether all of the line can be reached; where not, the tool stays.
        """
        line, reached = self._line(rows, pos, quat)
        times = self._timing(rows, pos, quat, line, speed)
        longest = max((len(shares) for shares in times), default=1)
        if longest > self._path.shape[1]:
            longer = np.zeros((self._count, longest, self._path.shape[2]))
            longer[:, : self._path.shape[1]] = self._path
            self._path = longer
        for row, shares, points, good in zip(rows, times, line, reached, strict=True):
            if not good:
                shares, points = np.ones(1), np.tile(self._last[row], (_WAYPOINTS + 1, 1))
            at = shares * _WAYPOINTS
            before = np.minimum(at.astype(np.int64), _WAYPOINTS - 1)
            part = (at - before)[:, None]
            path = points[before] * (1.0 - part) + points[before + 1] * part
            self._path[row, : len(path)] = path
            self.steps[row] = len(path)
        self._step[rows] = 0
        self._goal_pos[rows] = np.where(reached[:, None], pos, self.path_pos[rows])
        self._goal_quat[rows] = np.where(reached[:, None], quat, self.path_quat[rows])
        return reached

    def _line(self, rows: NDArray[np.int64], pos: F64, quat: F64) -> tuple[F64, NDArray[np.bool_]]:
        """(n, W + 1, k) joint positions on lines, and (n,) whether they reach all of them."""
        start_pos, start_quat = self.path_pos[rows], self.path_quat[rows]
        turn = quat_to_rotvec(quat_multiply(quat, quat_conjugate(start_quat)))
        seed = self._arm.asset.read_qpos()[rows].copy()
        seed[:, self._solver.moving] = self._last[rows]
        end, reached = self._inverse(rows, seed, pos, quat)
        shares = np.linspace(0.0, 1.0, _WAYPOINTS + 1)[:, None, None]
        place = start_pos + shares * (pos - start_pos)
        facing = quat_multiply(
            rotvec_to_quat(shares * turn), np.broadcast_to(start_quat, (len(shares), *quat.shape))
        )
        seeds = (seed + shares * (end - seed)).reshape(-1, seed.shape[1])
        found, there = self._inverse(
            np.tile(rows, len(shares)), seeds, place.reshape(-1, 3), facing.reshape(-1, 4)
        )
        line = found.reshape(len(shares), len(rows), -1)
        line[0] = seed
        there = there.reshape(len(shares), -1)
        there[0] = True
        reached &= there.all(axis=0) & _smooth(line)
        walk = np.flatnonzero(~reached)
        if len(walk):  # from point to point: slower, but near the previous one
            now = seed[walk]
            for i in range(1, len(shares)):
                now, arrived = self._inverse(rows[walk], now, place[i, walk], facing[i, walk])
                line[i, walk], there[i, walk] = now, arrived
            reached[walk] = there[:, walk].all(axis=0) & _smooth(line[:, walk])
        for k in np.flatnonzero(~reached):
            row = int(rows[k])
            self.obstacles[row] = self._obstacle(row, line[:, k], there[:, k], place[:, k])
        return np.moveaxis(line, 0, 1)[..., self._solver.moving], reached

    def _obstacle(self, row: int, line: F64, there: NDArray[np.bool_], place: F64) -> str:
        """Where a line ends in an environment, and which joint or distance ends it.

        Args:
            row: The environment.
            line: (W + 1, D) joint positions.
            there: (W + 1,) whether they reach the line.
            place: (W + 1, 3) points on it.
        """
        moving, names = self._solver.moving, self._solver.names
        leaps = np.abs(np.diff(line[:, moving], axis=0))
        i = 1 + int(np.argmax(~there[1:] | (leaps.max(axis=1) >= _LONGEST_LEAP)))
        where = f"after {100 * (i - 1) / (len(line) - 1):.0f} % of it, at {as_place(place[i - 1])},"
        if there[i]:
            joint = int(np.argmax(leaps[i - 1]))
            unit = "rad" if self._solver.hinges[joint] else "m"
            return f"{where} {names[joint]} would leap by {leaps[i - 1, joint]:.2f} {unit}"
        ids = np.array([row])
        low, high = (limit[:, 0] for limit in self._solver.limits(ids))
        now = line[i, moving]
        ends = np.minimum(now - low, high - now)
        missing = float(length(place[i, None] - self._solver.forward(line[i, None], ids)[0])[0])
        left = f"{1000 * missing:.0f} mm are missing at the next point"
        units = np.where(self._solver.hinges, "rad", "m")
        at_end = [
            f"{names[j]} is at its limit, {now[j]:.2f} {units[j]}"
            for j in np.flatnonzero(ends < 1e-3)
        ]
        return f"{where} {', '.join([*at_end, left])}"

    def _inverse(
        self, rows: NDArray[np.int64], seed: F64, pos: F64, quat: F64
    ) -> tuple[F64, NDArray[np.bool_]]:
        turned = None if self._free else quat
        return self._solver.inverse(seed, pos, turned, rows, restarts=False)

    def _timing(
        self, rows: NDArray[np.int64], pos: F64, quat: F64, line: F64, speed: float
    ) -> list[F64]:
        """For each line the shares of it, up to 1, at the next control steps."""
        turn = quat_to_rotvec(quat_multiply(quat, quat_conjugate(self.path_quat[rows])))
        way, angle = length(pos - self.path_pos[rows]), length(turn)
        change = np.abs(np.diff(line, axis=1)) * _WAYPOINTS  # rad or m per unit of the parameter
        bend = np.abs(np.diff(line, 2, axis=1)) * _WAYPOINTS**2
        tiny = 1e-9
        joints = change.max(axis=1)
        fastest = np.minimum(
            np.minimum(self._speeds[0] / (way + tiny), self._speeds[1] / (angle + tiny)),
            (self._joint_speeds / (joints + tiny)).min(axis=1),
        )
        # Half of the acceleration is left for the bends of the joints' path.
        most = 0.5 * _JOINT_ACCELERATION
        fastest = np.minimum(fastest, np.sqrt(most / (bend.max(axis=(1, 2)) + tiny))) * speed
        limit = np.minimum(
            np.minimum(_TOOL_ACCELERATION / (way + tiny), _TURN_ACCELERATION / (angle + tiny)),
            most / (joints.max(axis=1) + tiny),
        )
        moves = (way > 1e-6) | (angle > 1e-6)
        return [
            self._profile(*values) if there else np.ones(1)
            for there, *values in zip(moves, fastest, limit * np.sqrt(speed), strict=True)
        ]

    def _profile(self, velocity: float, acceleration: float) -> F64:
        """The path parameter after each control step, from rest at 0 to rest at 1."""
        import ruckig  # not by lazy_loader: collecting a module that is not executed yet crashes

        given = ruckig.InputParameter(1)
        given.current_position, given.target_position = [0.0], [1.0]
        given.max_velocity, given.max_acceleration = [float(velocity)], [float(acceleration)]
        given.max_jerk = [float(acceleration) / _RISE]
        trajectory: Any = ruckig.Trajectory(1)
        result = ruckig.Ruckig(1).calculate(given, trajectory)
        if result not in (ruckig.Result.Working, ruckig.Result.Finished):
            raise RuntimeError(f"Ruckig found no trajectory: {result}")
        count = max(1, int(np.ceil(trajectory.duration / self._dt - 1e-9)))
        times = np.minimum(np.arange(1, count + 1) * self._dt, trajectory.duration)
        return np.array([trajectory.at_time(float(time))[0][0] for time in times])

    def stop(self, row: int) -> None:
        """Stay at this place of the path in an environment."""
        self._path[row, 0] = self._last[row]
        self.steps[row], self._step[row] = 1, 1
        self._goal_pos[row], self._goal_quat[row] = self.pos[row], self.quat[row]

    # -- moving, in every control step -------------------------------------------------------------

    def asked(self) -> NDArray[np.bool_]:
        """(N,) whether all of the path was asked for."""
        return self._step >= self.steps

    def remaining(self) -> tuple[F64, F64]:
        """(N,) distance of the measured pose from the goal, m, and angle, rad (0 if it is free)."""
        turn = quat_to_rotvec(quat_multiply(self._goal_quat, quat_conjugate(self.quat)))
        angle = length(turn) if self._arm.term.orientation == "any" else np.zeros(self._count)
        return length(self._goal_pos - self.pos), angle

    def at_rest(self) -> NDArray[np.bool_]:
        """(N,) whether the tool hardly moves."""
        return self._speed < 2.5 * _SLOW

    def action(self, arriving: NDArray[np.bool_]) -> F64:
        """(N, A) the action for the next control step, which takes the tool along its path.

        Args:
            arriving: (N,) where it is to be corrected what is missing at the end of the path.
        """
        asked = self.asked()
        self._correct(arriving & asked & (self._speed < _SLOW))
        here = np.minimum(self._step, self.steps - 1)
        self._step += ~asked
        self._last = self._path[np.arange(self._count), here]
        whole = self._arm.asset.read_qpos().copy()
        whole[:, self._solver.moving] = self._last
        self.path_pos, self.path_quat = pos, quat = self._solver.forward(whole)
        if self._shift.any():
            error = self._in_root(self._shift)[: 3 if self._free else 6]
            widest = np.full(len(self._solver.moving), np.inf)
            step = self._solver.approach(whole, self._solver.frames(whole), error, widest)
            whole[:, self._solver.moving] += step.change
            pos, quat = self._solver.forward(whole)
        return self._arm.term.action_towards(pos, quat, whole[:, self._solver.moving])

    def _correct(self, where: NDArray[np.bool_]) -> None:
        """Ask for a part of what is missing in addition, in these environments."""
        turn = quat_to_rotvec(quat_multiply(self._goal_quat, quat_conjugate(self.quat)))
        if self._arm.term.orientation != "any":
            turn = np.zeros_like(turn)
        missing = np.concatenate([self._goal_pos - self.pos, turn], axis=1)
        shift = np.clip(
            self._shift + _CORRECTION * missing, -_LARGEST_CORRECTION, _LARGEST_CORRECTION
        )
        self._shift = np.where(where[:, None], shift, self._shift)

    def _in_root(self, shift: F64) -> F64:
        """(6, N) translations and rotations (N, 6) in the axes of the root."""
        back = quat_conjugate(self._solver.root_pose()[1])
        parts = [quat_rotate(back, np.ascontiguousarray(shift[:, c : c + 3])).T for c in (0, 3)]
        return np.concatenate(parts)


def _smooth(line: F64) -> NDArray[np.bool_]:
    """(n,) whether no joint leaps between points (W + 1, n, D)."""
    leaps = np.abs(np.diff(line, axis=0)).max(axis=(0, 2))
    return np.asarray(leaps < _LONGEST_LEAP)
