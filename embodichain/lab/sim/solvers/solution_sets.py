"""Several solutions of inverse kinematics: `ranked` orders them, `distinct` drops repetitions.

Solutions are in the first axis and environments in the last, as in `chain`; no result depends on
the number of environments.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.sim.engine.api import F64

__all__ = ["distinct", "ranked"]

_CLOSE = 1e-6
"""Distance in rad or m beyond a limit at which a position is still at it."""
_SAME = 0.01
"""Difference in rad or m of each joint below which two solutions are the same."""


def ranked(
    found: F64,
    exist: NDArray[np.bool_],
    seed: F64,
    limits: tuple[F64, F64],
    weights: F64,
    hinges: NDArray[np.bool_] | None = None,
) -> tuple[F64, NDArray[np.bool_]]:
    """Solutions within limits, whole turns nearest to a seed, the nearest first.

    Args:
        found: (S, k, n) joint positions, rad or m.
        exist: (S, n) whether they are solutions.
        seed: (k, n) joint positions.
        limits: Lowest and highest positions, (k, n) each; infinite ones are none.
        weights: (k,) of the joints' squared distances from the seed.
        hinges: (k,) whether a joint is a hinge, not a slide; None: all are.

    Returns:
        (S, k, n) joint positions, those of solutions that do not exist being the seed's; (S, n)
        whether they exist.
    """
    low, high = limits
    turned = found + 2.0 * np.pi * np.round((seed - found) / (2.0 * np.pi))
    # Whole turns back into the limits, where the nearest one is outside. A limit may be infinite:
    # it is replaced where it is not needed, since inf - inf is NaN.
    is_over = turned > high + _CLOSE
    is_under = turned < low - _CLOSE
    turns_up = np.ceil((np.where(is_under, low, 0.0) - turned) / (2.0 * np.pi))
    turns_down = np.ceil((turned - np.where(is_over, high, 0.0)) / (2.0 * np.pi))
    turned = turned + 2.0 * np.pi * (
        np.where(is_under, turns_up, 0.0) - np.where(is_over, turns_down, 0.0)
    )
    if hinges is not None:
        turned = np.where(hinges[:, None], turned, found)
    is_inside = (turned >= low - _CLOSE) & (turned <= high + _CLOSE)
    exist = exist & is_inside.all(axis=1)
    turned = np.clip(turned, low, high)
    distance = np.zeros(exist.shape)
    for joint, weight in enumerate(weights):
        offset = turned[:, joint] - seed[joint]
        distance = distance + weight * (offset * offset)
    order = np.argsort(np.where(exist, distance, np.inf), axis=0, kind="stable")
    return _ordered(turned, exist, order, seed)


def distinct(found: F64, exist: NDArray[np.bool_], seed: F64) -> tuple[F64, NDArray[np.bool_]]:
    """The first of solutions that are the same, in their order.

    Args:
        found: (S, k, n) joint positions.
        exist: (S, n) whether they are solutions.
        seed: (k, n) joint positions, of what is left out.

    Returns:
        As of `ranked`.
    """
    is_first = exist.copy()
    for i in range(1, len(found)):
        difference = np.abs(found[:i] - found[i]).max(axis=1)
        is_first[i] &= ~((difference <= _SAME) & is_first[:i]).any(axis=0)
    return _ordered(found, is_first, np.argsort(~is_first, axis=0, kind="stable"), seed)


def _ordered(
    found: F64, exist: NDArray[np.bool_], order: NDArray[Any], seed: F64
) -> tuple[F64, NDArray[np.bool_]]:
    """Solutions in an order (S, n); the seed in place of those that do not exist."""
    exist = np.take_along_axis(exist, order, axis=0)
    found = np.take_along_axis(found, order[:, None], axis=0)
    return np.where(exist[:, None], found, seed), exist
