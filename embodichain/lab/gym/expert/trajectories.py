"""`ToolPath`: joint trajectories along straight lines of a tool, for all environments.

Positions on a line are solved by inverse kinematics. The way along it is a path parameter from 0 to
1 within limits of velocity, acceleration and jerk, by Ruckig (Berscheid and Kröger, "Jerk-limited
real-time trajectory generation with arbitrary target states", Robotics: Science and Systems XVII,
2021). No result depends on the number of environments.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

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

    from embodichain.lab.gym.expert.arms import ControlledArm
    from embodichain.lab.sim.engine.api import F64
    from embodichain.utils.array_types import EnvIds

__all__ = ["ToolPath", "as_place", "length"]

_WAYPOINTS = 16
"""Positions on a line that are solved by inverse kinematics."""
_LONGEST_LEAP = 0.6
"""Distance in rad or m between two of them above which a joint has changed to another solution."""
_TOOL_SPEED = 1.0
"""Largest speed of the tool, m/s, even if the action could ask for more."""
_TOOL_TURN = 2.5
"""Largest turning speed of the tool, rad/s, likewise."""
_TOOL_ACCELERATION = 5.0
"""Acceleration of the tool, m/s^2."""
_TURN_ACCELERATION = 15.0
"""Angular acceleration of the tool, rad/s^2."""
_JOINT_ACCELERATION = 15.0
"""Acceleration of the joints, rad/s^2 or m/s^2."""
_ACCELERATION_RISE = 0.06
"""Seconds in which the acceleration reaches its limit: the limit of jerk."""
_VELOCITY_MARGIN = 0.95
"""Share of the limits of velocity that is used."""
_RESTING_SPEED = 0.02
"""Speed in m/s of the tool below which a remaining error is corrected."""
_ARRIVED_SPEED = 2.5 * _RESTING_SPEED
"""Speed in m/s below which the tool has come to rest: a correction, too, moves it a little."""
_CORRECTION = 0.5
"""Share of the remaining error that is corrected in a control step."""
_LARGEST_CORRECTION = 0.05
"""Metres and rad that are added to the path's pose at most."""


def length(vectors: F64) -> F64:
    """(n,) lengths of vectors (n, 3), added in a fixed order."""
    squares = vectors * vectors
    return np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2])


