"""`UrArm`: closed-form inverse kinematics of arms built like those of Universal Robots.

Environments are in the last axis, as in `chain`.
"""

from __future__ import annotations

from dataclasses import dataclass
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


@dataclass(frozen=True, eq=False)
class _Transform:
    """A constant pose, with an axis for environments.

    Attributes:
        rotation: (3, 3, 1).
        position: (3, 1) metres.
    """

    rotation: F64
    position: F64


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
        z = frames.axes[..., 0].copy()
        anchors = frames.anchors[..., 0]
        signs = np.ones(6)
        for joint in (2, 3):  # parallel axes in the same direction
            if z[joint] @ z[1] < 0:
                signs[joint] = -1.0
                z[joint] = -z[joint]

        # Is it the geometry of the family?
        are_square = all(abs(z[i] @ z[i + 1]) < _CLOSE for i in (0, 3, 4))
        are_parallel = all(np.linalg.norm(np.cross(z[1], z[i])) < _CLOSE for i in (2, 3))
        shoulder = _meeting(anchors[0], z[0], anchors[1], z[1])
        wrist = _meeting(anchors[3], z[3], anchors[4], z[4])
        centre = _meeting(anchors[4], z[4], anchors[5], z[5])
        if not are_square or not are_parallel:
            return
        if shoulder is None or wrist is None or centre is None:
            return
        # Points of axes 3 and 4 in the plane of the arm, which the shoulder is in.
        elbow = anchors[2] + ((shoulder - anchors[2]) @ z[2]) * z[2]
        forearm_end = anchors[3] + ((shoulder - anchors[3]) @ z[3]) * z[3]
        a2 = np.linalg.norm(elbow - shoulder)
        a3 = np.linalg.norm(forearm_end - elbow)
        if min(a2, a3) < _CLOSE:
            return
        d4 = (wrist - forearm_end) @ z[3]
        d5 = (centre - wrist) @ z[4]
        self.lengths = (float(a2), float(a3), float(d4), float(d5))

        # The x axes of the frames before each joint, and of the one after the last.
        base_x = np.cross(z[0], z[1])
        end_x = np.cross(z[5], z[4])
        x = [
            base_x,
            base_x,
            (elbow - shoulder) / a2,
            (forearm_end - elbow) / a3,
            np.cross(z[3], z[4]),
            end_x,
            end_x,
        ]
        zero = [_angle(x[i], x[i + 1], z[i]) for i in range(6)]
        self._signs = signs[:, None]
        self._zero = np.array(zero)[:, None]

        # The frame before joint 1 in that of the root, and the tool in the one after joint 6.
        base = np.stack([base_x, np.cross(z[0], base_x), z[0]], axis=1)
        self._base = _Transform(base[..., None], shoulder[:, None])
        to_end = np.stack([end_x, np.cross(z[5], end_x), z[5]], axis=1).T
        tool_rotation = to_end @ frames.rotation[..., 0]
        tool_position = to_end @ (frames.position[:, 0] - centre)
        self._tool = _Transform(tool_rotation[..., None], tool_position[:, None])
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
        # The frame after joint 6, in the one before joint 1: its axes x, y, z and its origin.
        to_base = np.swapaxes(self._base.rotation, 0, 1)
        turn = matmul(rotation, np.swapaxes(self._tool.rotation, 0, 1))
        centre = position - matmul(turn, self._tool.position)
        centre = matmul(to_base, centre - self._base.position)
        turn = matmul(to_base, turn)
        x6 = turn[:, 0]
        y6 = turn[:, 1]
        z6 = turn[:, 2]

        count = centre.shape[1]
        angles = np.zeros((8, 6, count))
        exist = np.zeros((8, count), np.bool_)
        radius = np.sqrt(centre[0] * centre[0] + centre[1] * centre[1])
        is_in_reach = radius >= abs(d4)
        lean = np.arcsin(np.clip(d4 / np.maximum(radius, 1e-12), -1.0, 1.0))
        heading = np.arctan2(centre[1], centre[0])
        for shoulder, first in enumerate((heading + lean, heading + (np.pi - lean))):
            c1 = np.cos(first)
            s1 = np.sin(first)
            # Components along axis 2: what joint 5 and 6 alone decide.
            x_along = x6[0] * s1 - x6[1] * c1
            y_along = y6[0] * s1 - y6[1] * c1
            z_along = z6[0] * s1 - z6[1] * c1
            sine = np.sqrt(x_along * x_along + y_along * y_along)
            for wrist, s5 in enumerate((sine, -sine)):
                fifth = np.arctan2(s5, z_along)
                sign = np.where(s5 < 0, -1.0, 1.0)
                is_determined = np.abs(s5) > _SINGULAR
                sixth = np.arctan2(-sign * y_along, sign * x_along)
                sixth = np.where(is_determined, sixth, 0.0)

                # Back from the end, over joints 6 and 5, to the three with parallel axes.
                c6 = np.cos(sixth)
                s6 = np.sin(sixth)
                x5 = x6 * c6 - y6 * s6
                y5 = x6 * s6 + y6 * c6
                x4 = x5 * np.cos(fifth) - z6 * np.sin(fifth)
                forearm_end = centre + y5 * d5  # axis 5 is -y5
                pitch = np.arctan2(x4[2], x4[0] * c1 + x4[1] * s1)

                # A triangle of upper arm and forearm, in the plane at right angles to the axes.
                across = forearm_end[0] * c1 + forearm_end[1] * s1
                up = forearm_end[2]
                cosine = (across * across + up * up - a2 * a2 - a3 * a3) / (2.0 * a2 * a3)
                bend = np.arccos(np.clip(cosine, -1.0, 1.0))
                is_possible = is_in_reach & (np.abs(cosine) <= 1.0 + 1e-12)
                for elbow, third in enumerate((bend, -bend)):
                    inner = np.arctan2(a3 * np.sin(third), a2 + a3 * np.cos(third))
                    second = np.arctan2(up, across) - inner
                    fourth = pitch - second - third
                    number = 4 * shoulder + 2 * wrist + elbow
                    angles[number] = np.stack([first, second, third, fourth, fifth, sixth])
                    exist[number] = is_possible
        return wrapped((angles - self._zero) * self._signs), exist

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
        solutions, exist = self.solutions(position, rotation)
        return ranked(solutions, exist, seed, limits=(low, high), weights=weights)


def _angle(start: F64, end: F64, axis: F64) -> float:
    """The angle from one unit vector to another about an axis."""
    return float(np.arctan2(np.cross(start, end) @ axis, start @ end))


def _meeting(p: F64, u: F64, q: F64, v: F64) -> F64 | None:
    """Where two perpendicular lines (point, direction) meet, or None."""
    on_first: F64 = p + ((q - p) @ u) * u
    on_second: F64 = q + ((p - q) @ v) * v
    if np.linalg.norm(on_first - on_second) >= _CLOSE:
        return None
    return on_first
