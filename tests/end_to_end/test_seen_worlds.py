"""The same scene seen by cameras, by rays and without OpenGL; furniture, files and lights in it."""

from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

import embodichain
from embodichain.utils.errors import RenderError
from tests.helpers.kitchen import KITCHEN

pytestmark = pytest.mark.slow

ROOM = """
description: A box on a table.
max_episode_steps: 20
scene: {table: {size: [0.8, 0.8, 0.5], pos: [1.5, 0, 0], type: plain}}
objects:
  box: {shape: {shape_type: Cube, size: [0.2, 0.2, 0.2]}, body_type: kinematic,
        init_pos: [1.5, 0, 0.6]}
sensors:
  eye: {sensor_type: camera, width: 32, height: 24, intrinsics: [30, 30, 16, 12], far: 20,
        extrinsics: {eye: [0, 0, 0.9], target: [1.5, 0, 0.5]}, data_types: [depth, distance, mask]}
"""
KITCHEN_TASK = """
description: A kitchen from a file.
max_episode_steps: 20
scene: {fpath: kitchen.xml, keyframe: home}
views: {cup: {body: cup, eye: [0, -1, 0], target: [0, 0, 0], fovy: 60}}
sensors:
  whole: {sensor_type: camera, width: 40, height: 30, camera: scene/overview, data_types: [mask]}
  close: {sensor_type: camera, width: 41, height: 41, camera: cup, data_types: [mask, depth]}
"""
LIT = """
description: A wall in the light of one lamp.
max_episode_steps: 20
scene:
  ambient: 0.1
  headlight: 0.0
  lights: {lamp: {light_type: point, init_pos: [0, 0, 1.5], intensity: 15}}
objects:
  wall: {shape: {shape_type: Cube, size: [0.2, 4, 4]}, body_type: static, init_pos: [1.6, 0, 1]}
sensors:
  eye: {sensor_type: camera, width: 16, height: 12, fovy: 40,
        extrinsics: {eye: [0, 0, 1], target: [1, 0, 1]}}
"""


