"""Write the visual meshes of the bundled UR10: turned solids, one OBJ per link and colour.

Run it after changing a dimension: `python scripts/make_ur10_meshes.py [FOLDER]`. One mesh per link
and colour, because every geometry of a model costs time in every physics step. Collision shapes
are not made here: UR10.urdf has them. Dimensions are in metres, in the frames of UR10.urdf.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

FOLDER = Path(__file__).parents[1] / "embodichain/data/assets/UniversalRobots/UR10/visual"
SEGMENTS = 28
"""Of a full turn."""
ARC_SEGMENTS = 4
"""Of a rounded rim."""
LID = 0.016
"""Height of a joint's blue lid."""
SEAM = 0.003
"""Height of the dark ring below it."""

Axis = Literal["x", "y", "z"]
Point = tuple[float, float, float]
Mesh = tuple[list[Point], list[tuple[int, int, int]]]


@dataclass(frozen=True)
class Turned:
    """A cylinder with rounded rims along a coordinate axis.

    Attributes:
        part: The mesh of the link that it belongs to.
        axis: Direction of the centre line.
        lo: Where it begins along `axis`.
        hi: Where it ends along `axis`.
        radius: Its radius.
        at: The other two coordinates of the centre line, in order.
        round_lo: Radius of the rounded rim at `lo`.
        round_hi: Radius of the rounded rim at `hi`.
    """

    part: str
    axis: Axis
    lo: float
    hi: float
    radius: float
    at: tuple[float, float] = (0.0, 0.0)
    round_lo: float = 0.0
    round_hi: float = 0.0

    def profile(self) -> list[tuple[float, float]]:
        """Return the outline as (radius, height) from `lo` to `hi`."""
        low = [(self.radius - inset, self.lo + rise) for inset, rise in rim(self.round_lo)]
        high = [(self.radius - inset, self.hi - rise) for inset, rise in rim(self.round_hi)]
        return low + high[::-1]

    def place(self, radial: tuple[float, float], along: float) -> Point:
        """Return the point at `along` on the centre line, moved by `radial` across it."""
        a = self.at[0] + radial[0]
        b = self.at[1] + radial[1]
        if self.axis == "x":
            return (along, a, b)
        if self.axis == "y":
            return (a, along, b)
        return (a, b, along)


def rim(rounding: float) -> Iterator[tuple[float, float]]:
    """Yield the points of a rounded rim, as distances from the wall and from the end.

    Args:
        rounding: Radius of the arc; 0 is a sharp rim, of one point.
    """
    if not rounding:
        yield 0.0, 0.0
        return
    for i in range(ARC_SEGMENTS + 1):
        angle = 0.5 * math.pi * (i / ARC_SEGMENTS)
        inset = rounding * (1 - math.sin(angle))
        rise = rounding * (1 - math.cos(angle))
        yield inset, rise


def capped(axis: Axis, face: float, inner: float, radius: float, x: float = 0.0) -> list[Turned]:
    """Return a joint housing from `inner` to the lid whose outer face is at `face`."""
    sign = 1.0 if face > inner else -1.0
    lid = face - sign * LID
    seam = face - sign * (LID + SEAM)
    at = (x, 0.0)
    if sign > 0:
        return [
            Turned("housing", axis, inner, seam, radius, at),
            Turned("seam", axis, seam, lid, radius - 0.002, at),
            Turned("cap", axis, lid, face, radius, at, round_hi=0.009),
        ]
    return [
        Turned("housing", axis, seam, inner, radius, at),
        Turned("seam", axis, lid, seam, radius - 0.002, at),
        Turned("cap", axis, face, lid, radius, at, round_lo=0.009),
    ]


