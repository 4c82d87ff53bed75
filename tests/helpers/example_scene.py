"""A scene in which the example of every registered term can be built.

It has the robots `ur10`, `go` (a quadruped on a floating base) and `panda` (a gripper on an arm
without drives), the objects `cube` and `goal`, a light,
sensors, commands, and poses kept by name. Terms and the scene itself are declared in YAML and go
the way that a user's task goes.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml
from PIL import Image

import embodichain
from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["TERRAIN", "environment", "write_task"]

TERRAIN = (
    "task.scene.ground=null",
    "+task.scene.terrain={levels: 2, friction: 0.3, patches: {flat: {type: flat}}}",
    "+task.events.ground={func: place_terrain}",
)
"""Overrides with a flat terrain instead of the plane."""

_LEG = """
    <body name="{name}_thigh" pos="{x} {y} 0">
      <joint name="{name}_hip" axis="0 1 0" range="-1.5 1.5"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.4"/>
      <body name="{name}_calf" pos="0 0 -0.2">
        <joint name="{name}_knee" axis="0 1 0" range="-2.5 0.1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.015" mass="0.2"/>
        <body name="{name}_foot" pos="0 0 -0.2"><geom size="0.025" mass="0.05"/></body>
      </body>
    </body>"""
_LEGS = {"FL": (0.2, 0.1), "FR": (0.2, -0.1), "RL": (-0.2, 0.1), "RR": (-0.2, -0.1)}
_QUADRUPED = """<mujoco model="go"><worldbody><body name="trunk">
    <freejoint/>
    <geom type="box" size="0.22 0.08 0.05" mass="5"/>{legs}
</body></worldbody></mujoco>"""

_SCENE = """
description: Everything that an example may name.
max_episode_steps: 50
scene: {ground: {friction: 0.3}}
robot: {uid: ur10, fpath: UniversalRobots/UR10/UR10.urdf, init_pos: [0, 0, 1],
        init_qpos: [1.57, -1.57, 1.57, -1.57, -1.57, 0]}
robots:
  panda: {fpath: panda_description/urdf/panda.urdf, init_pos: [0, -1.5, 0],
          init_qpos: [0, -0.57, 0, -2.2, 0, 2.4, 0.74, 0.04, 0.04],
          drive_pros: {stiffness: {"panda_joint.*": 0, "panda_finger.*": 1000},
                       damping: {"panda_joint.*": 0, "panda_finger.*": 100}}}
  go: {fix_base: false, init_pos: [2, 0, 0.45],
       drive_pros: {stiffness: 40, damping: 2}}
objects:
  cube: {shape: {shape_type: Cube, size: [0.1, 0.1, 0.1]}, init_pos: [0.6, 0.3, 0.05]}
  goal: {shape: {shape_type: Sphere, radius: 0.02}, body_type: kinematic,
         attrs: {enable_collision: false}, init_pos: [0.5, 0.2, 0.5]}
  painted: {shape: {shape_type: Cube, size: [0.1, 0.1, 0.1], visual_material: {textures: [here]}},
            body_type: static, init_pos: [-0.6, 0.3, 0.05]}
  thing: {any_of: {box: {shape: {shape_type: Cube, size: [0.1, 0.1, 0.1]}},
                   can: {shape: {shape_type: Cylinder, radius: 0.04, height: 0.1}}},
          init_pos: [-0.6, 0.6, 0.05]}
lights:
  lamp: {init_pos: [0, 0, 3]}
sensors:
  contacts: {sensor_type: contact, entity_cfg: {uid: go, link_names: [".*foot.*"]}}
  fingers: {sensor_type: contact, entity_cfg: {uid: panda, link_names: ["panda_.*finger"]}}
  imu: {sensor_type: imu, entity_cfg: {uid: go, link_names: [trunk]}}
  wrench: {sensor_type: force_torque, entity_cfg: {uid: ur10, link_names: [wrist_3_link]}}
  scan: {sensor_type: height_scan, entity_cfg: {uid: go, link_names: [trunk]},
         pattern: {grid: {size: [0.4, 0.4], resolution: 0.2}}}
  load: {sensor_type: joint_torque, entity_cfg: {uid: ur10}}
  front: {sensor_type: camera, width: 16, height: 12, fovy: 60, data_types: [color, mask, position],
          extrinsics: {eye: [2, -2, 2], target: [0.5, 0, 0.5]}}
  wrist: {sensor_type: camera, width: 12, height: 16, data_types: [color, depth],
          entity_cfg: {uid: ur10, link_names: [ee_link]}}
commands:
  velocity: {func: uniform_velocity, params: {entity_cfg: {uid: go}, ranges: {lin_vel_x: [-1, 1]}}}
  pose:
    func: uniform_pose
    params:
      entity_cfg: {uid: ur10, link_names: [ee_link]}
      position_range: [[0.2, 0.2, 1], [0.5, 0.5, 1.3]]
actions:
  arm: {func: joint_position, params: {entity_cfg: {uid: ur10}}}
events:
  target: &pose
    func: randomize_target_pose
    params: {position_range: [[0.3, -0.3, 0.5], [0.7, 0.3, 0.9]], store_key: target_pose}
  goal:
    <<: *pose
    params: {position_range: [[0.3, -0.3, 0.5], [0.7, 0.3, 0.9]], store_key: goal_pose}
rewards:
  effort: {func: action_l2, weight: -0.01}
"""


@contextmanager
def environment(
    section: str,
    terms: dict[str, dict[str, Any]],
    folder: Path,
    num_envs: int = 2,
    overrides: tuple[str, ...] = (),
) -> Iterator[BaseEnv]:
    """Make the scene's environment with further terms in a section, and close it in the end.

    Args:
        section: Of the task: ``rewards``.
        terms: Name -> declaration.
        folder: An empty one for the task's files.
        num_envs: N.
        overrides: Of the config.
    """
    write_task(section, terms, folder)
    lines = ["seed=1", *overrides]
    env = embodichain.make("everything", num_envs, lines, config_dir=folder)
    try:
        yield env
    finally:
        env.close()


def write_task(section: str, terms: dict[str, dict[str, Any]], folder: Path) -> None:
    """Write the scene as the task `everything`, with further terms in a section.

    Args:
        section: Of the task: ``rewards``.
        terms: Name -> declaration.
        folder: An empty one for the task's files.
    """
    legs = "".join(_LEG.format(name=n, x=x, y=y) for n, (x, y) in _LEGS.items())
    tree = copy.deepcopy(yaml.safe_load(_SCENE))
    if section == "actions":
        tree["actions"] = {}
    tree.setdefault(section, {}).update(terms)
    (folder / "task").mkdir(parents=True)
    tree["robots"]["go"]["fpath"] = str(folder / "task" / "go.xml")
    tree["objects"]["painted"]["shape"]["visual_material"]["textures"] = [str(folder / "task")]
    for name in ("red", "blue"):
        Image.new("RGB", (4, 4), name).save(folder / "task" / f"{name}.png")
    (folder / "task" / "go.xml").write_text(_QUADRUPED.format(legs=legs))
    (folder / "task" / "everything.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
