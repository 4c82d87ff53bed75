"""`embodichain render`: a picture of a task, from the command line to the file."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from PIL import Image

import embodichain
from embodichain.cli import main

pytestmark = pytest.mark.slow

SMALL = ("--size", "96x64", "seed=3")


def pixels(path: str) -> NDArray[np.uint8]:
    return np.asarray(Image.open(path).convert("RGB"))


def render(*arguments: str) -> int:
    return main(["render", *arguments, "--quiet"])


def test_the_picture_is_what_the_environment_renders() -> None:
    assert render("task=cart_pole", "out.png", "--step", "5", "policy=zero", *SMALL) == 0
    env = embodichain.make("cart_pole", num_envs=1, seed=3)
    env.reset()
    for _ in range(5):
        env.step(torch.zeros(1, 1))
    np.testing.assert_array_equal(pixels("out.png"), env.sim.render(0, "default", 96, 64))
    env.close()


def test_a_grid_has_the_environments_row_by_row() -> None:
    assert render("push_cube", "grid.png", "--grid", "2x3", *SMALL) == 0
    grid = pixels("grid.png")
    assert grid.shape == (3 * 64, 2 * 96, 3)
    env = embodichain.make("push_cube", num_envs=6, seed=3)
    env.reset()
    tiles = grid.reshape(3, 64, 2, 96, 3).swapaxes(1, 2).reshape(6, 64, 96, 3)
    for env_id, tile in enumerate(tiles):
        np.testing.assert_array_equal(tile, env.sim.render(env_id, "default", 96, 64))
    assert len({tile.tobytes() for tile in tiles}) == 6  # goals and cubes differ
    env.close()


def test_a_view_of_the_task_is_drawn() -> None:
    side = "++task.views.side={eye: [0, -3, 1], target: [0, 0, 1]}"
    assert render("reach", "side.png", "--view", "side", side, *SMALL) == 0
    assert render("reach", "default.png", side, *SMALL) == 0
    env = embodichain.make("reach", num_envs=1, seed=3, overrides=[side])
    env.reset()
    np.testing.assert_array_equal(pixels("side.png"), env.sim.render(0, "side", 96, 64))
    assert (pixels("side.png") != pixels("default.png")).any()
    env.close()


def test_what_was_drawn_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["render", "reach", "a.jpg", "--size", "96x64", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    seed = facts.pop("seed")
    assert facts.pop("view") == "default" and facts.pop("control_step") == 0
    assert facts == {"file": "a.jpg", "size": [96, 64], "task": "reach", "num_envs": 1}
    assert render("reach", "b.jpg", "--size", "96x64", f"seed={seed}") == 0
    np.testing.assert_array_equal(pixels("a.jpg"), pixels("b.jpg"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["reach"], "name one picture to write (.png, .jpg, .jpeg, .webp), got: none"),
        (["reach", "a.png", "b.png"], "name one picture to write"),
        (["reach", "a.gif"], "got: none"),
        (["reach", "a.png", "--view", "defalt"], "there are default. Did you mean 'default'?"),
        (["reach", "a.png", "--grid", "4"], "--grid is COLUMNSxROWS, such as 4x3, not '4'"),
        (["reach", "a.png", "--size", "0x9"], "--size is WIDTHxHEIGHT in pixels"),
        (["reach", "a.png", "--size", "9000x9"], "a side has at most 8192 pixels, got 9000x9"),
        (["reach", "a.png", "--size", "8000x8000", "--grid", "9x9"], "72000x72000 pixels are too"),
        (["reach", "a.png", "--step", "-1"], "--step"),
        (["reach", "a.png", "num_envs=2"], "num_envs follows from --grid"),
        (["rech", "a.png"], "Did you mean 'reach'?"),
        (["reach", "a.png", "policy=nothing"], "nothing"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_mistakes_are_reported_and_nothing_is_written(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["render", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not Path("a.png").exists()


def test_a_picture_is_never_replaced(capsys: pytest.CaptureFixture[str]) -> None:
    Path("a.png").write_bytes(b"mine")
    assert render("reach", "a.png") == 2
    assert "a.png exists" in capsys.readouterr().err
    assert Path("a.png").read_bytes() == b"mine"


def test_without_opengl_it_names_the_packages(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EMBODICHAIN_RENDERER", "rays")
    assert render("task=cart_pole", "out.png", *SMALL) == 2
    err = capsys.readouterr().err
    assert err.startswith("error: colours need OpenGL") and "libegl1 libgl1-mesa-dri" in err
    assert not Path("out.png").exists()
    assert main(["run", "task=cart_pole", "max_steps=2", "record=none", "--quiet"]) == 0
    assert "no scene.png: colours need OpenGL" in capsys.readouterr().err