WRIST = capped("z", 0.046, -0.0535, 0.0455)
LINKS: dict[str, list[Turned]] = {
    "base": [
        Turned("housing", "z", 0.0, 0.010, 0.095, round_hi=0.002),
        Turned("housing", "z", 0.010, 0.035, 0.0755),
        Turned("seam", "z", 0.035, 0.0385, 0.0725),
        Turned("seam", "y", -0.098, -0.070, 0.010, (0.0, 0.022), round_lo=0.002),
    ],
    "shoulder": [
        *capped("z", 0.088, -0.0885, 0.0755),
        Turned("housing", "y", -0.0835, 0.0, 0.0755),
        Turned("seam", "y", -0.0865, -0.0835, 0.0725),
    ],
    "upper_arm": [
        *capped("z", 0.263, 0.0865, 0.0755),
        Turned("housing", "x", -0.125, 0.0, 0.061, (0.0, 0.178), round_lo=0.003),
        Turned("seam", "x", -0.129, -0.125, 0.056, (0.0, 0.178)),
        Turned("housing", "x", -0.50, -0.10, 0.0525, (0.0, 0.178)),
        Turned("seam", "x", -0.490, -0.486, 0.056, (0.0, 0.178)),
        Turned("housing", "x", -0.612, -0.490, 0.059, (0.0, 0.178), round_hi=0.003),
        *capped("z", 0.244, 0.1195, 0.0625, x=-0.612),
        Turned("seam", "z", 0.1165, 0.1195, 0.0595, (-0.612, 0.0)),
    ],
    "forearm": [
        *capped("z", -0.020, 0.1165, 0.0605),
        Turned("housing", "x", -0.095, 0.0, 0.0525, (0.0, 0.052), round_lo=0.003),
        Turned("seam", "x", -0.099, -0.095, 0.047, (0.0, 0.052)),
        Turned("housing", "x", -0.50, -0.07, 0.0425, (0.0, 0.052)),
        Turned("seam", "x", -0.485, -0.481, 0.0445, (0.0, 0.052)),
        Turned("housing", "x", -0.5723, -0.485, 0.0455, (0.0, 0.052), round_hi=0.002),
        *capped("z", -0.009, 0.107, 0.0455, x=-0.5723),
        Turned("seam", "z", 0.107, 0.110, 0.043, (-0.5723, 0.0)),
    ],
    "wrist_1": [
        *WRIST,
        Turned("housing", "y", -0.059, 0.0, 0.0455),
        Turned("seam", "y", -0.062, -0.059, 0.043),
    ],
    "wrist_2": [
        *WRIST,
        Turned("housing", "y", 0.0, 0.0585, 0.0455),
        Turned("seam", "y", 0.0585, 0.0615, 0.043),
    ],
    "wrist_3": [
        Turned("housing", "z", -0.0305, -0.006, 0.0455, round_hi=0.003),
        Turned("seam", "z", -0.006, 0.0, 0.0315, round_hi=0.001),
    ],
}


def turn(solid: Turned) -> Mesh:
    """Return the closed triangle mesh of one turned solid, faces counter-clockwise from outside."""
    rings = solid.profile()
    angles = [2 * math.pi * i / SEGMENTS for i in range(SEGMENTS)]
    points: list[Point] = []
    for radius, along in rings:
        for angle in angles:
            radial = (radius * math.cos(angle), radius * math.sin(angle))
            points.append(solid.place(radial, along))
    bottom = len(points)
    top = bottom + 1
    points.append(solid.place((0.0, 0.0), solid.lo))
    points.append(solid.place((0.0, 0.0), solid.hi))

    faces: list[tuple[int, int, int]] = []
    last_ring = (len(rings) - 1) * SEGMENTS
    for i in range(SEGMENTS):
        j = (i + 1) % SEGMENTS
        faces.append((bottom, j, i))
        faces.append((top, last_ring + i, last_ring + j))
        for ring in range(0, last_ring, SEGMENTS):
            above = ring + SEGMENTS
            faces.append((ring + i, ring + j, above + j))
            faces.append((ring + i, above + j, above + i))
    if solid.axis == "y":  # (x, z, y) is left-handed
        faces = [(a, c, b) for a, b, c in faces]
    return points, faces


def obj(name: str, solids: list[Turned]) -> str:
    """Return the text of an OBJ file that has all `solids`."""
    lines = [f"# Written by scripts/make_ur10_meshes.py: {name}"]
    offset = 1  # OBJ counts from one
    for solid in solids:
        points, faces = turn(solid)
        for x, y, z in points:
            lines.append(f"v {x:.5f} {y:.5f} {z:.5f}")
        for a, b, c in faces:
            lines.append(f"f {offset + a} {offset + b} {offset + c}")
        offset += len(points)
    return "\n".join(lines).replace("-0.00000", "0.00000") + "\n"


def main(folder: Path) -> None:
    """Write every mesh into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    for link, solids in LINKS.items():
        parts = dict.fromkeys(solid.part for solid in solids)
        for part in parts:
            name = f"{link}_{part}"
            text = obj(name, [solid for solid in solids if solid.part == part])
            (folder / f"{name}.obj").write_text(text, encoding="ascii")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
