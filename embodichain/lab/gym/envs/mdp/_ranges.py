"""Bounds of random draws, shared by events."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.base import F64

__all__ = ["constant"]


def constant(values: Any) -> F64:
    """A float64 copy that nobody can change: streams scale many draws at once by such bounds."""
    array = np.array(values, np.float64)
    array.setflags(write=False)
    return array
