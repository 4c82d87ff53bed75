"""Events that change pictures: each environment's own colour, texture, pose and lens, replayed."""

import numpy as np
import pytest
import torch
import yaml
from PIL import Image

import embodichain
from embodichain.recording import McapRecorder, verify
from embodichain.recording import open as open_log
from embodichain.utils.errors import ConfigError

TASK = """
description: A painted cube before a wall.
max_episode_steps: 50
robot: {uid: ur10, fpath: UniversalRobots/UR10/UR10.urdf, init_pos: [0, 5, 1]}
objects:
  wall: {shape: {shape_type: Cube, size: [0.2, 4, 4]}, body_type: static, init_pos: [1.6, 0, 1]}
  cube: {shape: {shape_type: Cube, size: [0.2, 0.2, 0.2]}, body_type: static, init_pos: [1.0, 0, 1]}
sensors:
  front: {sensor_type: camera, width: 24, height: 16, intrinsics: [24, 24, 12, 8],
          data_types: [color, position], extrinsics: {eye: [0, 0, 1], target: [1, 0, 1]}}
  narrow: {sensor_type: camera, width: 24, height: 16, fovy: 40, data_types: [color],
           extrinsics: {eye: [0, 0, 1], target: [1, 0, 1]}}
  pair: {sensor_type: stereo_camera, width: 16, height: 16, left_to_right_pos: [0.2, 0, 0],
         extrinsics: {eye: [0, 0, 1], target: [1, 0, 1]}}
observations:
  front: {func: camera_image, params: {sensor: front}}
"""
COLORS = ("red", "lime", "blue")


@pytest.fixture
def make(tmp_path):
    """Builds the task with events; the cube has three textures."""
    built = []
    for name in COLORS:
        Image.new("RGB", (8, 8), name).save(tmp_path / f"{name}.png")

    def build(events=None, num_envs=4, textures=None):
        tree = yaml.safe_load(TASK)
        files = [str(tmp_path / f"{name}.png") for name in COLORS]
        look = {"textures": files if textures is None else textures}
        tree["objects"]["cube"]["shape"]["visual_material"] = look
        tree["events"] = events or {}
        (tmp_path / "task").mkdir(exist_ok=True)
        (tmp_path / "task" / "seen.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
        env = embodichain.make("seen", num_envs, ["seed=1"], config_dir=tmp_path)
        built.append(env)
        return env

    yield build
    for env in built:
        env.close()


def event(func, **params):
    return {"func": func, "mode": "reset", "params": params}


PAINT = {"paint": event("randomize_texture", of={"uid": "cube"})}


def middle(env):
    """(N, 3) the colour in the middle of the picture: the cube's."""
    return env.get_obs()["front"][:, :, 8, 12].numpy()


def test_a_texture_of_each_environment(make):
    env = make(PAINT, num_envs=12)
    env.reset()
    strongest = middle(env).argmax(axis=1)
    assert set(strongest.tolist()) == {0, 1, 2}
    few = make(PAINT, num_envs=3)
    few.reset()
    np.testing.assert_array_equal(middle(few), middle(env)[:3])


def test_the_first_texture_without_an_event(make):
    env = make()
    env.reset()
    red, green, blue = middle(env)[0]
    assert red > 100 > max(green, blue)


def test_a_color_of_one_environment_changes_its_picture_alone(make):
    env = make()
    before, _ = env.reset()
    before = before["front"].clone()
    material = env.sim.engine.model.material("cube/material").id
    env.sim.engine.write_model(
        "mat_rgba", [[0.1, 0.1, 0.1]], np.array([3]), slice(4 * material, 4 * material + 3)
    )
    changed = (env.get_obs()["front"] != before).flatten(1).any(1)
    assert changed.tolist() == [False, False, False, True]


def test_intrinsics(make):
    lens = event(
        "randomize_camera_intrinsics", sensor="front", focal_x_range=[-6, 6], cx_range=[2, 2]
    )
    env = make({"lens": lens})
    env.reset()
    found = env.get_sensor("front").read_intrinsics()
    assert np.ptp(found[:, 0]) > 1 and (abs(found[:, 0] - 24) <= 6).all()
    np.testing.assert_allclose(found[:, 1], found[:, 0], rtol=1e-5)  # the share of fx
    np.testing.assert_allclose(found[:, 2:], [[14.0, 8.0]] * 4, rtol=1e-5)
    points = env.get_sensor("front").read("position")
    wanted = 1.5 * (14.0 - 0.5) / found[:, 0]  # y of the wall at the left edge
    np.testing.assert_allclose(points[:, 0, 0, 1], wanted, atol=5e-3)


def test_both_eyes_of_a_pair_move(make):
    up = event("randomize_camera_pose", camera="pair", position_range=[[0, 0, 0.1], [0, 0, 0.3]])
    env = make({"up": up})
    env.reset()
    left, right = env.get_sensor("pair").get_left_right_arena_pose()
    raised = left[:, 2, 3] - 1.0
    assert ((raised > 0.1) & (raised < 0.3)).all() and raised.std() > 0
    torch.testing.assert_close(left[:, 2, 3], right[:, 2, 3])
    torch.testing.assert_close(left[:, 1, 3] - right[:, 1, 3], torch.full((4,), 0.2))


def test_events_are_logged_and_replayed(make, tmp_path):
    sway = event("randomize_camera_pose", camera="front", position_range=[[0] * 3, [0.2] * 3])
    env = make({**PAINT, "sway": sway}, num_envs=2)
    log = tmp_path / "run.mcap"
    env.add_observer(McapRecorder(log, env))
    env.reset()
    for _ in range(3):
        env.step(torch.zeros(2, 6))
    env.close()
    report = verify(log, images=True)
    assert report.ok
    with open_log(log) as found:
        drawn = [d for d in found.events() if d.term in ("paint", "sway")]
    assert {d.term for d in drawn} == {"paint", "sway"}


@pytest.mark.parametrize(
    ("events", "message"),
    [
        (
            {"wide": event("randomize_camera_fovy", camera="front", fovy_range=[30, 40])},
            "'front' has intrinsics.*Use randomize_camera_intrinsics",
        ),
        (
            {"lens": event("randomize_camera_intrinsics", sensor="narrow", cx_range=[0, 1])},
            "'narrow' has a field of view: use randomize_camera_fovy",
        ),
        (
            {"lens": event("randomize_camera_intrinsics", sensor="front", focal_x_range=[-24, 0])},
            "focal_x_range: the declared one is 24 pixels",
        ),
        (
            {"paint": event("randomize_texture", of={"uid": "wall"})},
            "'wall' has no shape.visual_material.textures",
        ),
    ],
)
def test_mistakes(make, events, message):
    with pytest.raises(ConfigError, match=message):
        make(events)


def test_a_broken_texture_is_reported_with_its_line(make, tmp_path):
    (tmp_path / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\nbroken")
    with pytest.raises(ConfigError) as error:
        make(textures=[str(tmp_path / "red.png"), str(tmp_path / "broken.png"), "nowhere.png"])
    found = {p.path: p for p in error.value.problems}
    where = "task.objects.cube.shape.visual_material.textures"
    assert set(found) == {f"{where}.1", f"{where}.2"}
    assert "seen.yaml:" in found[f"{where}.1"].source
