"""Inverse kinematics by damped least squares, for many environments at once.

Each step solves (J J^T + c I) y = e and moves the joints by J^T y, where e is the pose error and
the damping c = |e|^2 / 2 + 1e-6 falls with it, so that the method is safe where no solution exists
and fast near one (T. Sugihara, "Solvability-unconcerned inverse kinematics by the
Levenberg-Marquardt method", IEEE Transactions on Robotics 27(5), 2011). A row is left alone as soon
as it is solved or does not move any more; no row's result depends on another's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.mdp._kinematics import Chain, Posture
from embodichain.lab.gym.envs.mdp._rows import norm
from embodichain.utils.math import cross

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.base import F64

__all__ = ["Reach", "solve"]

POSITION_TOLERANCE = 5e-4
"""Metres; EmbodiChain's `pos_eps`."""
ROTATION_TOLERANCE = 5e-4
"""Rad; EmbodiChain's `rot_eps`."""
MAX_ITERATIONS = 60
_DAMPING = 1e-6
_LONGEST_STEP = 0.5
"""Rad or m: no joint moves farther in one iteration."""
_SHORTEST_STEP = 1e-5
"""Rad or m: where no joint moves farther than this there is nothing nearer to the pose."""


@dataclass(frozen=True)
class Reach:
    """Which link is to be brought somewhere, and by which joints.

    Attributes:
        chain: From the root to the link.
        moving: (K,) which joints of the chain may move.
        low, high: (D,) limits of all joints of the articulation; infinite where there is none.
    """

    chain: Chain
    moving: NDArray[np.bool_]
    low: F64
    high: F64


def solve(
    reach: Reach, root_pos: F64, root_mat: F64, qpos: F64, pos: F64, mat: F64 | None
) -> tuple[F64, NDArray[np.bool_]]:
    """Look for joint positions that bring the link to a pose, from where the joints are.

    Args:
        reach: The link and the joints.
        root_pos: (n, 3) of the articulation's root.
        root_mat: (n, 3, 3).
        qpos: (n, D) where to begin.
        pos: (n, 3) wanted position.
        mat: (n, 3, 3) wanted axes; None leaves the orientation free.

    Returns:
        (n, D) joint positions within the limits, and (n,) whether they reach the pose within
        0.5 mm and 0.5 mrad.
    """
    qpos, solved = qpos.copy(), np.zeros(len(qpos), np.bool_)
    columns = reach.chain.columns[reach.moving]
    low, high = reach.low[columns], reach.high[columns]
    left = np.arange(len(qpos))
    for _ in range(MAX_ITERATIONS):
        joints = qpos[left]
        now = reach.chain.posture(root_pos[left], root_mat[left], joints)
        error, good = _error(now, pos[left], None if mat is None else mat[left])
        solved[left] = good
        step = _step(reach, now, error)
        before = joints[:, columns]
        after = np.minimum(np.maximum(before + step, low), high)
        going = ~good & (np.abs(after - before).max(axis=1) > _SHORTEST_STEP)
        left = left[going]
        if not len(left):
            break
        qpos[left[:, None], columns] = after[going]
    return qpos, solved


def _error(now: Posture, pos: F64, mat: F64 | None) -> tuple[F64, NDArray[np.bool_]]:
    """(n, 3) or (n, 6) what is missing, position first, and (n,) whether it is little enough."""
    missing = pos - now.pos
    small = norm(missing) < POSITION_TOLERANCE
    if mat is None:
        return missing, small
    turn = _rotation_vector(now.mat, mat)
    return np.concatenate([missing, turn], axis=1), small & (norm(turn) < ROTATION_TOLERANCE)


def _rotation_vector(now: F64, wanted: F64) -> F64:
    """(n, 3) axis times angle, environment's axes, that turns one frame into the other."""
    total = np.zeros((len(now), 3))
    trace = np.zeros(len(now))
    for axis in range(3):
        a, b = now[:, :, axis], wanted[:, :, axis]
        total = total + cross(a, b)
        trace = trace + a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]
    sine = 0.5 * norm(total)
    angle = np.arctan2(sine, 0.5 * (trace - 1.0))
    factor = np.divide(angle, sine, out=np.ones_like(angle), where=sine > 1e-12)
    vector: F64 = 0.5 * total * factor[:, None]
    return vector


def _step(reach: Reach, now: Posture, error: F64) -> F64:
    """(n, K') how far each moving joint goes."""
    rows = error.shape[1]
    jacobian = _jacobian(reach, now, rows)
    squares = error * error
    weight = squares[:, 0]
    for row in range(1, rows):
        weight = weight + squares[:, row]
    matrix = np.zeros((rows, rows + 1, len(error)))
    for column in jacobian:
        matrix[:, :rows] += column[:, None] * column[None, :]
    diagonal = np.arange(rows)
    matrix[diagonal, diagonal] += 0.5 * weight + _DAMPING
    matrix[:, rows] = error.T
    y = _eliminate(matrix)
    terms = jacobian * y
    moved = terms[:, 0]
    for row in range(1, rows):
        moved = moved + terms[:, row]
    moved = moved.T
    longest = np.abs(moved).max(axis=1)
    scale: F64 = np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-12))
    return moved * scale[:, None]


def _jacobian(reach: Reach, now: Posture, rows: int) -> F64:
    """(K', rows, n) how the link moves, and turns, with each moving joint."""
    axes, arms = now.axes[reach.moving], now.pos - now.anchors[reach.moving]
    slides = reach.chain.slides[reach.moving][:, None, None]
    linear = np.where(slides, axes, cross(axes, arms))
    both = [linear] if rows == 3 else [linear, np.where(slides, 0.0, axes)]
    return np.ascontiguousarray(np.concatenate(both, axis=2).transpose(0, 2, 1))


def _eliminate(matrix: F64) -> F64:
    """Solve A y = b of (A | b), (m, m + 1, n), for positive definite A: Gauss and Jordan."""
    rows = len(matrix)
    for pivot in range(rows):
        matrix[pivot] = matrix[pivot] / matrix[pivot, pivot]
        factor = matrix[:, pivot].copy()
        factor[pivot] = 0.0
        matrix -= factor[:, None] * matrix[pivot]
    solution: F64 = matrix[:, rows]
    return solution
