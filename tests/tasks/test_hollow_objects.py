"""A bowl made of convex parts, as a gripper and a ball meet it."""

from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

import embodichain
from tests.helpers.hollow_meshes import write_revolved

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

N = 16
RIM = np.array([0.0, -0.067, 0.05])  # the middle of the wall, where the fingers move along y
PICK_PLACE = Path(embodichain.__file__).parent / "conf" / "task" / "pick_place.yaml"


@pytest.fixture
def env(tmp_path):
    """The task `pick_place` with a bowl in place of the cube, and a ball above it."""
    tree = yaml.safe_load(PICK_PLACE.read_text())
    tree["objects"]["cube"] = {
        "shape": {"shape_type": "Mesh", "fpath": write_revolved(tmp_path / "bowl.obj")},
        "collision": "decompose",
        "attrs": {"mass": 0.15, "dynamic_friction": 0.8},
        "init_pos": [0.65, -0.2, 0.7],
    }
    tree["objects"]["ball"] = {
        "shape": {"shape_type": "Sphere", "radius": 0.015},
        "attrs": {"mass": 0.02},
        "init_pos": [0.65, -0.2, 0.76],
    }
    del tree["events"]["place_cube"], tree["terminations"]
    (tmp_path / "task").mkdir()
    (tmp_path / "task" / "bowls.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
    made = embodichain.make("bowls", N, ["seed=1"], config_dir=tmp_path)
    made.reset()
    yield made
    made.close()


def test_a_bowl_is_lifted_by_its_rim_with_a_ball_inside(env):
    objects = env.sim.get_rigid_object
    shift = torch.linspace(-0.08, 0.08, N)
    for uid in ("cube", "ball"):
        pose = objects(uid).get_local_pose()
        pose[:, 0] += shift
        objects(uid).set_local_pose(pose)

    def at(uid):
        return objects(uid).get_local_pose()[:, :3].numpy().astype(float)

    def tool():
        return env.robot.get_link_pose("gripper/tcp")[:, :3].numpy().astype(float)

    def step(move, grip):
        action = np.zeros((N, 7), np.float32)
        action[:, :3], action[:, -1] = np.asarray(move) / 0.02, grip
        env.step(torch.from_numpy(action))

    def hold(grip, steps):
        for _ in range(steps):
            step(0.0, grip)

    def go(to, grip):
        for _ in range(2):
            way = to - tool()
            count = int(np.ceil(np.linalg.norm(way, axis=1).max() / 0.012))
            for _ in range(count):
                step(way / count, grip)
            hold(grip, 4)

    hold(1.0, 15)
    # The ball rests on the bottom, which is 6 mm thick; on a hull it would lie on the rim.
    np.testing.assert_allclose((at("ball") - at("cube"))[:, 2], 0.006 + 0.015, atol=0.002)
    up = np.array([0.0, 0.0, 1.0])
    rim = at("cube") + RIM
    go(rim + 0.1 * up, 1.0)
    go(rim - 0.012 * up, 1.0)
    hold(-1.0, 15)
    before = at("cube")
    go(tool() + 0.15 * up, -1.0)
    assert (at("cube") - before)[:, 2].min() > 0.12  # it hangs a little askew
    inside = np.linalg.norm(at("ball") - at("cube"), axis=1)
    assert inside.max() < 0.05