def as_place(pos: F64) -> str:
    """Return a position (3,) as text, for messages."""
    coordinates = ", ".join(f"{x:.3f}" for x in pos)
    return f"({coordinates}) m"


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
        unreachable: Environment -> why its last line could not be followed, and how far it could.
    """

    def __init__(self, arm: ControlledArm, num_envs: int, step_dt: float) -> None:
        self._arm = arm
        self._dt = step_dt
        self._count = num_envs
        self._solver = arm.term.solver
        self._is_free = arm.term.orientation == "free"
        joint_range = arm.term.joint_range
        self._low = None if joint_range is None else joint_range.low
        self._high = None if joint_range is None else joint_range.high
        self._joint_speeds = arm.term.joint_speeds * _VELOCITY_MARGIN
        speed, turning_speed = arm.term.tool_speeds
        self._tool_speed = min(speed * _VELOCITY_MARGIN, _TOOL_SPEED)
        self._tool_turn = min(turning_speed * _VELOCITY_MARGIN, _TOOL_TURN)

        # Measured.
        self.pos, self.quat = self._solver.forward(arm.asset.read_qpos())
        self._speed: F64 = np.zeros(num_envs)  # of the tool, m/s

        # The path: joint positions of each control step, and how many were commanded.
        joints = len(self._solver.moving)
        self._path: F64 = np.zeros((num_envs, 1, joints))
        self.steps: NDArray[np.int64] = np.zeros(num_envs, np.int64)
        self._step: NDArray[np.int64] = np.zeros(num_envs, np.int64)
        self._last_qpos: F64 = np.zeros((num_envs, joints))
        self.path_pos = self.pos.copy()
        self.path_quat = self.quat.copy()
        self.unreachable: dict[int, str] = {}

        # Its end, and what is added to the path's pose so that the tool arrives there.
        self._goal_pos: F64 = np.zeros((num_envs, 3))
        self._goal_quat: F64 = np.tile([1.0, 0.0, 0.0, 0.0], (num_envs, 1))
        self._is_oriented = np.full(num_envs, arm.term.orientation == "any")
        self._correction: F64 = np.zeros((num_envs, 6))  # m and rad

    def measure(self) -> None:
        """Read where the tool is."""
        before = self.pos
        self.pos, self.quat = self._solver.forward(self._arm.asset.read_qpos())
        self._speed = length(self.pos - before) / self._dt

    def rest(self, env_ids: EnvIds) -> None:
        """Stay where the tool is in these environments, whose episodes begin."""
        qpos = self._arm.asset.read_qpos()[env_ids][:, self._solver.moving]
        self._last_qpos[env_ids] = qpos
        self._path[env_ids, 0] = qpos
        self.steps[env_ids] = 1
        self._step[env_ids] = 0
        self._correction[env_ids] = 0.0
        self.path_pos[env_ids] = self.pos[env_ids]
        self.path_quat[env_ids] = self.quat[env_ids]
        self._goal_pos[env_ids] = self.pos[env_ids]
        self._goal_quat[env_ids] = self.quat[env_ids]
        self._speed[env_ids] = 0.0

    # -- planning, once for each motion ------------------------------------------------------------

    def plan(
        self,
        env_ids: EnvIds,
        pos: F64,
        quat: F64,
        speed: float,
        *,
        free: bool = False,
        along: Literal["tool", "joints"] = "tool",
    ) -> NDArray[np.bool_]:
        """Plan a straight line from where the tool is on its path to a pose.

        Args:
            env_ids: (n,) environments.
            pos: (n, 3) m, in the environment's frame.
            quat: (n, 4).
            speed: Share of the largest speed.
            free: Whether any orientation will do.
            along: What moves straight: the tool, or each joint.

        Returns:
            (n,) whether all of the line can be reached; where not, the tool stays.
        """
        self._is_oriented[env_ids] = not free and self._arm.term.orientation == "any"
        if along == "joints":
            line, is_reachable = self._solve_joint_line(env_ids, pos, quat, free=free)
        else:
            line, is_reachable = self._solve_line(env_ids, pos, quat, free=free)
        timings = self._time_lines(env_ids, pos, quat, line, speed)
        self._make_room(max((len(shares) for shares in timings), default=1))
        for number, env_id in enumerate(env_ids):
            shares = timings[number]
            points = line[number]
            if not is_reachable[number]:
                shares = np.ones(1)
                points = np.tile(self._last_qpos[env_id], (_WAYPOINTS + 1, 1))
            # Joint positions between two of the points, linearly.
            place = shares * _WAYPOINTS
            before = np.minimum(place.astype(np.int64), _WAYPOINTS - 1)
            fraction = (place - before)[:, None]
            path = points[before] * (1.0 - fraction) + points[before + 1] * fraction
            self._path[env_id, : len(path)] = path
            self.steps[env_id] = len(path)
        self._step[env_ids] = 0
        self._goal_pos[env_ids] = np.where(is_reachable[:, None], pos, self.path_pos[env_ids])
        self._goal_quat[env_ids] = np.where(is_reachable[:, None], quat, self.path_quat[env_ids])
        return is_reachable

    def _make_room(self, steps: int) -> None:
        """Let paths have at least this many control steps."""
        count, length_now, joints = self._path.shape
        if steps > length_now:
            longer = np.zeros((count, steps, joints))
            longer[:, :length_now] = self._path
            self._path = longer

    def _solve_line(
        self, env_ids: EnvIds, pos: F64, quat: F64, *, free: bool
    ) -> tuple[F64, NDArray[np.bool_]]:
        """Return (n, W + 1, k) joint positions on lines, and (n,) whether they reach all of them.

        Why a line cannot be reached is stored in `unreachable`.
        """
        start_pos = self.path_pos[env_ids]
        start_quat = self.path_quat[env_ids]
        turn = quat_to_rotvec(quat_multiply(quat, quat_conjugate(start_quat)))
        start_qpos = self._arm.asset.read_qpos()[env_ids].copy()
        start_qpos[:, self._solver.moving] = self._last_qpos[env_ids]
        end_qpos, is_reachable = self._solve(env_ids, start_qpos, pos, quat, free=free)

        # All points of all lines at once, each from a guess between the solutions at the ends.
        shares = np.linspace(0.0, 1.0, _WAYPOINTS + 1)[:, None, None]
        points = start_pos + shares * (pos - start_pos)
        facing = quat_multiply(
            rotvec_to_quat(shares * turn), np.broadcast_to(start_quat, (len(shares), *quat.shape))
        )
        guesses = (start_qpos + shares * (end_qpos - start_qpos)).reshape(-1, start_qpos.shape[1])
        solutions, is_solved = self._solve(
            np.tile(env_ids, len(shares)),
            guesses,
            points.reshape(-1, 3),
            facing.reshape(-1, 4),
            free=free,
        )
        line = solutions.reshape(len(shares), len(env_ids), -1)
        line[0] = start_qpos
        is_solved = is_solved.reshape(len(shares), -1)
        is_solved[0] = True
        is_reachable &= is_solved.all(axis=0) & _smooth(line)

        # Where that fails, from point to point: slower, but near the previous one.
        retried = np.flatnonzero(~is_reachable)
        if len(retried):
            qpos = start_qpos[retried]
            for i in range(1, len(shares)):
                qpos, is_solved[i, retried] = self._solve(
                    env_ids[retried], qpos, points[i, retried], facing[i, retried], free=free
                )
                line[i, retried] = qpos
            is_reachable[retried] = is_solved[:, retried].all(axis=0) & _smooth(line[:, retried])
        for k in np.flatnonzero(~is_reachable):
            env_id = int(env_ids[k])
            self.unreachable[env_id] = self._why_unreachable(
                env_id, line[:, k], is_solved[:, k], points[:, k]
            )
        return np.moveaxis(line, 0, 1)[..., self._solver.moving], is_reachable

    def _solve_joint_line(
        self, env_ids: EnvIds, pos: F64, quat: F64, *, free: bool
    ) -> tuple[F64, NDArray[np.bool_]]:
        """Return (n, W + 1, k) joint positions that lead straight to their ends, and (n,) whether.

        The ends are the nearest joint positions that were found for the poses.
        """
        start_qpos = self._arm.asset.read_qpos()[env_ids].copy()
        start_qpos[:, self._solver.moving] = self._last_qpos[env_ids]
        orientation = None if free or self._is_free else quat
        end_qpos, is_reachable = self._inverse(start_qpos, pos, orientation, env_ids, restarts=True)
        shares = np.linspace(0.0, 1.0, _WAYPOINTS + 1)[:, None]
        start = start_qpos[:, None, self._solver.moving]
        end = end_qpos[:, None, self._solver.moving]
        for k in np.flatnonzero(~is_reachable):
            self.unreachable[int(env_ids[k])] = "no joint positions within the limits reach it"
        return start + shares * (end - start), is_reachable

    def _why_unreachable(
        self, env_id: int, line: F64, is_solved: NDArray[np.bool_], points: F64
    ) -> str:
        """Return where a line ends in an environment, and which joint or distance ends it.

        Args:
            env_id: The environment.
            line: (W + 1, D) joint positions.
            is_solved: (W + 1,) whether they reach the line.
            points: (W + 1, 3) points on it.
        """
        moving = self._solver.moving
        names = self._solver.names
        units = np.where(self._solver.hinges, "rad", "m")
        leaps = np.abs(np.diff(line[:, moving], axis=0))
        is_end = ~is_solved[1:] | (leaps.max(axis=1) >= _LONGEST_LEAP)
        last = int(np.argmax(is_end))  # the last point that can be reached
        share = 100 * last / (len(line) - 1)
        where = f"after {share:.0f} % of it, at {as_place(points[last])},"
        if is_solved[last + 1]:
            joint = int(np.argmax(leaps[last]))
            leap = f"{leaps[last, joint]:.2f} {units[joint]}"
            return f"{where} {names[joint]} would leap by {leap}"
        ids = np.array([env_id])
        low, high = (limit[:, 0] for limit in self._solver.limits(ids))
        qpos = line[last + 1, moving]
        distance_to_limit = np.minimum(qpos - low, high - qpos)
        reasons = [
            f"{names[joint]} is at its limit, {qpos[joint]:.2f} {units[joint]}"
            for joint in np.flatnonzero(distance_to_limit < 1e-3)
        ]
        tool_pos, _ = self._solver.forward(line[last + 1, None], ids)
        missing = float(length(points[last + 1, None] - tool_pos)[0])
        reasons.append(f"{1000 * missing:.0f} mm are missing at the next point")
        return f"{where} {', '.join(reasons)}"

    def _solve(
        self, env_ids: EnvIds, seed: F64, pos: F64, quat: F64, *, free: bool
    ) -> tuple[F64, NDArray[np.bool_]]:
        """Return (n, D) joint positions for poses of the tool, and (n,) whether they reach them."""
        orientation = None if free or self._is_free else quat
        return self._inverse(seed, pos, orientation, env_ids, restarts=False)

    def _inverse(
        self, seed: F64, pos: F64, quat: F64 | None, env_ids: EnvIds, *, restarts: bool
    ) -> tuple[F64, NDArray[np.bool_]]:
        """Return the same, within the action's range.

        Where only positions beyond that range reach a pose, these are the nearest within it, which
        may be near enough.
        """
        qpos, is_reached = self._solver.inverse(
            seed, pos, quat, env_ids, restarts=restarts, low=self._low, high=self._high
        )
        missed = np.flatnonzero(~is_reached)
        if self._low is not None and len(missed):
            _, is_reached[missed] = self._solver.inverse(
                seed[missed],
                pos[missed],
                None if quat is None else quat[missed],
                env_ids[missed],
                restarts=restarts,
            )
        return qpos, is_reached

    def _time_lines(
        self, env_ids: EnvIds, pos: F64, quat: F64, line: F64, speed: float
    ) -> list[F64]:
        """Return for each line the shares of it, up to 1, at the next control steps."""
        turn = quat_to_rotvec(quat_multiply(quat, quat_conjugate(self.path_quat[env_ids])))
        way = length(pos - self.path_pos[env_ids])
        angle = length(turn)
        # Derivatives of the joints' path with respect to the path parameter, which is 0 to 1.
        slope = (np.abs(np.diff(line, axis=1)) * _WAYPOINTS).max(axis=1)
        bend = (np.abs(np.diff(line, 2, axis=1)) * _WAYPOINTS**2).max(axis=(1, 2))
        # Half of the acceleration is for the bends of the joints' path, half for speeding up.
        joint_acceleration = 0.5 * _JOINT_ACCELERATION
        tiny = 1e-9
        velocity = np.minimum(
            np.minimum(self._tool_speed / (way + tiny), self._tool_turn / (angle + tiny)),
            (self._joint_speeds / (slope + tiny)).min(axis=1),
        )
        velocity = np.minimum(velocity, np.sqrt(joint_acceleration / (bend + tiny))) * speed
        acceleration = np.minimum(
            np.minimum(_TOOL_ACCELERATION / (way + tiny), _TURN_ACCELERATION / (angle + tiny)),
            joint_acceleration / (slope.max(axis=1) + tiny),
        )
        acceleration = acceleration * np.sqrt(speed)
        is_moving = (way > 1e-6) | (angle > 1e-6)
        return [
            self._time_path(velocity[k], acceleration[k]) if is_moving[k] else np.ones(1)
            for k in range(len(env_ids))
        ]

    def _time_path(self, velocity: float, acceleration: float) -> F64:
        """Return the path parameter after each control step, from rest at 0 to rest at 1."""
        import ruckig  # not by lazy_loader: collecting a module that is not executed yet crashes

        limits = ruckig.InputParameter(1)
        limits.current_position = [0.0]
        limits.target_position = [1.0]
        limits.max_velocity = [float(velocity)]
        limits.max_acceleration = [float(acceleration)]
        limits.max_jerk = [float(acceleration) / _ACCELERATION_RISE]
        trajectory: Any = ruckig.Trajectory(1)
        result = ruckig.Ruckig(1).calculate(limits, trajectory)
        if result not in (ruckig.Result.Working, ruckig.Result.Finished):
            raise RuntimeError(f"Ruckig found no trajectory: {result}")
        count = max(1, int(np.ceil(trajectory.duration / self._dt - 1e-9)))
        times = np.minimum(np.arange(1, count + 1) * self._dt, trajectory.duration)
        return np.array([trajectory.at_time(float(time))[0][0] for time in times])

    def stop(self, env_id: int) -> None:
        """Stay at this place of the path in an environment."""
        self._path[env_id, 0] = self._last_qpos[env_id]
        self.steps[env_id] = 1
        self._step[env_id] = 1
        self._goal_pos[env_id] = self.pos[env_id]
        self._goal_quat[env_id] = self.quat[env_id]

    # -- moving, in every control step -------------------------------------------------------------

    def is_at_end(self) -> NDArray[np.bool_]:
        """(N,) whether the last position of the path has been commanded."""
        return self._step >= self.steps

    def remaining(self) -> tuple[F64, F64]:
        """(N,) distance of the measured pose from the goal, m, and angle, rad (0 if it is free)."""
        turn = quat_to_rotvec(quat_multiply(self._goal_quat, quat_conjugate(self.quat)))
        angle = np.where(self._is_oriented, length(turn), 0.0)
        return length(self._goal_pos - self.pos), angle

    def at_rest(self) -> NDArray[np.bool_]:
        """(N,) whether the tool hardly moves."""
        return self._speed < _ARRIVED_SPEED

    def advance(self, is_moving: NDArray[np.bool_]) -> F64:
        """Go one control step along the path, and return the action (N, A) that commands it.

        Args:
            is_moving: (N,) where a motion is under way: there an error that remains at the end of
                the path is corrected.
        """
        is_at_end = self.is_at_end()
        self._correct(is_moving & is_at_end & (self._speed < _RESTING_SPEED))
        step = np.minimum(self._step, self.steps - 1)
        self._step += ~is_at_end
        self._last_qpos = self._path[np.arange(self._count), step]
        qpos = self._arm.asset.read_qpos().copy()
        qpos[:, self._solver.moving] = self._last_qpos
        pos, quat = self._solver.forward(qpos)
        self.path_pos = pos
        self.path_quat = quat
        if self._correction.any():
            error = self._in_root(self._correction)[: 3 if self._is_free else 6]
            unlimited = np.full(len(self._solver.moving), np.inf)
            solution = self._solver.approach(qpos, self._solver.frames(qpos), error, unlimited)
            qpos[:, self._solver.moving] += solution.change
            pos, quat = self._solver.forward(qpos)
        return self._arm.term.action_towards(pos, quat, qpos[:, self._solver.moving])

    def _correct(self, where: NDArray[np.bool_]) -> None:
        """Add a part of the remaining error to the path's pose, in these environments.

        A drive without integral gain stops short of its target, by gravity or friction: the target
        has to be moved beyond the goal until the tool is there.
        """
        turn = quat_to_rotvec(quat_multiply(self._goal_quat, quat_conjugate(self.quat)))
        turn = np.where(self._is_oriented[:, None], turn, 0.0)
        error = np.concatenate([self._goal_pos - self.pos, turn], axis=1)
        correction = np.clip(
            self._correction + _CORRECTION * error, -_LARGEST_CORRECTION, _LARGEST_CORRECTION
        )
        self._correction = np.where(where[:, None], correction, self._correction)

    def _in_root(self, correction: F64) -> F64:
        """(6, N) translations and rotations (N, 6) in the axes of the root."""
        _, root_quat = self._solver.root_pose()
        to_root = quat_conjugate(root_quat)
        translation = quat_rotate(to_root, np.ascontiguousarray(correction[:, :3]))
        rotation = quat_rotate(to_root, np.ascontiguousarray(correction[:, 3:]))
        return np.concatenate([translation.T, rotation.T])


def _smooth(line: F64) -> NDArray[np.bool_]:
    """(n,) whether no joint leaps between points (W + 1, n, D)."""
    leaps = np.abs(np.diff(line, axis=0)).max(axis=(0, 2))
    return np.asarray(leaps < _LONGEST_LEAP)
