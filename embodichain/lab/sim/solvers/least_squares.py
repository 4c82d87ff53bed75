"""Damped least squares: `joint_step`, one step towards a pose, and `LeastSquares`, the search.

Environments are in the last axis, as in `chain`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.sim.solvers.chain import Chain, matmul
from embodichain.utils.arrays import contiguous, is_host, may_be_set
from embodichain.utils.math import matrix_to_quat, quat_to_matrix, quat_to_rotvec
from embodichain.utils.random import RandomStreams

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.sim.engine.api import F64, EnvIndex
    from embodichain.lab.sim.solvers.chain import Frames

__all__ = [
    "IkTargets",
    "LeastSquares",
    "clamped",
    "eliminated",
    "joint_step",
    "pose_error",
    "squared",
    "times",
    "transposed",
]

_DAMPING = 1e-8
_LONGEST_STEP = 0.5
"""Largest motion of a joint in one iteration, rad or m."""
_SHORTEST_STEP = 1e-5
"""Motion in rad or m of every joint in an iteration below which a search ends."""
_PATIENCE = 8
"""Iterations after which a search must have made progress."""
_PROGRESS = 0.9
"""Share of the squared error that they may leave at most; else the search ends."""
_SETTLED_IN_POSTURE = 1e-3
"""Like `_SHORTEST_STEP`, where a posture pulls: it does so ever more slowly."""
_POSTURE_SHARE = 0.2
"""Part of the way to the posture in one iteration."""
_ROWS = 8192
"""Searches that run together at most, where there are several for each environment."""
_ROUNDS = 3
"""Solutions of a step: after each, joints that it moves beyond a limit are fixed there."""


@dataclass(frozen=True)
class IkTargets:
    """Poses that tools are to have, in the frames of their roots.

    Attributes:
        position: (3, n) metres.
        rotation: (3, 3, n), or None: the orientation is free.
    """

    position: F64
    rotation: F64 | None

    @classmethod
    def of(cls, pos: F64, quat: F64 | None) -> IkTargets:
        """The targets of positions (n, 3) and orientations (n, 4) wxyz."""
        rotation = None if quat is None else np.moveaxis(quat_to_matrix(quat), 0, -1)
        return cls(contiguous(pos.T), rotation)

    def pick(self, which: NDArray[np.int64]) -> IkTargets:
        """The targets of some of the environments."""
        rotation = None if self.rotation is None else self.rotation[..., which]
        return IkTargets(self.position[:, which], rotation)


def pose_error(frames: Frames, target: IkTargets) -> F64:
    """(6, n) from the tool to the target: metres, then a rotation vector; (3, n) without rotation.

    The rotation vector is the logarithm of R_target R_tool^T.
    """
    shift: F64 = target.position - frames.position
    if target.rotation is None:
        return shift
    turn = matmul(target.rotation, np.swapaxes(frames.rotation, 0, 1))
    vectors = quat_to_rotvec(matrix_to_quat(np.moveaxis(turn, -1, 0)))
    return np.concatenate([shift, vectors.T])


def squared(vectors: F64) -> F64:
    """(n,) squared lengths of vectors (r, n)."""
    return _added(vectors * vectors)


def joint_step(
    error: F64, jacobian: F64, lowest: F64, highest: F64, posture: F64 | None = None
) -> F64:
    """One step of damped least squares within bounds.

    dq = v + J^T (J J^T + c I)^-1 (e - J v), c = |e|^2 / 2 + 1e-8, where v is a motion of the null
    space; the damping is T. Sugihara's ("Solvability-unconcerned inverse kinematics by the
    Levenberg-Marquardt method", IEEE Transactions on Robotics 27(5), 2011). Joints that would pass
    a bound are fixed at it, and the others compensate for them.

    Args:
        error: (r, n) of the pose.
        jacobian: (r, k, n).
        lowest: (k, n) least changes of joint positions, not above 0.
        highest: (k, n) largest changes, not below 0.
        posture: (k, n) wanted changes in the null space, or None.

    Returns:
        (k, n) changes of joint positions within the bounds.
    """
    damping = 0.5 * squared(error) + _DAMPING
    null_motion: F64 | None = None
    if posture is None:
        step = _solved(error, jacobian, damping)
    else:
        null_motion = clamped(posture, lowest, highest)
        remaining = error - times(jacobian, null_motion)
        step = null_motion + _solved(remaining, jacobian, damping)
    is_beyond = (step < lowest) | (step > highest)
    is_fixed = is_beyond
    for _ in range(_ROUNDS - 1):
        beyond: Any = slice(None)  # on a device all, where the same step is found again
        if is_host(step):
            if not may_be_set(is_beyond):
                break
            beyond = np.flatnonzero(is_beyond.any(axis=0))
        at_bound = clamped(step, lowest, highest)[:, beyond]
        columns = jacobian[..., beyond]
        free_motion = 0.0 if null_motion is None else null_motion[:, beyond]
        motion = np.where(is_fixed[:, beyond], at_bound, free_motion)
        remaining = error[:, beyond] - times(columns, motion)
        # A fixed joint has no column: the others make up for it.
        free_columns = columns * ~is_fixed[:, beyond]
        step[:, beyond] = motion + _solved(remaining, free_columns, damping[beyond])
        is_beyond = ((step < lowest) | (step > highest)) & ~is_fixed
        is_fixed = is_fixed | is_beyond
    return clamped(step, lowest, highest)


def clamped(values: F64, low: F64, high: F64) -> F64:
    """Values within bounds; cheaper than ``np.clip`` on small arrays."""
    return np.minimum(np.maximum(values, low), high)


def times(jacobian: F64, motion: F64) -> F64:
    """(r, n) J v."""
    return _added(np.swapaxes(jacobian * motion, 0, 1))


def transposed(jacobian: F64, error: F64) -> F64:
    """(k, n) J^T e."""
    return _added(jacobian * error[:, None])


def _added(parts: Iterable[F64]) -> F64:
    """The sum of arrays in their order; that of ``np.sum`` depends on their size."""
    return reduce(np.add, parts)


def _solved(error: F64, jacobian: F64, damping: F64) -> F64:
    """(k, n) J^T (J J^T + c I)^-1 e."""
    size = len(error)
    system = np.empty_like(error, shape=(size, size + 1, error.shape[1]))
    joints = np.swapaxes(jacobian, 0, 1)
    system[:, :size] = _added(joint[:, None] * joint for joint in joints)
    # All at once: one number in place takes three times as long as several.
    diagonal = system.reshape(size * (size + 1), -1)[:: size + 2]
    diagonal += damping
    system[:, size] = error
    return transposed(jacobian, eliminated(system)[:, 0])


def eliminated(system: F64) -> F64:
    """Solve systems with positive definite matrices by Gauss-Jordan elimination without pivots.

    All are solved together, and each by the same operations.

    Args:
        system: (k, k + m, n) matrices beside m right sides; changed in place.

    Returns:
        (k, m, n) solutions.
    """
    size = len(system)
    for i in range(size):
        pivot = system[i, i + 1 :] / system[i, i]
        rest = system[:, i + 1 :]
        rest -= system[:, i, None] * pivot
        system[i, i + 1 :] = pivot
    return system[:, size:]


class LeastSquares:
    """Search of joint positions by damped least squares, with restarts.

    Restarts begin at points between the joint limits. These are the same for every environment and
    every call, so that a solution depends only on the target, the initial positions and the limits.

    Args:
        chain: The chain.
        moving: (k,) joints of the chain that the search may move.
        position_tolerance: Metres.
        rotation_tolerance: Rad.
        max_iterations: Of one search.
        posture: (k,) joint positions that a redundant chain approaches, NaN for joints without
            a preference; or None.
    """

    def __init__(
        self,
        chain: Chain,
        moving: NDArray[np.int64],
        position_tolerance: float,
        rotation_tolerance: float,
        max_iterations: int,
        posture: F64 | None = None,
    ) -> None:
        self._chain = chain
        self._moving = moving
        self._position_tolerance = position_tolerance
        self._rotation_tolerance = rotation_tolerance
        self._iterations = max_iterations
        self._posture = posture

    def solve(
        self,
        start: F64,
        target: IkTargets,
        low: F64,
        high: F64,
        restarts: int,
        env_ids: EnvIndex | None,
    ) -> tuple[F64, NDArray[np.bool_]]:
        """Search from initial positions, then from other points where that fails.

        Args:
            start: (K, n) initial positions of the chain's joints.
            target: The poses.
            low: (k, n) lowest positions of the moving joints; -inf means no limit.
            high: (k, n) highest.
            restarts: Further searches after the first.
            env_ids: (n,) environments, or None for all.

        Returns:
            (K, n) joint positions, within the limits, of the first search that reaches the target,
            else of the one that comes nearest; (n,) whether the target is reached.
        """
        count = start.shape[1]
        best = start.copy()
        shortest = np.full(count, np.inf)
        reached = np.zeros(count, np.bool_)
        unsolved = np.arange(count)  # where no search has succeeded yet
        for point in self._points(restarts):
            ids = unsolved if env_ids is None else env_ids[unsolved]
            lowest = low[:, unsolved]
            highest = high[:, unsolved]
            qpos = self._initial(start[:, unsolved], point, lowest, highest)
            qpos, distance, done = self._search(
                qpos, target.pick(unsolved), low=lowest, high=highest, ids=ids
            )
            is_better = distance < shortest[unsolved]
            best[:, unsolved[is_better]] = qpos[:, is_better]
            shortest[unsolved[is_better]] = distance[is_better]
            best[:, unsolved[done]] = qpos[:, done]
            reached[unsolved[done]] = True
            unsolved = unsolved[~done]
            if not len(unsolved):
                break
        return best, reached

    def solve_all(
        self,
        start: F64,
        target: IkTargets,
        low: F64,
        high: F64,
        restarts: int,
        env_ids: EnvIndex | None,
    ) -> tuple[F64, NDArray[np.bool_]]:
        """The results of all searches of `solve`, S = 1 + restarts, whether or not one succeeds.

        Args:
            start: (K, n) initial positions of the chain's joints.
            target: The poses.
            low: (k, n) lowest positions of the moving joints; -inf means no limit.
            high: (k, n) highest.
            restarts: Further searches after the first.
            env_ids: (n,) environments, or None for all.

        Returns:
            (S, K, n) joint positions, and (S, n) whether they reach the target.
        """
        count = start.shape[1]
        points = self._points(restarts)
        together = max(1, _ROWS // max(count, 1))
        parts = [points[i : i + together] for i in range(0, len(points), together)]
        solutions = []
        reached = []
        ids = np.arange(count) if env_ids is None else env_ids
        for part in parts:
            env_of_search = np.tile(np.arange(count), len(part))
            starts = [self._initial(start.copy(), point, low, high) for point in part]
            qpos, _, done = self._search(
                np.concatenate(starts, axis=1),
                target.pick(env_of_search),
                low=low[:, env_of_search],
                high=high[:, env_of_search],
                ids=ids[env_of_search],
            )
            solutions.append(np.moveaxis(qpos.reshape(len(qpos), len(part), count), 1, 0))
            reached.append(done.reshape(len(part), count))
        return np.concatenate(solutions), np.concatenate(reached)

    def _points(self, restarts: int) -> list[F64 | None]:
        """Where searches begin: None is the initial positions, (k,) are shares of the ranges."""
        shares = RandomStreams(0, 1).uniform("restarts", (restarts, len(self._moving)))
        return [None, *shares[0]]

    def _initial(self, qpos: F64, point: F64 | None, low: F64, high: F64) -> F64:
        """(K, n) positions with which a search begins; `qpos` is changed in place."""
        if point is not None:
            first = np.where(np.isfinite(low), low, -np.pi)
            last = np.where(np.isfinite(high), high, np.pi)
            qpos[self._moving] = first + (last - first) * point[:, None]
        qpos[self._moving] = np.clip(qpos[self._moving], low, high)
        return qpos

    def _search(
        self, qpos: F64, target: IkTargets, *, low: F64, high: F64, ids: EnvIndex
    ) -> tuple[F64, F64, NDArray[np.bool_]]:
        """Run one search each, from positions `qpos`, which are changed.

        Returns:
            (K, n) joint positions, (n,) squared lengths of the pose errors, (n,) whether the
            targets are reached.
        """
        count = qpos.shape[1]
        moving = self._moving
        solution = qpos.copy()
        distance = np.empty(count)
        done = np.zeros(count, np.bool_)
        unfinished = np.arange(count)  # whose search goes on
        earlier_length = np.full(count, np.inf)
        for iteration in range(self._iterations + 1):
            frames = self._chain.frames(qpos, ids)
            error = pose_error(frames, target)
            length = squared(error)
            reached = squared(error[:3]) < self._position_tolerance**2
            if len(error) > 3:
                reached &= squared(error[3:]) < self._rotation_tolerance**2

            jacobian = self._chain.jacobian(frames)[: len(error), moving]
            moving_qpos = qpos[moving]
            lean = self._towards_posture(moving_qpos)
            step = joint_step(error, jacobian, low - moving_qpos, high - moving_qpos, posture=lean)
            longest = np.abs(step).max(axis=0)
            step = step * np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-12))

            if lean is None:
                is_over = (longest <= _SHORTEST_STEP) | reached
            else:
                # A target that is reached may still be reached in a better posture.
                is_over = longest <= _SETTLED_IN_POSTURE
            if iteration == self._iterations:
                is_over[:] = True
            elif iteration % _PATIENCE == 0 and lean is None:
                is_over |= length > _PROGRESS * earlier_length
                earlier_length = length
            solution[:, unfinished[is_over]] = qpos[:, is_over]
            distance[unfinished[is_over]] = length[is_over]
            done[unfinished[is_over]] = reached[is_over]

            goes_on = ~is_over
            if not goes_on.any():
                break
            qpos[moving] = moving_qpos + step
            if not goes_on.all():
                unfinished = unfinished[goes_on]
                ids = ids[goes_on]
                qpos = qpos[:, goes_on]
                target = target.pick(goes_on)
                low = low[:, goes_on]
                high = high[:, goes_on]
                earlier_length = earlier_length[goes_on]
        return solution, distance, done

    def _towards_posture(self, qpos: F64) -> F64 | None:
        """(k, n) a part of the way from the moving joints' positions to the posture."""
        if self._posture is None:
            return None
        return _POSTURE_SHARE * np.nan_to_num(self._posture[:, None] - qpos)
