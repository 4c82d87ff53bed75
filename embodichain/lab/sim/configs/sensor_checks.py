"""Checks of values that several configs of sensors have: numbers, directions, poses."""

from __future__ import annotations

from typing import Any

import numpy as np

from embodichain.utils.errors import Problem

__all__ = ["check_direction", "check_mount", "check_numbers"]


def check_numbers(key: str, value: Any, size: int) -> list[Problem]:
    """Return a problem unless a value is this many finite numbers."""
    array = np.asarray(value, np.float64)
    if array.shape == (size,) and np.isfinite(array).all():
        return []
    return [Problem(key, f"must be {size} finite numbers, got {value!r}")]


def check_mount(pos: Any, quat: Any) -> list[Problem]:
    """Check the pose of a sensor on its link: the keys `pos` and `quat`."""
    problems = check_numbers("pos", pos, 3) + check_numbers("quat", quat, 4)
    if not any(p.path == "quat" for p in problems) and not np.any(quat):
        problems.append(Problem("quat", "must not be zero: it is a rotation, wxyz"))
    return problems


def check_direction(key: str, value: Any) -> list[Problem]:
    """Return a problem unless a value is three finite numbers that are not all zero."""
    problems = check_numbers(key, value, 3)
    if not problems and not np.any(value):
        problems = [Problem(key, "must not be zero: it is a direction")]
    return problems
