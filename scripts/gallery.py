"""Draws docs/images/tasks.jpg: every shipped task after a reset, with its name.

`python scripts/gallery.py`; its pictures are those of `embodichain render`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from embodichain.cli import main

REPO = Path(__file__).parents[1]
PICTURE = REPO / "docs" / "images" / "tasks.jpg"
TASKS = sorted(path.stem for path in (REPO / "conf" / "task").glob("*.yaml"))
COLUMNS = 4
SIZE = 400, 300
"""Width and height of one task's picture, in pixels."""
BAR = 28
"""Height of the line with its name."""


def sheet(tasks: Sequence[str], size: tuple[int, int] = SIZE) -> Image.Image:
    """Return one picture of several tasks, `COLUMNS` in a row.

    Raises:
        RuntimeError: If one cannot be drawn; the reason is on stderr.
    """
    width, height = size
    rows = -(-len(tasks) // COLUMNS)
    found = Image.new("RGB", (width * min(len(tasks), COLUMNS), (height + BAR) * rows), "white")
    draw, font = ImageDraw.Draw(found), ImageFont.load_default(BAR * 0.6)
    with tempfile.TemporaryDirectory() as folder:
        for i, task in enumerate(tasks):
            left, top = width * (i % COLUMNS), (height + BAR) * (i // COLUMNS)
            file = Path(folder, f"{task}.png")
            command = [f"task={task}", str(file), "--size", f"{width}x{height}", "seed=1"]
            if main(["render", *command, "--quiet"]):
                raise RuntimeError(f"{task} cannot be drawn")
            found.paste(Image.open(file), (left, top + BAR))
            draw.text((left + 8, top + BAR / 2), task, fill="black", font=font, anchor="lm")
    return found


if __name__ == "__main__":
    sheet(TASKS).save(PICTURE, quality=90)