@pytest.fixture
def make(tmp_path, monkeypatch):
    """``make(text)``: the environments of a task in an empty folder, with a kitchen's file."""
    monkeypatch.chdir(tmp_path)
    Path("kitchen.xml").write_text(KITCHEN)
    Path("conf", "task").mkdir(parents=True)
    built = []

    def build(text, num_envs=2, **sections):
        tree = yaml.safe_load(text)
        for name, values in sections.items():
            tree[name] = {**tree.get(name, {}), **values}
        Path("conf", "task", "seen.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
        env = embodichain.make("seen", num_envs, ["seed=1"])
        built.append(env)
        env.reset()
        return env

    yield build
    for env in built:
        env.close()


def number(env, uid):
    return env.sim.get_rigid_object(uid).entity.root_body_id


def inner(mask):
    """Pixels whose eight neighbours have the same number."""
    found = np.zeros(mask.shape, np.bool_)
    middle = mask[:, 1:-1, 1:-1]
    found[:, 1:-1, 1:-1] = True
    for i in (0, 1, 2):
        for j in (0, 1, 2):
            other = mask[:, i : i + middle.shape[1], j : j + middle.shape[2]]
            found[:, 1:-1, 1:-1] &= other == middle
    return found


def pixel_rays():
    """Directions (H W, 3) through the middles of the pixels of `ROOM`'s camera."""
    forward = np.array([1.5, 0.0, -0.4]) / np.hypot(1.5, 0.4)
    right = np.array([0.0, -1.0, 0.0])
    down = np.cross(forward, right)
    u = (np.arange(32) + 0.5 - 16.0) / 30.0
    v = (np.arange(24) + 0.5 - 12.0) / 30.0
    across = v[:, None, None] * down + u[None, :, None] * right
    return (forward + across).reshape(-1, 3)


def test_distances_of_a_camera_are_those_of_rays(make):
    """Rays through the middles of all pixels, by MuJoCo, against what OpenGL draws."""
    beam = {
        "sensor_type": "ray",
        "pos": [0.0, 0.0, 0.9],
        "pattern": {"directions": pixel_rays().tolist()},
        "max_range": 50.0,
        "no_hit": "zero",
    }
    env = make(ROOM, sensors={"beam": beam})
    env.sim.get_rigid_object("box").set_local_pose([[1.3, 0.2, 0.6, 1, 0, 0, 0]], env_ids=[1])
    eye = env.get_sensor("eye")
    rays = env.get_sensor("beam").read_distance().reshape(2, 24, 32)
    inside = inner(eye.read("mask")) & (eye.read("distance") > 0)
    assert inside.mean() > 0.3  # the rest is sky, or at an edge
    np.testing.assert_allclose(eye.read("distance")[inside], rays[inside], rtol=2e-3)
    assert (eye.read("depth")[inside] <= eye.read("distance")[inside] + 1e-6).all()
    assert np.abs(rays[0] - rays[1]).max() > 0.1


def test_numbers_of_furniture_ground_and_sky(make):
    env = make(ROOM)
    mask = env.get_sensor("eye").read("mask")
    numbers = {uid: number(env, uid) for uid in ("box", "table")}
    assert set(np.unique(mask)) == {-1, 0, *numbers.values()}
    rows = {n: np.nonzero(mask[0] == n)[0].mean() for n in (-1, *numbers.values())}
    assert rows[-1] < rows[numbers["box"]] < rows[numbers["table"]]  # the sky is above the box
    env.sim.get_rigid_object("box").set_local_pose([[1.5, 0, -5, 1, 0, 0, 0]], env_ids=[1])
    there = (env.get_sensor("eye").read("mask") == numbers["box"]).any(axis=(1, 2))
    assert there.tolist() == [True, False]


def test_without_opengl_depth_and_masks_are_the_same(make, monkeypatch):
    drawn = {name: make(ROOM).get_sensor("eye").read(name) for name in ("depth", "mask")}
    monkeypatch.setenv("EMBODICHAIN_RENDERER", "rays")
    env = make(ROOM, sensors={"color": {**yaml.safe_load(ROOM)["sensors"]["eye"]}})
    cast = {name: env.get_sensor("eye").read(name) for name in ("depth", "mask")}
    inside = inner(drawn["mask"])
    np.testing.assert_array_equal(cast["mask"][inside], drawn["mask"][inside])
    np.testing.assert_allclose(cast["depth"][inside], drawn["depth"][inside], rtol=2e-3)
    assert (cast["mask"] == drawn["mask"]).mean() > 0.98
    with pytest.raises(RenderError, match="colours need OpenGL"):
        env.sim.render()


def test_cameras_of_a_world_file_see_its_bodies_at_the_keyframe(make):
    env = make(KITCHEN_TASK)
    whole = env.get_sensor("whole").read("mask")
    bodies = {uid: number(env, uid) for uid in ("counter", "cup", "cupboard")}
    assert set(bodies.values()) <= set(np.unique(whole))
    # A metre before the cup, a cylinder of 0.04 x 0.12 m that its view follows.
    cup = env.get_sensor("close")
    assert cup.read("mask")[0, 20, 20] == bodies["cup"]
    assert cup.read("depth")[:, 20, 20] == pytest.approx([0.96] * 2, abs=2e-3)
    np.testing.assert_allclose(cup.get_arena_pose()[:, :3], [[0.1, -0.6, 0.86]] * 2, atol=1e-6)
    env.sim.get_rigid_object("cup").set_local_pose([[-0.2, 0.3, 1.5, 1, 0, 0, 0]], env_ids=[1])
    np.testing.assert_allclose(
        cup.get_arena_pose()[:, :3], [[0.1, -0.6, 0.86], [-0.2, -0.7, 1.5]], atol=1e-6
    )
    assert cup.read("depth")[:, 20, 20] == pytest.approx([0.96] * 2, abs=2e-3)
    env.reset()
    np.testing.assert_allclose(cup.get_arena_pose()[1, :3], [0.1, -0.6, 0.86], atol=1e-6)


def test_the_light_of_one_environment(make):
    event = {
        "func": "randomize_light",
        "mode": "reset",
        "params": {"of": {"uid": "lamp"}, "intensity_range": [2.0, 30.0]},
    }
    env = make(LIT, 4, events={"lamp": event})
    bright = env.get_sensor("eye").read("color")[..., :3].mean(axis=(1, 2, 3))
    again = make(LIT, 2, events={"lamp": event})
    few = again.get_sensor("eye").read("color")[..., :3].mean(axis=(1, 2, 3))
    np.testing.assert_array_equal(few, bright[:2])
    assert np.ptp(bright) > 5
    torch.testing.assert_close(
        env.get_sensor("eye").get_data()["color"][..., 3], torch.full((4, 12, 16), 255).byte()
    )
