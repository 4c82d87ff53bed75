"""Write the visual meshes of the bundled UR10: turned solids, one OBJ per link and colour.

Run it after changing a dimension: `python scripts/make_ur10_meshes.py [FOLDER]`. One mesh per link
and colour, because every geometry of a model costs time in every physics step. Collision shapes
are not here; they stand in UR10.urdf. Dimensions are in metres, in the frames of UR10.urdf.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

FOLDER = Path(__file__).parents[1] / "embodichain/data/assets/UniversalRobots/UR10/visual"
SEGMENTS = 28  # of a full turn
LID = 0.016  # height of a joint's blue lid
SEAM = 0.003  # height of the dark ring below it

Axis = Literal["x", "y", "z"]
Point = tuple[float, float, float]
Mesh = tuple[list[Point], list[tuple[int, int, int]]]


@dataclass(frozen=True)
class Turned:
    """A cylinder with rounded rims along a coordinate axis.

    Attributes:
        part: Which of the link's meshes it belongs to.
        axis: Direction of the centre line.
        lo: Where it begins along `axis`.
        hi: Where it ends along `axis`.
        radius: Its radius.
        at: Where the centre line lies: the other two coordinates, in order.
        round_lo: Rounding of the rim at `lo`.
        round_hi: Rounding of the rim at `hi`.
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
        """Return the rim as (radius, height) from `lo` to `hi`."""

        def arc(rounding: float) -> Iterator[tuple[float, float]]:
            steps = 4 if rounding else 0
            for i in range(steps + 1):
                angle = 0.5 * math.pi * (i / steps if steps else 0.0)
                yield rounding * (1 - math.sin(angle)), rounding * (1 - math.cos(angle))

        low = [(self.radius - inset, self.lo + rise) for inset, rise in arc(self.round_lo)]
        high = [(self.radius - inset, self.hi - rise) for inset, rise in arc(self.round_hi)]
        return low + high[::-1]

    def place(self, radial: tuple[float, float], along: float) -> Point:
        """Return the point at `along` on the centre line, moved by `radial` across it."""
        a, b = self.at[0] + radial[0], self.at[1] + radial[1]
        return {"x": (along, a, b), "y": (a, along, b), "z": (a, b, along)}[self.axis]


def capped(axis: Axis, face: float, inner: float, radius: float, x: float = 0.0) -> list[Turned]:
    """Return a joint housing from `inner` to the lid whose outer face is at `face`."""
    sign = 1.0 if face > inner else -1.0
    lid, seam = face - sign * LID, face - sign * (LID + SEAM)

    def span(part: str, start: float, end: float, r: float, rim: float = 0.0) -> Turned:
        at = (x, 0.0)
        if sign > 0:
            return Turned(part, axis, start, end, r, at, round_hi=rim)
        return Turned(part, axis, end, start, r, at, round_lo=rim)

    return [
        span("housing", inner, seam, radius),
        span("seam", seam, lid, radius - 0.002),
        span("cap", lid, face, radius, rim=0.009),
    ]


WRIST = [*capped("z", 0.046, -0.0535, 0.0455)]
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
    points = [
        solid.place((r * math.cos(t), r * math.sin(t)), along)
        for r, along in rings
        for t in (2 * math.pi * i / SEGMENTS for i in range(SEGMENTS))
    ]
    bottom, top = len(points), len(points) + 1
    points += [solid.place((0.0, 0.0), solid.lo), solid.place((0.0, 0.0), solid.hi)]
    faces = []
    last = (len(rings) - 1) * SEGMENTS
    for i in range(SEGMENTS):
        j = (i + 1) % SEGMENTS
        faces += [(bottom, j, i), (top, last + i, last + j)]
        for k in range(0, last, SEGMENTS):
            faces += [(k + i, k + j, k + SEGMENTS + j), (k + i, k + SEGMENTS + j, k + SEGMENTS + i)]
    if solid.axis == "y":  # (x, z, y) is left-handed
        faces = [(a, c, b) for a, b, c in faces]
    return points, faces


def obj(name: str, solids: list[Turned]) -> str:
    """Return the text of an OBJ file that holds all `solids`."""
    lines = [f"# Written by scripts/make_ur10_meshes.py: {name}"]
    offset = 1  # OBJ counts from one
    for points, faces in map(turn, solids):
        lines += ["v " + " ".join(f"{value + 0.0:.5f}" for value in p) for p in points]
        lines += ["f " + " ".join(str(offset + index) for index in face) for face in faces]
        offset += len(points)
    return "\n".join(lines).replace("-0.00000", "0.00000") + "\n"


def main(folder: Path) -> None:
    """Write every mesh into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    for link, solids in LINKS.items():
        for part in dict.fromkeys(solid.part for solid in solids):
            name = f"{link}_{part}"
            text = obj(name, [solid for solid in solids if solid.part == part])
            (folder / f"{name}.obj").write_text(text, encoding="ascii")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
