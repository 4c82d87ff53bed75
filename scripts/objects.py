"""Writes the meshes of `conf/object/`: `python scripts/objects.py` into embodichain/data/assets.

Each mesh consists of convex pieces that share no corners, so that `collision: pieces` splits it.
The origin is the middle of its height. Lengths are metres.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

__all__ = ["meshes", "text_of"]

ASSETS = Path(__file__).parents[1] / "embodichain" / "data" / "assets" / "Objects"
SEGMENTS = 24
"""Pieces around a ring."""
SHRINKING = 1e-4
"""Share by which a piece is smaller than its place, so that neighbours share no corners."""

Points = NDArray[np.float64]


def main() -> None:
    """Write all files."""
    ASSETS.mkdir(parents=True, exist_ok=True)
    for name, pieces in meshes().items():
        (ASSETS / f"{name}.obj").write_text(text_of(pieces), encoding="ascii")


def meshes() -> dict[str, list[Points]]:
    """Return the corners of each mesh's pieces, (V, 3) each, by name."""
    return {
        "mug": _mug(),
        "bowl": _bowl(),
        "plate": _plate(),
        "bottle": _bottle(),
        "box": _open_box((0.2, 0.15, 0.09), wall=0.006),
        "lid": _lid(),
        "bin": _open_box((0.32, 0.24, 0.12), wall=0.01),
        "shelf": _shelf(),
    }


def text_of(pieces: Sequence[Points]) -> str:
    """Return an OBJ file of convex pieces."""
    lines: list[str] = []
    corners = 0
    for piece in pieces:
        middle = piece.mean(axis=0)
        smaller_piece = middle + (1.0 - SHRINKING) * (piece - middle)
        hull = ConvexHull(smaller_piece)
        for x, y, z in smaller_piece.tolist():
            lines.append(f"v {x:.7f} {y:.7f} {z:.7f}")
        for triangle, plane in zip(hull.simplices, hull.equations, strict=True):
            a, b, c = smaller_piece[triangle]
            is_outwards = np.dot(np.cross(b - a, c - a), plane[:3]) > 0
            order = triangle if is_outwards else triangle[::-1]
            numbers = (order + corners + 1).tolist()
            lines.append("f " + " ".join(map(str, numbers)))
        corners += len(piece)
    return "\n".join(lines) + "\n"


# ----------------------------------------------------------------------------------------- things


def _mug() -> list[Points]:
    bottom, top = -0.045, 0.045
    floor = bottom + 0.006
    wall = [(0.036, 0.04, floor), (0.036, 0.04, top)]
    # The handle is a half circle about the y axis, in the plane of x and z.
    return [_disc(0.04, bottom, floor), *_ring(wall), *_handle(x=0.039, radius=0.028)]


def _handle(
    x: float, radius: float, thickness: float = 0.008, width: float = 0.012
) -> list[Points]:
    angles = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 7)
    radii = (radius - 0.5 * thickness, radius + 0.5 * thickness)
    pieces = []
    for start, end in zip(angles[:-1], angles[1:], strict=True):
        corners = [
            (x + r * math.cos(angle), y, r * math.sin(angle))
            for angle in (start, end)
            for r in radii
            for y in (-0.5 * width, 0.5 * width)
        ]
        pieces.append(np.array(corners))
    return pieces


def _bowl() -> list[Points]:
    bottom, top = -0.03, 0.03
    floor = bottom + 0.005
    wall = [(0.04, 0.045, floor), (0.064, 0.069, floor + 0.025), (0.075, 0.08, top)]
    return [_disc(0.045, bottom, floor), *_ring(wall)]


def _plate() -> list[Points]:
    bottom, top = -0.01, 0.01
    floor = bottom + 0.006
    return [_disc(0.07, bottom, floor), *_rim(0.0695, 0.11, bottom, floor, top)]


def _rim(inner: float, outer: float, bottom: float, floor: float, top: float) -> list[Points]:
    """A ring that rises outwards."""
    thickness = floor - bottom
    pieces = []
    for start, end in _angles():
        corners = []
        for radius, low in ((inner, bottom), (outer, top - thickness)):
            for z in (low, low + thickness):
                corners += [_on_circle(radius, start, z), _on_circle(radius, end, z)]
        pieces.append(np.array(corners))
    return pieces


