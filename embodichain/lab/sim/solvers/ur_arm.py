"""`UrArm`: closed-form inverse kinematics of arms built like those of Universal Robots.

Environments are in the last axis, as in `chain`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.sim.solvers.chain import Chain, matmul
from embodichain.lab.sim.solvers.solution_sets import ranked
from embodichain.utils.math import wrapped

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.sim.engine.api import F64

__all__ = ["UrArm"]

_CLOSE = 1e-6
"""Metres, and sines of angles: differences from the geometry that still count as equal."""
_SINGULAR = 1e-8
"""Sine of joint 5 below which joint 6 is not determined by the pose."""


class UrArm:
    """All eight solutions of an arm with six hinges and the geometry of the UR family.

    Axes 2, 3 and 4 are parallel; axes 1 and 2, 4 and 5, 5 and 6 intersect at right angles. With
    Denavit-Hartenberg frames (twists pi/2, 0, 0, pi/2, -pi/2, 0; lengths 0, a2, a3, 0, 0, 0;
    offsets 0, 0, 0, d4, d5, 0, the rest being constant transforms of base and tool) the solutions
    are those of K. P. Hawkins, "Analytic Inverse Kinematics for the Universal Robots UR-5/UR-10
    Arms" (Georgia Institute of Technology, 2013): two of the shoulder, two of the wrist, two of the
    elbow.

    Args:
        chain: The chain, in the first environment.

    Attributes:
        fits: Whether the chain has this geometry; no solutions otherwise.
        lengths: a2, a3, d4, d5 in metres.
    """

    def __init__(self, chain: Chain) -> None:
        self.fits = False
        self.lengths: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
        if len(chain.joints) == 6 and chain.hinges.all():
            self._fit(chain)

    def _fit(self, chain: Chain) -> None:
        """Find the frames at joint positions 0."""
        frames = chain.frames(np.zeros((6, 1)), np.zeros(1, np.int64))
        z, p = frames.axes[..., 0].copy(), frames.anchors[..., 0]
        signs = np.ones(6)
        for joint in (2, 3):  # parallel axes in the same direction
            if z[joint] @ z[1] < 0:
                signs[joint], z[joint] = -1.0, -z[joint]
        square = [abs(z[i] @ z[i + 1]) < _CLOSE for i in (0, 3, 4)]
        parallel = [np.linalg.norm(np.cross(z[1], z[i])) < _CLOSE for i in (2, 3)]
        meet = [_meeting(p[i], z[i], p[i + 1], z[i + 1]) for i in (0, 3, 4)]
        if not all(square) or not all(parallel) or any(point is None for point in meet):
            return
        shoulder, wrist, centre = (np.asarray(point) for point in meet)
        elbow = p[2] + ((shoulder - p[2]) @ z[2]) * z[2]
        fore = p[3] + ((shoulder - p[3]) @ z[3]) * z[3]
        a2, a3 = np.linalg.norm(elbow - shoulder), np.linalg.norm(fore - elbow)
        if min(a2, a3) < _CLOSE:
            return
        x1 = np.cross(z[0], z[1])
        x = [x1, x1, (elbow - shoulder) / a2, (fore - elbow) / a3]
        x += [np.cross(z[3], z[4]), np.cross(z[5], z[4])]
        x += [x[5]]
        angles = [_angle(x[i], x[i + 1], z[i]) for i in range(6)]
        d4, d5 = (wrist - fore) @ z[3], (centre - wrist) @ z[4]
        self.lengths = float(a2), float(a3), float(d4), float(d5)
        self._signs, self._zero = signs[:, None], np.array(angles)[:, None]
        # The frame before joint 1 and the one after joint 6, with the tool in it.
        base = np.stack([x1, np.cross(z[0], x1), z[0]], axis=1)
        end = np.stack([x[6], np.cross(z[5], x[6]), z[5]], axis=1)
        self._base = base[..., None], shoulder[:, None]
        tool = end.T @ frames.rotation[..., 0], end.T @ (frames.position[:, 0] - centre)
        self._tool = tool[0][..., None], tool[1][:, None]
        self.fits = True

    def solutions(self, position: F64, rotation: F64) -> tuple[F64, NDArray[np.bool_]]:
        """All solutions for poses in the frame of the root.

        Args:
            position: (3, n) of the tool, metres.
            rotation: (3, 3, n).

        Returns:
            (8, 6, n) joint positions in [-pi, pi), rad, finite; (8, n) whether they exist. Where
            axes 4 and 6 are parallel, joint 6 is 0 and joint 4 follows.
        """
        a2, a3, d4, d5 = self.lengths
        turn = matmul(rotation, np.swapaxes(self._tool[0], 0, 1))
        centre = position - matmul(turn, self._tool[1])
        back = np.swapaxes(self._base[0], 0, 1)
        turn, centre = matmul(back, turn), matmul(back, centre - self._base[1])
        count = centre.shape[1]
        found, exist = np.zeros((8, 6, count)), np.zeros((8, count), np.bool_)
        radius = np.sqrt(centre[0] * centre[0] + centre[1] * centre[1])
        reaches = radius >= abs(d4)
        lean = np.arcsin(np.clip(d4 / np.maximum(radius, 1e-12), -1.0, 1.0))
        heading = np.arctan2(centre[1], centre[0])
        for shoulder in (0, 1):
            first = heading + (np.pi - lean if shoulder else lean)
            c1, s1 = np.cos(first), np.sin(first)
            # Components of the tool's x, y, z along axis 2.
            along = [turn[0, i] * s1 - turn[1, i] * c1 for i in range(3)]
            for wrist in (0, 1):
                sine = np.sqrt(along[0] * along[0] + along[1] * along[1])
                sine = -sine if wrist else sine
                fifth = np.arctan2(sine, along[2])
                sign = np.where(sine < 0, -1.0, 1.0)
                determined = np.abs(sine) > _SINGULAR
                sixth = np.where(determined, np.arctan2(-sign * along[1], sign * along[0]), 0.0)
                c5, s5 = np.cos(fifth), np.sin(fifth)
                c6, s6 = np.cos(sixth), np.sin(sixth)
                x5, y5 = turn[:, 0] * c6 - turn[:, 1] * s6, turn[:, 0] * s6 + turn[:, 1] * c6
                x4 = x5 * c5 - turn[:, 2] * s5
                fore = centre + y5 * d5  # axis 5 is -y5
                across, up = fore[0] * c1 + fore[1] * s1, fore[2]
                cosine = (across * across + up * up - a2 * a2 - a3 * a3) / (2.0 * a2 * a3)
                bend = np.arccos(np.clip(cosine, -1.0, 1.0))
                whole = np.arctan2(x4[2], x4[0] * c1 + x4[1] * s1)
                possible = reaches & (np.abs(cosine) <= 1.0 + 1e-12)
                for elbow in (0, 1):
                    third = -bend if elbow else bend
                    reach = np.arctan2(a3 * np.sin(third), a2 + a3 * np.cos(third))
                    second = np.arctan2(up, across) - reach
                    number = 4 * shoulder + 2 * wrist + elbow
                    angles = [first, second, third, whole - second - third, fifth, sixth]
                    found[number], exist[number] = np.stack(angles), possible
        return wrapped((found - self._zero) * self._signs), exist

    def nearest(
        self,
        seed: F64,
        position: F64,
        rotation: F64,
        low: F64,
        high: F64,
        weights: F64,
    ) -> tuple[F64, NDArray[np.bool_]]:
        """Solutions within limits, whole turns nearest to a seed, the nearest first.

        Args:
            seed: (6, n) joint positions, rad.
            position: (3, n) of the tool.
            rotation: (3, 3, n).
            low: (6, n) limits; -inf is none.
            high: (6, n).
            weights: (6,) of the joints' squared distances from the seed.

        Returns:
            (8, 6, n) joint positions, those of solutions that do not exist being the seed's; (8, n)
            whether they exist.
        """
        found, exist = self.solutions(position, rotation)
        return ranked(found, exist, seed, (low, high), weights)


def _angle(start: F64, end: F64, axis: F64) -> float:
    """The angle from one unit vector to another about an axis."""
    return float(np.arctan2(np.cross(start, end) @ axis, start @ end))


def _meeting(p: F64, u: F64, q: F64, v: F64) -> F64 | None:
    """Where two perpendicular lines (point, direction) meet, or None."""
    on_first: F64 = p + ((q - p) @ u) * u
    on_second: F64 = q + ((p - q) @ v) * v
    return on_first if np.linalg.norm(on_first - on_second) < _CLOSE else None
