"""Small robots as text, and running a compiled scene on plain MuJoCo."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import ArticulationCfg, RobotCfg, SimulationManagerCfg
from embodichain.lab.sim.compiler.compile_scene import CompiledScene
from embodichain.lab.sim.sim_manager import SimulationManager

UR10 = "UniversalRobots/UR10/UR10.urdf"
HOME = [1.57079, -1.57079, 1.57079, -1.57079, -1.57079, -3.14159]

INERTIAL = (
    '<inertial><mass value="1"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
)

GRIPPER_URDF = f"""<robot name="gripper">
  <link name="base">{INERTIAL}
    <visual><geometry><box size="0.2 0.2 0.2"/></geometry></visual>
    <collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision>
  </link>
  <link name="left">{INERTIAL}
    <collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>
  </link>
  <link name="right">{INERTIAL}
    <collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>
  </link>
  <link name="tool"/>
  <joint name="slide_left" type="prismatic">
    <parent link="base"/><child link="left"/><origin xyz="0.1 0 0"/><axis xyz="1 0 0"/>
    <limit lower="-0.5" upper="0.5" effort="20" velocity="0.3"/>
    <dynamics damping="0.4" friction="0.2"/>
  </joint>
  <joint name="slide_right" type="prismatic">
    <parent link="base"/><child link="right"/><origin xyz="-0.1 0 0"/><axis xyz="1 0 0"/>
    <limit lower="-0.5" upper="0.5" effort="20" velocity="0.3"/>
    <mimic joint="slide_left" multiplier="-2" offset="0.1"/>
  </joint>
  <joint name="mount" type="fixed"><parent link="left"/><child link="tool"/></joint>
</robot>
"""

HOPPER_MJCF = """<mujoco model="hopper">
  <compiler angle="degree"/>
  <option timestep="0.003" integrator="RK4" impratio="10">
    <flag contact="disable" energy="enable"/>
  </option>
  <default>
    <default class="limb"><joint damping="3" armature="0.02"/>
      <default class="foot"><geom rgba="1 0 0 1" friction="0.9"/></default>
    </default>
  </default>
  <worldbody>
    <light name="lamp" pos="0 0 3"/>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <geom name="post" type="box" size="0.1 0.1 0.1" pos="3 0 0"/>
    <body name="torso" pos="0 0 0.5">
      <freejoint name="float"/>
      <geom size="0.1"/>
      <site name="imu"/>
      <body name="leg" pos="0.3 0 0">
        <joint name="hip" class="limb" axis="0 1 0" range="-90 90"/>
        <geom class="foot" size="0.05" pos="0.2 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="spare" joint="hip" ctrlrange="-2 2" gear="3"/>
    <position name="servo" joint="hip" kp="30" kv="2"/>
  </actuator>
  <sensor>
    <jointpos name="angle" joint="hip"/>
    <actuatorfrc name="effort" actuator="servo"/>
    <gyro name="gyro" site="imu"/>
  </sensor>
  <keyframe>
    <key name="crouch" qpos="0 0 0.1 1 0 0 0 0.1" ctrl="0 0.1"/>
    <key name="home" qpos="0 0 0.4 1 0 0 0 0.5" ctrl="0 0.5"/>
  </keyframe>
</mujoco>
"""


def write(path: Path, text: str) -> str:
    """Write a file and return its name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return str(path)


def scene_of(
    robots: Mapping[str, ArticulationCfg],
    objects: Mapping[str, Any] | None = None,
    sim: SimulationManagerCfg | None = None,
) -> CompiledScene:
    """The scene of a simulation with these entities, which logs messages for the user."""
    manager = SimulationManager(sim or SimulationManagerCfg(headless=True))
    for uid, cfg in robots.items():
        cfg = dataclasses.replace(cfg, uid=uid)
        if isinstance(cfg, RobotCfg):
            manager.add_robot(cfg)
        else:
            manager.add_articulation(cfg)
    for uid, cfg in (objects or {}).items():
        manager.add_rigid_object(dataclasses.replace(cfg, uid=uid))
    return manager.scene


def start(scene: CompiledScene, init_qpos: Mapping[str, Any]) -> mujoco.MjData:
    """The scene as it starts, drives' targets at the initial positions."""
    data = mujoco.MjData(scene.model)
    for uid, index in scene.entities.items():
        if index.mocap_id >= 0:
            data.mocap_pos[index.mocap_id] = index.pos0
            data.mocap_quat[index.mocap_id] = index.quat0
        elif index.free_qpos_adr >= 0:
            data.qpos[index.free_qpos_adr :][:7] = [*index.pos0, *index.quat0]
        if uid in init_qpos:
            qpos = np.asarray(init_qpos[uid])
            data.qpos[index.qpos_adr] = qpos
            driven = index.actuator_ids >= 0
            data.ctrl[index.actuator_ids[driven]] = qpos[driven]
    mujoco.mj_forward(scene.model, data)
    return data


def touching(scene: CompiledScene, data: mujoco.MjData) -> set[frozenset[str]]:
    """Pairs of bodies that are in contact."""
    model = scene.model
    return {
        frozenset(model.body(int(model.geom_bodyid[g])).name for g in (c.geom1, c.geom2))
        for c in data.contact
    }
