"""Finite bounds of joint positions, for actions. Imports no torch, so that terms can."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["UNLIMITED", "finite_limits", "joint_bounds"]

UNLIMITED = 2.0 * np.pi
"""Bound of an action for a joint without a limit, rad (or m): a turn either way.

Action spaces must be finite, for learners and for random actions.
"""


def finite_limits(
    limits: ArrayLike, joint_ids: Sequence[int] | NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (A,) lowest and highest positions, rad or m; unlimited sides get +-`UNLIMITED`.

    Args:
        limits: (D, 2) joint limits, infinite where there is none.
        joint_ids: The A joints, in the order of the action.
    """
    chosen = np.asarray(limits, np.float64)[np.asarray(joint_ids, np.int64)]
    low, high = np.where(np.isfinite(chosen), chosen, [-UNLIMITED, UNLIMITED]).T
    return low, high


def joint_bounds(
    limits: ArrayLike, joint_ids: Sequence[int] | NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return `finite_limits` as action spaces hold them, in float32."""
    low, high = finite_limits(limits, joint_ids)
    return low.astype(np.float32), high.astype(np.float32)