def _bottle() -> list[Points]:
    bottom, shoulder, neck, top = -0.1, 0.03, 0.06, 0.1
    return [
        _disc(0.032, bottom, shoulder),
        _disc(0.032, shoulder, neck, upper_radius=0.013),
        _disc(0.013, neck, top),
    ]


def _open_box(size: tuple[float, float, float], wall: float) -> list[Points]:
    length, width, height = size
    half_height = 0.5 * height
    floor = -half_height + wall
    inner_width = 0.5 * width - wall
    pieces = [_block((0.5 * length, 0.5 * width), (-half_height, floor))]
    for side in (-1, 1):
        x = side * (0.5 * length - 0.5 * wall)
        y = side * (0.5 * width - 0.5 * wall)
        pieces.append(_block((0.5 * wall, inner_width), (floor, half_height), middle=(x, 0.0)))
        pieces.append(_block((0.5 * length, 0.5 * wall), (floor, half_height), middle=(0.0, y)))
    return pieces


def _lid() -> list[Points]:
    """A board, a rim below it that fits into the box with 2 mm of play, and a knob."""
    board = (-0.008, 0.0)
    rim = (-0.018, -0.008)
    length, width, bar = 0.184, 0.134, 0.005
    pieces = [_block((0.1, 0.075), board), _block((0.012, 0.03), (0.0, 0.018))]
    for side in (-1, 1):
        x = side * (0.5 * length - 0.5 * bar)
        y = side * (0.5 * width - 0.5 * bar)
        pieces.append(_block((0.5 * bar, 0.5 * width - bar), rim, middle=(x, 0.0)))
        pieces.append(_block((0.5 * length, 0.5 * bar), rim, middle=(0.0, y)))
    return pieces


def _shelf() -> list[Points]:
    """Two compartments, open at the front, which is -x, and a top."""
    board = 0.016
    depth, width, height = 0.24, 0.5, 0.5
    half_height = 0.5 * height
    inner_width = 0.5 * width - board
    pieces = []
    for side in (-1, 1):
        y = side * (0.5 * width - 0.5 * board)
        block = _block((0.5 * depth, 0.5 * board), (-half_height, half_height), middle=(0.0, y))
        pieces.append(block)
    back = (0.5 * depth - 0.25 * board, 0.0)
    pieces.append(_block((0.25 * board, inner_width), (-half_height, half_height), middle=back))
    inner_depth = 0.5 * depth - 0.25 * board
    for low in (-half_height, -0.5 * board, half_height - board):
        middle = (-0.25 * board, 0.0)
        pieces.append(_block((inner_depth, inner_width), (low, low + board), middle=middle))
    return pieces


# ----------------------------------------------------------------------------------------- pieces


def _block(
    half: tuple[float, float],
    heights: tuple[float, float],
    middle: tuple[float, float] = (0.0, 0.0),
) -> Points:
    """A box from its half edges along x and y, its lowest and highest z, and its middle."""
    corners = [
        (middle[0] + x * half[0], middle[1] + y * half[1], z)
        for x in (-1, 1)
        for y in (-1, 1)
        for z in heights
    ]
    return np.array(corners)


def _disc(radius: float, low: float, high: float, upper_radius: float | None = None) -> Points:
    """A cylinder with as many sides as a ring has pieces, or a frustum."""
    upper = radius if upper_radius is None else upper_radius
    corners = []
    for start, _ in _angles():
        corners += [_on_circle(radius, start, low), _on_circle(upper, start, high)]
    return np.array(corners)


def _ring(stations: Sequence[tuple[float, float, float]]) -> list[Points]:
    """A wall around the z axis from inner radius, outer radius and height of each station."""
    pieces = []
    for lower, upper in zip(stations[:-1], stations[1:], strict=True):
        for start, end in _angles():
            corners = []
            for inner, outer, z in (lower, upper):
                for radius in (inner, outer):
                    corners += [_on_circle(radius, start, z), _on_circle(radius, end, z)]
            pieces.append(np.array(corners))
    return pieces


def _angles() -> Iterator[tuple[float, float]]:
    """Where each piece of a ring starts and ends."""
    step = 2.0 * math.pi / SEGMENTS
    for number in range(SEGMENTS):
        yield number * step, (number + 1) * step


def _on_circle(radius: float, angle: float, z: float) -> tuple[float, float, float]:
    return radius * math.cos(angle), radius * math.sin(angle), z


if __name__ == "__main__":
    main()
