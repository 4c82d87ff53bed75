"""Sites of objects, and meshes that collide piece by piece."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

import embodichain
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.utils.errors import ConfigError
from tests.lab.sim.compiler.scene.test_objects import CUBE_OBJ

TASK = """
description: A stool of three pieces above a ball, and a cup with a place to grasp it.
physics: {physics_dt: 0.002}
objects:
  arch:
    shape: {shape_type: Mesh, fpath: arch.obj}
    collision: COLLISION
    body_type: static
  ball:
    shape: {shape_type: Sphere, radius: 0.2}
    init_pos: [1.5, 0.5, 2.5]
  cup:
    shape: {shape_type: Cylinder, radius: 0.04, height: 0.1}
    body_scale: [2, 2, 3]
    init_pos: [0, 3, 0.15]
    init_rot: [0, 0, 90]
    sites:
      handle: {pos: [0.05, 0, 0.01], rot: [0, 0, 90]}
      inside: {pos: [0, 0, 0.01], size: [0.02, 0.04, 0.08]}
observations:
  handle: {func: position, params: {of: {uid: cup, site_names: handle}}}
"""


def arch() -> str:
    """Two cubes of 1 m with 1 m between them, as an OBJ file."""
    lines = CUBE_OBJ.splitlines()
    second: list[str] = []
    for line in lines:
        kind, *values = line.split()
        if kind == "v":
            second.append(f"v {float(values[0]) + 2} {values[1]} {values[2]}")
        else:
            second.append("f " + " ".join(str(int(value) + 8) for value in values))
    return "\n".join([*lines, *second]) + "\n"


def make(folder: Path, collision: str = "pieces", **changes: str) -> BaseEnv:
    text = TASK.replace("COLLISION", collision).replace("arch.obj", str(folder / "arch.obj"))
    for old, new in changes.items():
        text = text.replace(old, new)
    (folder / "arch.obj").write_text(arch())
    (folder / "task").mkdir(exist_ok=True)
    (folder / "task" / "mine.yaml").write_text(text.lstrip())
    return embodichain.make("mine", 1, config_dir=folder)


@pytest.mark.parametrize(("collision", "height"), [("pieces", 0.2), ("hull", 1.2)])
def test_a_ball_falls_between_pieces_and_stops_at_a_hull(
    tmp_path: Path, collision: str, height: float
) -> None:
    env = make(tmp_path, collision)
    env.reset()
    for _ in range(750):
        env.step(torch.zeros(1, 0))
    found = env.sim.rigid_objects["ball"].get_local_pose()[0, 2]
    env.close()
    assert float(found) == pytest.approx(height, abs=0.01)


def test_a_site_is_a_frame_of_the_object_and_scales_with_it(tmp_path: Path) -> None:
    env = make(tmp_path)
    obs, _ = env.reset()
    # Twice 0.05 m along x, turned to y; three times 0.01 m upwards.
    np.testing.assert_allclose(obs["handle"][0], [0, 3 + 0.1, 0.15 + 0.03], atol=1e-6)
    model = env.sim.engine.model
    inside = model.site("cup/inside")
    env.close()
    assert inside.type[0] == mujoco.mjtGeom.mjGEOM_BOX
    np.testing.assert_allclose(inside.size, [0.02, 0.04, 0.12], atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "path", "words"),
    [
        ("handle: {pos", "handle: {at", "sites.handle.at", "unknown key"),
        ("size: [0.02, 0.04, 0.08]", "size: [0.02, -1, 1]", "sites.inside.size.1", "at least 0"),
        ("rot: [0, 0, 90]}", "quat: [0, 0, 0, 0]}", "sites.handle.quat", "quaternion is zero"),
        ("handle:", "my/handle:", "sites.my/handle", "must not contain '/'"),
        ("body_scale", "collision: pieces\n    body_scale", "collision", "only a Mesh is split"),
    ],
)
def test_mistakes_are_said_at_their_key(
    tmp_path: Path, old: str, new: str, path: str, words: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        make(tmp_path, **{old: new})
    (problem,) = caught.value.problems
    assert problem.path == f"task.objects.cup.{path}"
    assert words in problem.message


def test_pieces_are_as_many_as_they_are(tmp_path: Path) -> None:
    limit = "collision: pieces\n    max_convex_hull_num: 2"
    with pytest.raises(ConfigError, match="has as many parts as pieces; leave this out"):
        make(tmp_path, **{"collision: pieces": limit})
