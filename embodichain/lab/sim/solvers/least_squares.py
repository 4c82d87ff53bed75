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
from embodichain.utils.arrays import contiguous, is_host
from embodichain.utils.math import matrix_to_quat, quat_to_matrix, quat_to_rotvec
from embodichain.utils.random import RandomStreams

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.sim.engine.api import F64, EnvIndex
    from embodichain.lab.sim.solvers.chain import Frames

__all__ = [
    "LeastSquares",
    "Target",
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
_PATIENCE, _PROGRESS = 8, 0.9
"""A search ends when this many iterations leave more than this share of the squared error."""
_ROWS = 8192
"""Searches that run together at most, where there are several for each environment."""
_ROUNDS = 3
"""Solutions of a step: after each, joints that it moves beyond a limit are fixed there."""


@dataclass(frozen=True)
class Target:
    """Poses in the frame of the root.

    Attributes:
        position: (3, n) metres.
        rotation: (3, 3, n), or None: the orientation is free.
    """

    position: F64
    rotation: F64 | None

    @classmethod
    def of(cls, pos: F64, quat: F64 | None) -> Target:
        """The targets of positions (n, 3) and orientations (n, 4) wxyz."""
        turned = None if quat is None else np.moveaxis(quat_to_matrix(quat), 0, -1)
        return cls(contiguous(pos.T), turned)

    def rows(self, which: NDArray[np.int64]) -> Target:
        """The targets of some of the environments."""
        turned = None if self.rotation is None else self.rotation[..., which]
        return Target(self.position[:, which], turned)


def pose_error(frames: Frames, target: Target) -> F64:
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
    wanted = np.zeros_like(lowest)
    if posture is None:
        step = _solved(error, jacobian, damping)
    else:
        wanted = clamped(posture, lowest, highest)
        step = wanted + _solved(error - times(jacobian, wanted), jacobian, damping)
    fixed = beyond = (step < lowest) | (step > highest)
    for _ in range(_ROUNDS - 1):
        rows: Any = slice(None)  # on a device all, where the same step is found again
        if is_host(step):
            rows = np.flatnonzero(beyond.any(axis=0))
            if not len(rows):
                break
        bounded, columns = clamped(step, lowest, highest)[:, rows], jacobian[..., rows]
        motion = np.where(fixed[:, rows], bounded, wanted[:, rows])
        left = error[:, rows] - times(columns, motion)
        step[:, rows] = motion + _solved(left, columns * ~fixed[:, rows], damping[rows])
        beyond = ((step < lowest) | (step > highest)) & ~fixed
        fixed = fixed | beyond
    return clamped(step, lowest, highest)


def clamped(values: F64, low: F64, high: F64) -> F64:
    """Values within bounds; cheaper than ``np.clip`` on small arrays."""
    found: F64 = np.minimum(np.maximum(values, low), high)
    return found


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
    for i in range(size):
        system[i, i] += damping
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
        system[:, i + 1 :] -= system[:, i, None] * pivot
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
        self._chain, self._moving = chain, moving
        self._tolerances = position_tolerance, rotation_tolerance
        self._iterations = max_iterations
        self._posture = posture

    def solve(
        self,
        start: F64,
        target: Target,
        low: F64,
        high: F64,
        restarts: int,
        env_ids: EnvIndex | None,
    ) -> tuple[F64, NDArray[np.bool_]]:
        """Search from initial positions, then from other points where that fails.

        Args:
            start: (K, n) initial positions of the chain's joints.
            target: The poses.
            low: (k, n) lowest positions of the moving joints; -inf is no limit.
            high: (k, n) highest.
            restarts: Further searches after the first.
            env_ids: (n,) environments, or None for all.

        Returns:
            (K, n) joint positions, within the limits, of the first search that reaches the target,
            else of the one that comes nearest; (n,) whether the target is reached.
        """
        count = start.shape[1]
        best, nearest = start.copy(), np.full(count, np.inf)
        reached = np.zeros(count, np.bool_)
        left = np.arange(count)
        for point in self._points(restarts):
            ids = left if env_ids is None else env_ids[left]
            least, most = low[:, left], high[:, left]
            qpos = self._initial(start[:, left], point, least, most)
            found, distance, done = self._search(qpos, target.rows(left), least, most, ids)
            better = distance < nearest[left]
            best[:, left[better]], nearest[left[better]] = found[:, better], distance[better]
            best[:, left[done]], reached[left[done]] = found[:, done], True
            left = left[~done]
            if not len(left):
                break
        return best, reached

    def solve_all(
        self,
        start: F64,
        target: Target,
        low: F64,
        high: F64,
        restarts: int,
        env_ids: EnvIndex | None,
    ) -> tuple[F64, NDArray[np.bool_]]:
        """The results of all searches of `solve`, S = 1 + restarts, whether or not one succeeds.

        Args:
            start: (K, n) initial positions of the chain's joints.
            target: The poses.
            low: (k, n) lowest positions of the moving joints; -inf is no limit.
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
        found, reached = [], []
        rows = np.arange(count)
        ids = rows if env_ids is None else env_ids
        for part in parts:
            every = np.tile(rows, len(part))
            starts = [self._initial(start.copy(), point, low, high) for point in part]
            qpos, _, done = self._search(
                np.concatenate(starts, axis=1),
                target.rows(every),
                low[:, every],
                high[:, every],
                ids[every],
            )
            found.append(np.moveaxis(qpos.reshape(len(qpos), len(part), count), 1, 0))
            reached.append(done.reshape(len(part), count))
        return np.concatenate(found), np.concatenate(reached)

    def _points(self, restarts: int) -> list[F64 | None]:
        """Where searches begin: None is the initial positions, (k,) are shares of the ranges."""
        drawn = RandomStreams(0, 1).uniform("restarts", (restarts, len(self._moving)))
        return [None, *drawn[0]]

    def _initial(self, qpos: F64, point: F64 | None, low: F64, high: F64) -> F64:
        """(K, n) positions with which a search begins; `qpos` is changed in place."""
        if point is not None:
            first = np.where(np.isfinite(low), low, -np.pi)
            last = np.where(np.isfinite(high), high, np.pi)
            qpos[self._moving] = first + (last - first) * point[:, None]
        qpos[self._moving] = np.clip(qpos[self._moving], low, high)
        return qpos

    def _search(
        self, qpos: F64, target: Target, low: F64, high: F64, ids: EnvIndex
    ) -> tuple[F64, F64, NDArray[np.bool_]]:
        """Joint positions (K, n), lengths of the pose errors (n,), and whether they are reached."""
        count, moving = qpos.shape[1], self._moving
        found, distance = qpos.copy(), np.empty(count)
        done = np.zeros(count, np.bool_)
        rows = np.arange(count)
        earlier = np.full(count, np.inf)
        for iteration in range(self._iterations + 1):
            frames = self._chain.frames(qpos, ids)
            error = pose_error(frames, target)
            length = squared(error)
            reached = squared(error[:3]) < self._tolerances[0] ** 2
            if len(error) > 3:
                reached &= squared(error[3:]) < self._tolerances[1] ** 2
            jacobian = self._chain.jacobian(frames)[: len(error), moving]
            now = qpos[moving]
            lean = self._towards_posture(now)
            step = joint_step(error, jacobian, low - now, high - now, lean)
            longest = np.abs(step).max(axis=0)
            step = step * np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-12))
            settled = longest <= (_SHORTEST_STEP if lean is None else 1e-3)
            over = settled | (reached if lean is None else False)
            if iteration == self._iterations:
                over[:] = True
            elif iteration % _PATIENCE == 0 and lean is None:
                over |= length > _PROGRESS * earlier
                earlier = length
            found[:, rows[over]], distance[rows[over]] = qpos[:, over], length[over]
            done[rows[over]] = reached[over]
            go = ~over
            if not go.any():
                break
            qpos[moving] = now + step
            if not go.all():
                rows, ids, qpos, target = rows[go], ids[go], qpos[:, go], target.rows(go)
                low, high, earlier = low[:, go], high[:, go], earlier[go]
        return found, distance, done

    def _towards_posture(self, qpos: F64) -> F64 | None:
        """(k, n) a part of the way from the moving joints' positions to the posture."""
        if self._posture is None:
            return None
        return 0.2 * np.nan_to_num(self._posture[:, None] - qpos)
