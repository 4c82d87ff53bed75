"""A small correct task in ./conf, whose lines the tests break one at a time."""

from collections.abc import Callable
from pathlib import Path

import pytest

GOOD = """\
description: A small task.
physics: {physics_dt: 0.005}
max_episode_steps: 50
robot:
  uid: arm
  fpath: UniversalRobots/UR10/UR10.urdf
  init_qpos: [0, -1, 1, 0, 0, 0]
objects:
  ball: {shape: {shape_type: Sphere, radius: 0.05}, body_type: kinematic}
  box:
    shape:
      shape_type: Cube
      size: [0.1, 0.1, 0.1]
    init_pos: [0.5, 0, 0.05]
actions:
  arm: {func: joint_position, params: {entity_cfg: {uid: arm}}}
events:
  move:
    func: randomize_rigid_object_pose
    mode: interval
    interval_step: 5
    params: {entity_cfg: {uid: ball}}
rewards:
  near:
    func: within_distance
    weight: 0.5
    params: &pair
      source_entity_cfg: {uid: arm, link_names: [ee_link]}
      target_entity_cfg: {uid: ball}
      threshold: 0.05
metrics:
  success: {func: within_distance, params: {<<: *pair, threshold: 0.1}}
suggested:
  run: {num_envs: 2, episodes: 3}
"""

WriteTask = Callable[..., Path]


@pytest.fixture
def write_task(empty_cwd: Path) -> WriteTask:
    """Writes conf/task/NAME.yaml; `old` of the good task is replaced by `new`."""

    def write(old: str = "", new: str = "", name: str = "mine", text: str | None = None) -> Path:
        assert old in GOOD, f"{old!r} is not in the good task"
        path = Path("conf", "task", f"{name}.yaml")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(GOOD.replace(old, new, 1) if text is None else text)
        return path

    return write
