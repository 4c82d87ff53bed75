"""Draw `docs/images/rooms.svg`: the layers that import-linter holds, room by room.

`python scripts/rooms.py` writes the picture; `--check` writes nothing, and its exit code is 1 if
the picture is another one. A row of a panel may import the rows below it; boxes of one row do not
import each other. Names in the picture are files and folders of the panel's package.
"""

from __future__ import annotations

import argparse
import sys
import tomllib
from pathlib import Path
from xml.sax.saxutils import escape

ROOT = Path(__file__).parents[1]
PICTURE = ROOT / "docs" / "images" / "rooms.svg"
_COLUMNS = 3
_PANEL = 336
_CHARACTER = 6.1
"""Width of a character, pixels."""
_BOX = 20
_STEP = 34
_GAP = 6
_STYLE = """
    rect { fill: #eef2f4; stroke: #546e7a; }
    path { stroke: #546e7a; }
    text { font: 10px monospace; text-anchor: middle; fill: #37474f; }
    .title { font: bold 12px sans-serif; text-anchor: start; }
    .folder { font-weight: bold; }
"""


def contracts(root: Path = ROOT) -> dict[str, list[list[str]]]:
    """Return package -> its layers, from the top; each layer is a list of names."""
    config = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    layers_of: dict[str, list[list[str]]] = {}
    for contract in config["tool"]["importlinter"]["contracts"]:
        if contract["type"] != "layers":
            continue
        layers = [[name.strip() for name in layer.split("|")] for layer in contract["layers"]]
        for package in contract["containers"]:
            layers_of[package] = layers
    return layers_of


def picture(root: Path = ROOT) -> str:
    """Return the picture as SVG: panels in columns, each where there is most room."""
    columns: list[list[str]] = [[] for _ in range(_COLUMNS)]
    heights = [10.0] * _COLUMNS
    for package, layers in contracts(root).items():
        column = heights.index(min(heights))
        left = column * _PANEL + 10.0
        lines, height = _draw_panel(root, package, layers, left=left, top=heights[column])
        columns[column] += lines
        heights[column] += height
    width = _COLUMNS * _PANEL + 10
    height = int(max(heights))
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}">',
        f"  <style>{_STYLE}  </style>",
        '  <marker id="tip" markerWidth="8" markerHeight="8" refX="5" refY="4" orient="auto">'
        '<path d="M0 0L8 4L0 8Z" style="fill: #546e7a; stroke: none"/></marker>',
        f'  <rect width="{width}" height="{height}" style="fill: white; stroke: none"/>',
    ]
    for column_lines in columns:
        lines += column_lines
    lines.append("</svg>")
    return "\n".join(lines) + "\n"


def _draw_panel(
    root: Path, package: str, layers: list[list[str]], *, left: float, top: float
) -> tuple[list[str], float]:
    """Return title, boxes and arrows of one package, and their height in pixels."""
    title = package.removeprefix("embodichain.")
    lines = [f'  <text x="{left:.0f}" y="{top + 12:.0f}" class="title">{escape(title)}</text>']
    folder = root / package.replace(".", "/")
    middle = left + (_PANEL - 20) / 2
    y = top + 20
    for number, names in enumerate(layers):
        for row in _split_into_rows(names):
            lines += _draw_boxes(folder, row, middle, y)
            y += _BOX + _GAP
        bottom = y - _GAP
        y = bottom + _STEP - _BOX
        if number + 1 < len(layers):
            end = y - 3
            lines.append(f'  <path d="M{middle:.1f} {bottom}V{end:.0f}" marker-end="url(#tip)"/>')
    return lines, y + 10 - top


def _split_into_rows(names: list[str]) -> list[list[str]]:
    """Return the names of a layer in rows that fit into a panel."""
    rows: list[list[str]] = [[]]
    for name in names:
        if rows[-1] and sum(map(_width, [*rows[-1], name])) > _PANEL - 20:
            rows.append([])
        rows[-1].append(name)
    return rows


def _width(name: str) -> float:
    """Width of a box and the gap beside it, pixels."""
    return len(name) * _CHARACTER + 12 + _GAP


def _draw_boxes(folder: Path, names: list[str], middle: float, y: float) -> list[str]:
    """Return a row of boxes, centred."""
    lines = []
    x = middle - (sum(map(_width, names)) - _GAP) / 2
    for name in names:
        width = _width(name) - _GAP
        kind = ' class="folder"' if (folder / name).is_dir() else ""
        lines += [
            f'  <rect x="{x:.1f}" y="{y:.0f}" width="{width:.1f}" height="{_BOX}" rx="3"/>',
            f'  <text x="{x + width / 2:.1f}" y="{y + 14:.0f}"{kind}>{escape(name)}</text>',
        ]
        x += width + _GAP
    return lines


def main(arguments: list[str] | None = None) -> int:
    """Write the picture, or compare it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="compare, and write nothing")
    options = parser.parse_args(arguments)
    if options.check:
        return int(PICTURE.read_text(encoding="utf-8") != picture())
    PICTURE.write_text(picture(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
