"""Draw the pictures of the catalogues: docs/images/tasks.jpg and docs/images/robots.jpg.

`python scripts/gallery.py tasks` draws every shipped task after a reset, with its name: pictures of
`embodichain render`. `python scripts/gallery.py robots` draws robots of example-robot-data, one of
each folder, and those that this package has, in the task that `embodichain new task --robot` writes
for the file.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

from PIL import Image, ImageDraw, ImageFont

from embodichain.cli import main
from embodichain.data import fault_of, list_robots

REPO = Path(__file__).parents[1]
PICTURE = REPO / "docs" / "images" / "tasks.jpg"
ROBOTS_PICTURE = REPO / "docs" / "images" / "robots.jpg"
TASKS = sorted(path.stem for path in (REPO / "conf" / "task").glob("*.yaml"))
COLUMNS = 4
SIZE = 400, 300
"""Width and height of one task's picture, in pixels."""
BAR = 28
"""Height of the line with its name."""
ROBOT_COLUMNS = 7
ROBOT_SIZE = 220, 176
ROBOT_BAR = 20
OUR_ROBOT = "UniversalRobots/UR10/UR10.urdf"
"""The robot of this package that has a picture."""
LEFT_OUT = ("pr2", "simple_humanoid")
"""Robots without a picture: of pr2 `new task` writes a task that is refused, because the limits of
its fingers exclude what they mimic; simple_humanoid has no visual shapes."""


def sheet(tasks: Sequence[str], size: tuple[int, int] = SIZE) -> Image.Image:
    """Return one picture of several tasks, `COLUMNS` in a row.

    Raises:
        RuntimeError: If one cannot be drawn; the reason is on stderr.
    """
    labels = {task: task for task in tasks}
    return _draw_sheet(labels, _draw_task, size=size, columns=COLUMNS, bar=BAR)


def robots() -> dict[str, str]:
    """Return label -> name to write in a task, of the robots that the picture has.

    Of a folder, the first file that can be read and has a joint that moves.
    """
    names: dict[str, str] = {}
    for robot in list_robots():
        if robot.name == OUR_ROBOT:
            label = "UR10"
        elif robot.source == "example-robot-data":
            folder = Path(robot.name).parts[0]
            label = folder.removesuffix("_description").removesuffix("_data")
        else:
            continue
        if label in LEFT_OUT or fault_of(robot.path):
            continue
        joints = ElementTree.fromstring(robot.path.read_bytes()).iter("joint")
        if any(joint.get("type", "fixed") != "fixed" for joint in joints):
            names.setdefault(label, robot.name)
    return dict(sorted(names.items(), key=lambda item: item[0].lower()))


def robot_sheet(names: Mapping[str, str], size: tuple[int, int] = ROBOT_SIZE) -> Image.Image:
    """Return one picture of several robots, `ROBOT_COLUMNS` in a row.

    Args:
        names: Label -> robot, as `robots` returns them.
        size: Width and height of one, in pixels.

    Raises:
        RuntimeError: If one cannot be drawn; the reason is on stderr.
    """

    def draw_robot(robot: str, file: Path, size: tuple[int, int]) -> None:
        with contextlib.redirect_stdout(io.StringIO()):
            if main(["new", "task", file.stem, "--robot", robot]):
                raise RuntimeError(f"there is no task for {robot}")
        _draw_task(file.stem, file, size)

    with _empty_folder():
        return _draw_sheet(names, draw_robot, size=size, columns=ROBOT_COLUMNS, bar=ROBOT_BAR)


def _draw_task(task: str, file: Path, size: tuple[int, int]) -> None:
    """Write a picture of a task into a file."""
    width, height = size
    command = [f"task={task}", str(file), "--size", f"{width}x{height}", "seed=1"]
    if main(["render", *command, "--quiet"]):
        raise RuntimeError(f"{task} cannot be drawn")


def _draw_sheet(
    labels: Mapping[str, str],
    draw: Callable[[str, Path, tuple[int, int]], None],
    *,
    size: tuple[int, int],
    columns: int,
    bar: int,
) -> Image.Image:
    """Return one picture of several pictures with labels.

    Args:
        labels: Label -> what `draw` takes.
        draw: Writes a picture of a size into a file.
        size: Width and height of each, in pixels.
        columns: Pictures in a row.
        bar: Height of a label's line.
    """
    width, height = size
    rows = math.ceil(len(labels) / columns)
    sheet_size = (width * min(len(labels), columns), (height + bar) * rows)
    image = Image.new("RGB", sheet_size, "white")
    canvas = ImageDraw.Draw(image)
    font = ImageFont.load_default(bar * 0.6)
    with tempfile.TemporaryDirectory() as folder:
        for i, (label, name) in enumerate(labels.items()):
            left = width * (i % columns)
            top = (height + bar) * (i // columns)
            file = Path(folder, f"picture_{i}.png")
            draw(name, file, size)
            image.paste(Image.open(file), (left, top + bar))
            canvas.text((left + 8, top + bar / 2), label, fill="black", font=font, anchor="lm")
    return image


@contextlib.contextmanager
def _empty_folder() -> Iterator[None]:
    """A working directory for the tasks that are written."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            yield
        finally:
            os.chdir(before)


if __name__ == "__main__":
    catalogues = sys.argv[1:] or ["tasks", "robots"]
    if "tasks" in catalogues:
        sheet(TASKS).save(PICTURE, quality=90)
    if "robots" in catalogues:
        robot_sheet(robots()).save(ROBOTS_PICTURE, quality=85)
