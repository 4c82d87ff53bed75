"""Draw docs/images/tasks.jpg, docs/images/robots.jpg and docs/images/policies.gif.

`python scripts/gallery.py tasks` draws every shipped task in action, with its name: a moment of an
episode of the policy that ships for it, or of its expert. `python scripts/gallery.py policies`
films policies that ship. `python scripts/gallery.py robots` draws robots of example-robot-data, one
of each folder, and those that this package has, in the task that `embodichain new task --robot`
writes for the file.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import embodichain
from embodichain.cli import main
from embodichain.data import fault_of, list_robots
from embodichain.data.pretrained import pretrained
from embodichain.lab.gym.envs import BaseEnv
from embodichain.lab.gym.policies import Policy, resolve_policy
from embodichain.learning.policies.policy import load_policy
from embodichain.utils.system.video import GifFile

REPO = Path(__file__).parents[1]
PICTURE = REPO / "docs" / "images" / "tasks.jpg"
ROBOTS_PICTURE = REPO / "docs" / "images" / "robots.jpg"
FILM = REPO / "docs" / "images" / "policies.gif"
TASKS = sorted(path.stem for path in (REPO / "conf" / "task").glob("*.yaml"))


@dataclass(frozen=True)
class Moment:
    """When a task is drawn.

    Attributes:
        policy: What acts until then: ``pretrained``, ``expert`` or another policy's name.
        step: Control steps after the reset.
        seed: The seed of the episode.
    """

    policy: str
    step: int
    seed: int = 1


MOMENTS = {
    "cart_pole": Moment("pretrained", 4, seed=3),
    "cart_pole_swing_up": Moment("pretrained", 60),
    "clutter_pick": Moment("expert", 78),
    "hand_over": Moment("expert", 95),
    "hold_still": Moment("hold", 10),
    "humanoid_velocity": Moment("zero", 18),
    "lift_cube": Moment("expert", 66, seed=3),
    "lift_vision": Moment("expert", 34, seed=2),
    "open_drawer": Moment("expert", 110),
    "peg_in_hole": Moment("expert", 120),
    "pick_place": Moment("expert", 75),
    "press_button": Moment("pretrained", 16),
    "push_cube": Moment("pretrained", 45),
    "quadruped_rough": Moment("zero", 10, seed=4),
    "quadruped_velocity": Moment("pretrained", 60),
    "random_reach": Moment("random", 30),
    "reach": Moment("pretrained", 6, seed=5),
    "reach_pose": Moment("pretrained", 40, seed=2),
    "reach_vision": Moment("expert", 10, seed=3),
    "reach_workspace": Moment("pretrained", 20, seed=6),
    "stack_cubes": Moment("expert", 82),
}
"""Task -> when it is drawn; a task without a moment, after a reset."""
FILMED = {
    "quadruped_velocity": [],
    "push_cube": [],
    "cart_pole_swing_up": [],
    "reach_workspace": ["task.max_episode_steps=75"],
    "press_button": ["task.max_episode_steps=50"],
    "reach_pose": ["task.max_episode_steps=75"],
}
"""Task -> overrides of the film: of an arm that is there, the next episode is more interesting."""
FILM_COLUMNS = 3
FILM_SIZE = 240, 180
FILM_SECONDS = 6.0
FILM_RATE = 12.5
COLUMNS = 4
SIZE = 400, 300
"""Width and height of one task's picture, in pixels."""
BAR = 28
"""Height of the line with its name."""
ROBOT_COLUMNS = 6
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
    return _draw_sheet(labels, _draw_moment, size=size, columns=COLUMNS, bar=BAR)


def film(file: Path, seconds: float = FILM_SECONDS) -> None:
    """Film the policies of `FILMED` side by side.

    Args:
        file: The GIF.
        seconds: Its length.
    """
    width, height = FILM_SIZE
    rows = math.ceil(len(FILMED) / FILM_COLUMNS)
    whole = np.zeros((rows * height, FILM_COLUMNS * width, 3), np.uint8)
    count = round(seconds * FILM_RATE)
    films = [_frames(task, overrides, count) for task, overrides in FILMED.items()]
    file.unlink(missing_ok=True)
    with GifFile(file, (whole.shape[1], whole.shape[0]), FILM_RATE) as gif:
        for pictures in zip(*films, strict=True):
            for number, (task, picture) in enumerate(zip(FILMED, pictures, strict=True)):
                top = height * (number // FILM_COLUMNS)
                left = width * (number % FILM_COLUMNS)
                whole[top : top + height, left : left + width] = _with_name(picture, task)
            gif.write(whole)


def _frames(task: str, overrides: Sequence[str], count: int) -> Iterator[NDArray[np.uint8]]:
    """Yield pictures of a task that is solved by the policy that ships for it, in real time."""
    with _solved(task, Moment("pretrained", 0), overrides) as (env, advance):
        steps = 0
        for number in range(count):
            while steps < round(number / FILM_RATE * env.control_frequency):
                advance()
                steps += 1
            yield env.sim.render(0, "default", *FILM_SIZE)


def _with_name(picture: NDArray[np.uint8], name: str) -> NDArray[np.uint8]:
    """A picture with a name in its corner."""
    image = Image.fromarray(picture)
    font = ImageFont.load_default(11)
    ImageDraw.Draw(image).text((6, 5), name, fill=(60, 66, 74), font=font)
    return np.asarray(image)


@contextlib.contextmanager
def _solved(
    task: str, moment: Moment, overrides: Sequence[str] = ()
) -> Iterator[tuple[BaseEnv, Callable[[], None]]]:
    """One environment of a task after a reset, and a function that does a control step in it."""
    env = embodichain.make(task, num_envs=1, seed=moment.seed, overrides=overrides)
    try:
        policy = _policy_of(task, moment.policy, env)
        observations, _ = env.reset()
        policy.reset(None)

        def advance() -> None:
            nonlocal observations
            observations, _, terminated, truncated, _ = env.step(policy(observations, env))
            ended = np.flatnonzero(np.asarray(terminated) | np.asarray(truncated))
            if len(ended):
                policy.reset(ended)

        yield env, advance
    finally:
        env.close()


def _policy_of(task: str, name: str, env: BaseEnv) -> Policy:
    if name != "pretrained":
        return resolve_policy(name)
    return load_policy(pretrained(task).file, env, allow_changed=True)


def _draw_moment(task: str, file: Path, size: tuple[int, int]) -> None:
    """Write a picture of a task at its moment into a file."""
    moment = MOMENTS.get(task, Moment("hold", 0))
    with _solved(task, moment) as (env, advance):
        for _ in range(moment.step):
            advance()
        Image.fromarray(env.sim.render(0, "default", *size)).save(file)


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
    """Write a picture of a task without a scene of its own into a file, in the shipped room."""
    width, height = size
    room = "+scene@task.scene=studio"
    command = [f"task={task}", str(file), "--size", f"{width}x{height}", "seed=1", room]
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
    catalogues = sys.argv[1:] or ["tasks", "policies", "robots"]
    if "tasks" in catalogues:
        sheet(TASKS).save(PICTURE, quality=90)
    if "policies" in catalogues:
        film(FILM)
    if "robots" in catalogues:
        robot_sheet(robots()).save(ROBOTS_PICTURE, quality=85)
