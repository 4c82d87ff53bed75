"""docs/images/tasks.jpg shows every task that ships, robots.jpg a robot of each folder."""

import numpy as np
import pytest
from PIL import Image

import embodichain
from embodichain.data.pretrained import pretrained_tasks
from scripts import gallery
from scripts.gallery import BAR, COLUMNS, PICTURE, SIZE, TASKS, sheet
from tests.data.robot_catalog import LOADABLE

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]


def test_the_picture_has_a_place_for_every_task() -> None:
    width, height = Image.open(PICTURE).size
    rows = -(-len(TASKS) // COLUMNS)
    written = "python scripts/gallery.py writes it"
    assert (width, height) == (SIZE[0] * COLUMNS, (SIZE[1] + BAR) * rows), written


def test_every_task_has_a_moment_in_action() -> None:
    assert set(gallery.MOMENTS) == set(TASKS)
    trained = {task for task, moment in gallery.MOMENTS.items() if moment.policy == "pretrained"}
    assert trained == set(pretrained_tasks())


def test_tasks_are_drawn_below_their_names() -> None:
    found = np.asarray(sheet(["cart_pole", "reach"], (96, 64)))
    assert found.shape == (64 + BAR, 2 * 96, 3)
    for i, task in enumerate(("cart_pole", "reach")):
        place = found[:, 96 * i : 96 * (i + 1)]
        assert (place[:BAR] < 128).any() and (place[:BAR] == 255).any()  # black on white
        env = embodichain.make(task, num_envs=1, seed=gallery.MOMENTS[task].seed)
        env.reset()
        at_rest = env.sim.render(0, "default", 96, 64)
        env.close()
        difference = np.abs(place[BAR:].astype(int) - at_rest).max(axis=2)
        assert 0.003 < (difference > 20).mean() < 0.4  # something has moved, in the same room


def test_the_film_shows_policies_that_ship() -> None:
    assert set(gallery.FILMED) <= set(pretrained_tasks())
    width, height = gallery.FILM_SIZE
    rows = -(-len(gallery.FILMED) // gallery.FILM_COLUMNS)
    with Image.open(gallery.FILM) as film:
        assert film.size == (width * gallery.FILM_COLUMNS, height * rows)
        assert film.n_frames == round(gallery.FILM_SECONDS * gallery.FILM_RATE)
    assert gallery.FILM.stat().st_size < 3_000_000  # a README is read on phones, too


def test_the_picture_of_robots_has_a_place_for_every_folder() -> None:
    robots = gallery.robots()
    left_out = tuple(f"{label}_description/" for label in gallery.LEFT_OUT)
    moving = [name for name, joints in LOADABLE.items() if joints and not name.startswith(left_out)]
    folders = {name.partition("/")[0] for name in (*moving, "UniversalRobots/UR10/UR10.urdf")}
    assert {name.partition("/")[0] for name in robots.values()} == folders
    assert len(robots) == len(folders)
    rows = -(-len(robots) // gallery.ROBOT_COLUMNS)
    width, height = gallery.ROBOT_SIZE
    expected = width * gallery.ROBOT_COLUMNS, (height + gallery.ROBOT_BAR) * rows
    assert Image.open(gallery.ROBOTS_PICTURE).size == expected, "scripts/gallery.py writes it"


def test_robots_are_drawn_in_a_task_of_their_own(empty_cwd) -> None:
    pendulum = gallery.robots()["double_pendulum"]
    found = np.asarray(gallery.robot_sheet({"a": pendulum, "b": pendulum}, (64, 48)))
    assert found.shape == (48 + gallery.ROBOT_BAR, 2 * 64, 3)
    drawn = found[gallery.ROBOT_BAR :]
    assert (drawn[:, :64] != drawn[:, :1, :]).any()
    np.testing.assert_array_equal(drawn[:, :64], drawn[:, 64:])
    assert list(empty_cwd.iterdir()) == []  # the tasks were written elsewhere
