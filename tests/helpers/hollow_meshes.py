"""OBJ files of hollow things: solids of revolution, closed and with outward faces."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

BOWL = ((1e-4, 0.0), (0.04, 0.0), (0.07, 0.05), (0.064, 0.05), (0.036, 0.006), (1e-4, 0.006))
"""Outline (radius, height) in metres, counter-clockwise: a bowl of 5 cm with a wall of 5 mm."""
CUP = ((1e-4, 0.0), (0.03, 0.0), (0.03, 0.08), (0.026, 0.08), (0.026, 0.005), (1e-4, 0.005))
"""A cup of 8 cm with a wall of 4 mm."""


def write_revolved(
    path: Path, outline: Sequence[tuple[float, float]] = BOWL, sides: int = 12
) -> str:
    """Write the outline turned about the z axis; return the path.

    Args:
        path: The OBJ file.
        outline: (radius, height) of its corners, counter-clockwise.
        sides: Around the axis.
    """
    count = len(outline)
    lines = []
    for turn in np.linspace(0, 2 * np.pi, sides, endpoint=False):
        lines += [f"v {r * np.cos(turn):.6f} {r * np.sin(turn):.6f} {z:.6f}" for r, z in outline]
    for side in range(sides):
        here, there = 1 + side * count, 1 + (side + 1) % sides * count
        for corner in range(count):
            after = (corner + 1) % count
            a, b, c, d = here + corner, here + after, there + corner, there + after
            lines += [f"f {a} {c} {d}", f"f {a} {d} {b}"]
    path.write_text("\n".join(lines) + "\n")
    return str(path)
