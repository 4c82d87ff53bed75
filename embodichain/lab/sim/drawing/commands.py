"""`ShownCommand`: a command of N environments that pictures for people show."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

__all__ = ["ShownCommand", "Tolerance"]


@dataclass(frozen=True, slots=True)
class Tolerance:
    """When a velocity is as commanded.

    Attributes:
        linear: Largest error in the plane, m/s.
        angular: Largest error of the turning rate, rad/s; None is no condition.
    """

    linear: float
    angular: float | None = None


@dataclass(frozen=True, eq=False)
class ShownCommand:
    """A command in force.

    Attributes:
        kind: What its columns are. ``velocity``: forward, left (m/s) and counter-clockwise
            (rad/s), in the heading frame of the body. ``pose``: x, y, z, qw, qx, qy, qz in the
            frame of the body.
        body: Id of the body.
        values: (N, K) the numbers; live ones are views of those of the task. Rows that are not
            finite are not known, and not shown.
        tolerance: When a velocity is green; None is never.
        height: Metres from the body's origin to the top of the robot, see `height_above`.
    """

    kind: Literal["velocity", "pose"]
    body: int
    values: Any
    tolerance: Tolerance | None = None
    height: float = 0.0

    def of_env(self, env: int) -> ShownCommand:
        """A copy with the numbers of one environment alone."""
        return replace(self, values=np.array(self.values[env : env + 1]))
