"""docs/images/tasks.jpg shows every task that ships."""

import numpy as np
import pytest
from PIL import Image

import embodichain
from scripts.gallery import BAR, COLUMNS, PICTURE, SIZE, TASKS, sheet

pytestmark = pytest.mark.unmeasured


def test_the_picture_has_a_place_for_every_task() -> None:
    width, height = Image.open(PICTURE).size
    rows = -(-len(TASKS) // COLUMNS)
    written = "python scripts/gallery.py writes it"
    assert (width, height) == (SIZE[0] * COLUMNS, (SIZE[1] + BAR) * rows), written


def test_tasks_are_drawn_below_their_names() -> None:
    found = np.asarray(sheet(["cart_pole", "reach"], (96, 64)))
    assert found.shape == (64 + BAR, 2 * 96, 3)
    for i, task in enumerate(("cart_pole", "reach")):
        place = found[:, 96 * i : 96 * (i + 1)]
        assert (place[:BAR] < 128).any() and (place[:BAR] == 255).any()  # black on white
        env = embodichain.make(task, num_envs=1, seed=1)
        env.reset()
        np.testing.assert_array_equal(place[BAR:], env.sim.render(0, "default", 96, 64))
        env.close()
