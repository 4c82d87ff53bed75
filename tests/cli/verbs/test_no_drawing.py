"""Where nothing can be drawn, or the variables are wrong: one line before the first step."""

import json
from ctypes.util import find_library
from pathlib import Path

import pytest

from embodichain.cli import main

pytestmark = pytest.mark.slow

DEPTH = """\
description: A camera without colours.
max_episode_steps: 2
sensors:
  front: {sensor_type: camera, width: 16, height: 12, observe: true, data_types: [depth, mask]}
"""
COLOR = DEPTH.replace("[depth, mask]", "[color]")
PACKAGES = "apt-get install libegl1 libgl1-mesa-dri libopengl0"


@pytest.fixture
def said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """``said(code, verb, *overrides)``: stderr of the verb, in a folder with two tasks."""
    (tmp_path / "conf" / "task").mkdir(parents=True)
    for name, text in (("depth", DEPTH), ("color", COLOR)):
        (tmp_path / "conf" / "task" / f"{name}.yaml").write_text(text)
    monkeypatch.chdir(tmp_path)

    def says(code: int, *arguments: str) -> str:
        assert main(list(arguments)) == code
        return capsys.readouterr().err

    return says


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("video", ["video.every=2"]),
        ("record.images", ["record.images={cameras: [default], format: png}"]),
        ("video, record.images", ["video=true", "record.images={format: png}"]),
    ],
    ids=str,
)
def test_films_and_pictures_of_a_log_are_refused_before_the_run(said, monkeypatch, key, words):
    monkeypatch.setenv("EMBODICHAIN_RENDERER", "rays")
    for verb in ("run", "validate"):
        told = said(2, verb, "task=depth", *words)
        assert f"error: {key}: colours need OpenGL; EMBODICHAIN_RENDERER is 'rays'" in told
        assert PACKAGES in told
    assert not list(Path("outputs").glob("*/*/rollout.mcap"))


def test_a_camera_is_named(said, monkeypatch):
    monkeypatch.setenv("EMBODICHAIN_RENDERER", "rays")
    for verb in ("run", "validate"):
        told = said(2, verb, "task=color")
        assert "error: camera 'front': colours need OpenGL" in told and PACKAGES in told


def test_depth_and_masks_are_logged_without_hashes(said, monkeypatch):
    monkeypatch.setenv("EMBODICHAIN_RENDERER", "rays")
    told = said(0, "run", "task=depth", "scene_png=false")
    assert "warning: the log has no hashes of pictures: pictures of a log need OpenGL" in told
    told = said(0, "replay", "last", "--verify")
    assert told.startswith("last: ") and told.count("\n") == 1  # no warning


@pytest.mark.parametrize("words", [["task=color"], ["task=depth", "scene_png=true"]], ids=" ".join)
def test_an_unknown_renderer_is_of_the_environment_variable(said, monkeypatch, words):
    monkeypatch.setenv("EMBODICHAIN_RENDERER", "layred")
    expected = (
        "error: environment variable: EMBODICHAIN_RENDERER: unknown renderer 'layred'; there are: "
        "layered, classic, rays. Did you mean 'layered'?"
    )
    for verb in ("run", "validate"):
        assert said(2, verb, *words).splitlines()[-1] == expected
    assert not list(Path("outputs").glob("*/*/rollout.mcap"))


@pytest.mark.parametrize(
    ("variables", "why"),
    [
        (
            {"MUJOCO_GL": "glfw", "DISPLAY": ""},
            "(GLFW needs a display); MUJOCO_GL is 'glfw': unset",
        ),
        ({"MUJOCO_GL": "off"}, "(MUJOCO_GL turns OpenGL off); MUJOCO_GL is 'off': unset it"),
        ({"MUJOCO_GL": "", "PYOPENGL_PLATFORM": "wgl"}, "PYOPENGL_PLATFORM"),
    ],
    ids=str,
)
def test_the_reason_is_named(embodichain, tmp_path, variables, why):
    env = {"WAYLAND_DISPLAY": "", **variables}
    done = embodichain("run", "task=cart_pole", "video=true", cwd=tmp_path, env=env)
    assert done.returncode == 2
    line = done.stderr.splitlines()[0]
    assert line.startswith("error: video: no picture can be made here ") and why in line
    assert PACKAGES in line


@pytest.mark.parametrize("name", ["bogus", "osmesa"])
def test_a_library_that_mujoco_cannot_load(embodichain, tmp_path, name):
    if name == "osmesa" and find_library("OSMesa") is not None:
        pytest.skip("OSMesa is installed here")
    env = {"MUJOCO_GL": name, "PYOPENGL_PLATFORM": "", "WAYLAND_DISPLAY": ""}
    done = embodichain("run", "task=cart_pole", "max_steps=1", cwd=tmp_path, env=env)
    assert done.returncode == 2
    told = f"error: environment variable: MUJOCO_GL: MuJoCo cannot be imported with '{name}' ("
    assert done.stderr.startswith(told) and done.stderr.count("\n") == 1
    done = embodichain("doctor", "--json", cwd=tmp_path, env=env)
    assert done.returncode == 1
    checks = {check["part"]: check for check in json.loads(done.stdout)["checks"]}
    assert checks["MUJOCO_GL"]["state"] == "fail"
    assert checks["MUJOCO_GL"]["advice"] == "unset MUJOCO_GL"
