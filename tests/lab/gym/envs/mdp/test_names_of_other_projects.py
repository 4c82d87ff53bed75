"""Names of Isaac Lab, mjlab and EmbodiChain give the number of their project.

Every registered name that one of them has is in a table here: with the formula of the function that
it names, in numpy, evaluated on the states of a small scene in motion; or with the test that holds
its numbers. Where two projects have one name for two formulas, the table says whose is taken.

The formulas follow Isaac Lab 3 (``isaaclab.envs.mdp``, and the ``mdp`` of its velocity and lift
tasks), mjlab 1.6 (``mjlab.envs.mdp``, ``mjlab.tasks.velocity.mdp``) and EmbodiChain 0.2.1
(``embodichain.lab.gym.envs.managers``). Velocities are those of links' origins, mjlab's; Isaac
Lab's are those of centres of mass. Gravity is not vertical, so that what follows it differs from
what does not.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
import yaml

import embodichain
from embodichain.compat.terms.names_of_others import translations
from embodichain.lab.gym.envs.managers.terms.aliases import AliasSpec
from embodichain.lab.gym.envs.managers.terms.registry import KINDS, SHAPES, TERMS, resolve_term
from embodichain.utils.errors import ConfigError
from tests.helpers.names_of_projects import ISAAC_LAB, MJLAB

ROOT = Path(__file__).parents[5]
STEPS = 14
SUBSTEPS = 4
DT = 0.005
STEP_DT = SUBSTEPS * DT
FEET = ("FL_foot", "FR_foot", "RL_foot", "RR_foot")

_LEG = """
<body name="{name}_thigh" pos="{x} {y} 0">
  <joint name="{name}_hip" axis="0 1 0" range="-0.06 0.12"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.4"/>
  <body name="{name}_calf" pos="0 0 -0.2">
    <joint name="{name}_knee" axis="0 1 0" range="-0.15 0.05"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.015" mass="0.2"/>
    <body name="{name}_foot" pos="0 0 -0.2"><geom size="0.025" mass="0.05"/></body>
  </body>
</body>"""
_ROBOT = """<mujoco model="go"><compiler angle="radian"/><worldbody><body name="trunk"><freejoint/>
  <geom type="box" size="0.22 0.08 0.05" mass="5"/>{legs}
</body></worldbody></mujoco>"""
_LEGS = {"FL": (0.2, 0.1), "FR": (0.2, -0.1), "RL": (-0.2, 0.1), "RR": (-0.2, -0.1)}
_TASK = """
description: A quadruped that falls, tumbles and slides; gravity is not vertical.
physics: {physics_dt: 0.005, gravity: [1.5, -0.8, -9.3]}
sim_steps_per_control: 4
max_episode_steps: 1000
scene: {ground: {friction: 0.6}}
robot:
  uid: go
  fix_base: false
  init_pos: [0, 0, 0.46]
  init_qpos: {".*_hip": 0.05, ".*_knee": -0.1}
  drive_pros: {stiffness: 40, damping: 1.5, max_effort: 6, max_velocity: 5}
objects:
  cube: {shape: {shape_type: Cube, size: [0.1, 0.1, 0.1]}, init_pos: [0.8, 0.3, 0.6]}
  goal: {shape: {shape_type: Sphere, radius: 0.02}, body_type: kinematic,
         attrs: {enable_collision: false}, init_pos: [0.5, 0.2, 0.5]}
sensors:
  contacts: {sensor_type: contact, entity_cfg: {uid: go, link_names: [".*_foot"]}}
  imu: {sensor_type: imu, entity_cfg: {uid: go, link_names: [trunk]}}
  wrench: {sensor_type: force_torque, entity_cfg: {uid: go, link_names: [FL_foot]}}
  scan: {sensor_type: height_scan, entity_cfg: {uid: go, link_names: [trunk]},
         pattern: {grid: {size: [0.2, 0.2], resolution: 0.2}}}
commands:
  velocity: {func: uniform_velocity, resampling_time_s: [99, 99], params: {entity_cfg: {uid: go},
             ranges: {lin_vel_x: [-1, 1], lin_vel_y: [-1, 1], ang_vel_z: [-1, 1]}}}
  pose: {func: uniform_pose, resampling_time_s: [99, 99], params: {entity_cfg: {uid: go,
         link_names: [FL_foot]}, position_range: [[0.1, 0.1, -0.4], [0.3, 0.3, -0.3]],
         euler_range: [[-1, -1, -1], [1, 1, 1]]}}
actions:
  legs: {func: joint_action, params: {of: {uid: go}, centre: home, scale: 0.6, bounds: null}}
"""


@dataclasses.dataclass
class States:
    """What formulas read after one control step; the first axis is the environment.

    Attributes:
        first: Whether it is the first step of the episode.
        root_pos, root_quat: Root's pose, wxyz.
        lin_w, ang_w: Root's velocity at its origin, world axes.
        rot: (N, 3, 3) its axes as columns.
        gravity: (3,) unit vector along gravity.
        q, v: Joints; `v_before` is `v` one control step earlier.
        home, limits, fastest: Initial positions, limits of position, of velocity.
        asked, most: Efforts before the limit in the last physics step, and the limit.
        action, previous, before_previous: Actions; zeros before the episode.
        force: (N, SUBSTEPS, 4) net contact forces on the feet.
        feet_pos, feet_quat, feet_vel: Of the feet's links.
        link_vel, link_vel_before: (N, L, 3) of all links' origins, now and a control step earlier.
        velocity, pose: The commands that were acted on.
        air: (N, 4) seconds that feet had been in the air before this step.
        cube, goal: Positions.
        time: Seconds of the episode.
    """

    first: bool
    root_pos: Any
    root_quat: Any
    lin_w: Any
    ang_w: Any
    rot: Any
    gravity: Any
    q: Any
    v: Any
    v_before: Any
    home: Any
    limits: Any
    fastest: Any
    asked: Any
    most: Any
    action: Any
    previous: Any
    before_previous: Any
    force: Any
    feet_pos: Any
    feet_quat: Any
    feet_vel: Any
    link_vel: Any
    link_vel_before: Any
    velocity: Any
    pose: Any
    air: Any
    cube: Any
    goal: Any
    time: float

    @property
    def lin_b(self) -> Any:
        """Root's linear velocity in its axes."""
        return np.einsum("nji,nj->ni", self.rot, self.lin_w)

    @property
    def ang_b(self) -> Any:
        """Root's angular velocity in its axes."""
        return np.einsum("nji,nj->ni", self.rot, self.ang_w)

    @property
    def gravity_b(self) -> Any:
        """Gravity's direction in the root's axes."""
        return np.einsum("nji,j->ni", self.rot, self.gravity)

    @property
    def touched(self) -> Any:
        """Feet with a force above 1 N in a physics step."""
        return self.force.max(axis=1) > 1.0

    @property
    def applied(self) -> Any:
        """Efforts after the limit."""
        return np.clip(self.asked, -self.most, self.most)


def _product(a: Any, b: Any) -> Any:
    """Hamilton products of wxyz quaternions."""
    out = np.zeros(np.broadcast_shapes(a.shape, b.shape))
    for i in range(len(out)):
        mujoco.mju_mulQuat(out[i], a[i], b[i])
    return out


def _angle(a: Any, b: Any) -> Any:
    """Angle between orientations, rad."""
    inner = np.abs((a * b).sum(axis=1))
    return 2.0 * np.arccos(np.clip(inner, 0.0, 1.0))


def _l2(rows: Any) -> Any:
    return (rows**2).sum(axis=1)


def _pose_error(s: States) -> Any:
    wanted = s.root_pos + np.einsum("nij,nj->ni", s.rot, s.pose[:, :3])
    return np.linalg.norm(s.feet_pos[:, 0] - wanted, axis=1)


def _beyond(s: States) -> Any:
    low, high = s.limits.T
    return np.maximum(low - s.q, 0.0) + np.maximum(s.q - high, 0.0)


def _acceleration(s: States) -> Any:
    return (s.link_vel - s.link_vel_before) / STEP_DT * (0.0 if s.first else 1.0)


def _landing(s: States) -> Any:
    landed = s.touched & (s.air > 0)
    paid = ((s.air + STEP_DT - 0.02) * landed).sum(axis=1)
    return paid * (np.linalg.norm(s.velocity[:, :2], axis=1) > 0.1)


GO = {"of": {"uid": "go"}}
SENSOR = {"sensor": "contacts"}
FOLLOWS = {**GO, "command_name": "velocity", "std": 0.7}
FOOT = {"of": {"uid": "go", "link_names": ["FL_foot"]}, "command_name": "pose"}
TIP = math.radians(11)
Formula = Callable[[States], Any]

# name -> (source, parameters, formula). Booleans are compared as 0 and 1.
VALUES: dict[str, tuple[str, dict[str, Any], Formula]] = {
    # isaaclab.envs.mdp.rewards, and mjlab.envs.mdp.rewards where it has the name, too
    "is_alive": ("Isaac Lab, mjlab: is_alive", {}, lambda s: np.ones(len(s.q))),
    "is_terminated": ("Isaac Lab, mjlab: is_terminated", {}, lambda s: np.zeros(len(s.q))),
    "lin_vel_z_l2": ("Isaac Lab: lin_vel_z_l2", GO, lambda s: s.lin_b[:, 2] ** 2),
    "ang_vel_xy_l2": ("Isaac Lab: ang_vel_xy_l2", GO, lambda s: _l2(s.ang_b[:, :2])),
    "flat_orientation_l2": (
        "Isaac Lab: flat_orientation_l2 (mjlab's gravity points down, whatever the scene's is)",
        GO,
        lambda s: _l2(s.gravity_b[:, :2]),
    ),
    "base_height_l2": (
        "Isaac Lab: base_height_l2",
        {**GO, "target_height": 0.3},
        lambda s: (s.root_pos[:, 2] - 0.3) ** 2,
    ),
    "body_lin_acc_l2": (
        "Isaac Lab: body_lin_acc_l2, of the change over a control step",
        GO,
        lambda s: np.linalg.norm(_acceleration(s), axis=2).sum(axis=1),
    ),
    "joint_torques_l2": (
        "Isaac Lab, mjlab: joint_torques_l2",
        GO,
        lambda s: _l2(s.applied),
    ),
    "joint_vel_l1": ("Isaac Lab: joint_vel_l1", GO, lambda s: np.abs(s.v).sum(axis=1)),
    "joint_vel_l2": ("Isaac Lab, mjlab: joint_vel_l2", GO, lambda s: _l2(s.v)),
    "joint_acc_l2": (
        "Isaac Lab: joint_acc_l2, of the change over a control step",
        GO,
        lambda s: _l2((s.v - s.v_before) / STEP_DT) * (0.0 if s.first else 1.0),
    ),
    "joint_deviation_l1": (
        "Isaac Lab: joint_deviation_l1",
        GO,
        lambda s: np.abs(s.q - s.home).sum(axis=1),
    ),
    "joint_pos_limits": (
        "Isaac Lab, mjlab: joint_pos_limits",
        GO,
        lambda s: _beyond(s).sum(axis=1),
    ),
    "joint_vel_limits": (
        "Isaac Lab: joint_vel_limits",
        {**GO, "soft_ratio": 0.2},
        lambda s: np.clip(np.abs(s.v) - 0.2 * s.fastest, 0.0, 1.0).sum(axis=1),
    ),
    "applied_torque_limits": (
        "Isaac Lab: applied_torque_limits",
        GO,
        lambda s: np.abs(s.applied - s.asked).sum(axis=1),
    ),
    "action_l2": ("Isaac Lab: action_l2", {}, lambda s: _l2(s.action)),
    "action_rate_l2": (
        "Isaac Lab, mjlab: action_rate_l2",
        {},
        lambda s: _l2(s.action - s.previous),
    ),
    "action_acc_l2": (
        "mjlab: action_acc_l2",
        {},
        lambda s: _l2(s.action - 2 * s.previous + s.before_previous),
    ),
    "undesired_contacts": (
        "Isaac Lab: undesired_contacts",
        {**SENSOR, "threshold": 1.0},
        lambda s: s.touched.sum(axis=1),
    ),
    "desired_contacts": (
        "Isaac Lab: desired_contacts",
        {**SENSOR, "threshold": 1.0},
        lambda s: ~s.touched.any(axis=1),
    ),
    "contact_forces": (
        "Isaac Lab: contact_forces",
        {**SENSOR, "threshold": 5.0},
        lambda s: np.maximum(s.force.max(axis=1) - 5.0, 0.0).sum(axis=1),
    ),
    "track_lin_vel_xy_exp": (
        "Isaac Lab: track_lin_vel_xy_exp",
        FOLLOWS,
        lambda s: np.exp(-_l2(s.velocity[:, :2] - s.lin_b[:, :2]) / 0.7**2),
    ),
    "track_ang_vel_z_exp": (
        "Isaac Lab: track_ang_vel_z_exp",
        FOLLOWS,
        lambda s: np.exp(-((s.velocity[:, 2] - s.ang_b[:, 2]) ** 2) / 0.7**2),
    ),
    "position_command_error": ("Isaac Lab: position_command_error", FOOT, _pose_error),
    "position_command_error_tanh": (
        "Isaac Lab: position_command_error_tanh",
        {**FOOT, "std": 0.2},
        lambda s: 1.0 - np.tanh(_pose_error(s) / 0.2),
    ),
    "orientation_command_error": (
        "Isaac Lab: orientation_command_error",
        FOOT,
        lambda s: _angle(_product(s.root_quat, s.pose[:, 3:]), s.feet_quat[:, 0]),
    ),
    # The velocity and lift tasks
    "feet_air_time": (
        "Isaac Lab, velocity: feet_air_time, in control steps (mjlab's is another function)",
        {**SENSOR, "command_name": "velocity", "threshold": 0.02},
        _landing,
    ),
    "feet_slide": (
        "Isaac Lab, velocity: feet_slide",
        SENSOR,
        lambda s: (np.linalg.norm(s.feet_vel[..., :2], axis=2) * s.touched).sum(axis=1),
    ),
    "upright": (
        "mjlab, velocity: upright",
        {**GO, "std": 0.4},
        lambda s: np.exp(-_l2(s.rot[:, 2, :2]) / 0.4**2),
    ),
    "object_goal_distance": (
        "Isaac Lab, lift: object_goal_distance; the goal is an object",
        {
            "object_cfg": {"uid": "cube"},
            "goal_cfg": {"uid": "goal"},
            "std": 0.3,
            "minimal_height": 0.2,
        },
        lambda s: (
            (s.cube[:, 2] > 0.2) * (1.0 - np.tanh(np.linalg.norm(s.cube - s.goal, axis=1) / 0.3))
        ),
    ),
    # isaaclab.envs.mdp.terminations
    "bad_orientation": (
        "Isaac Lab, mjlab: bad_orientation",
        {**GO, "limit_angle": TIP},
        lambda s: np.abs(np.arccos(np.clip(-s.gravity_b[:, 2], -1.0, 1.0))) > TIP,
    ),
    "root_height_below_minimum": (
        "Isaac Lab, mjlab: root_height_below_minimum",
        {**GO, "minimum_height": 0.435},
        lambda s: s.root_pos[:, 2] < 0.435,
    ),
    "joint_pos_out_of_limit": (
        "Isaac Lab: joint_pos_out_of_limit",
        GO,
        lambda s: (_beyond(s) > 0).any(axis=1),
    ),
    "joint_vel_out_of_limit": (
        "Isaac Lab: joint_vel_out_of_limit, here with a limit of its own",
        {**GO, "max_velocity": 2.5},
        lambda s: (np.abs(s.v) > 2.5).any(axis=1),
    ),
    "joint_effort_out_of_limit": (
        "Isaac Lab: joint_effort_out_of_limit",
        GO,
        lambda s: (~np.isclose(s.asked, s.applied)).any(axis=1),
    ),
    "illegal_contact": (
        "Isaac Lab: illegal_contact (mjlab's takes the threshold as force_threshold)",
        {**SENSOR, "threshold": 5.0},
        lambda s: (s.force.max(axis=1) > 5.0).any(axis=1),
    ),
    # embodichain.lab.gym.envs.managers.rewards
    "distance_between_objects": (
        "EmbodiChain: distance_between_objects",
        {
            "source_entity_cfg": {"uid": "cube"},
            "target_entity_cfg": {"uid": "goal"},
            "exponential": True,
            "sigma": 0.4,
        },
        lambda s: np.exp(-_l2(s.cube - s.goal) / (2 * 0.4**2)),
    ),
    "joint_velocity_penalty": (
        "EmbodiChain: joint_velocity_penalty",
        {"robot_uid": "go"},
        lambda s: -np.linalg.norm(s.v, axis=1),
    ),
    "action_smoothness_penalty": (
        "EmbodiChain: action_smoothness_penalty, 0 in the first step",
        {},
        lambda s: -np.linalg.norm(s.action - s.previous, axis=1) * (0.0 if s.first else 1.0),
    ),
    "success_reward": ("EmbodiChain: success_reward", {}, lambda s: np.zeros(len(s.q))),
}

OBSERVATIONS: dict[str, tuple[str, dict[str, Any], Formula]] = {
    "base_lin_vel": ("Isaac Lab, mjlab: base_lin_vel", GO, lambda s: s.lin_b),
    "base_ang_vel": ("Isaac Lab, mjlab: base_ang_vel", GO, lambda s: s.ang_b),
    "projected_gravity": (
        "Isaac Lab: projected_gravity (mjlab's is straight down, whatever the scene's is)",
        GO,
        lambda s: s.gravity_b,
    ),
    "root_pos_w": ("Isaac Lab: root_pos_w", GO, lambda s: s.root_pos),
    "root_quat_w": ("Isaac Lab 2: root_quat_w, wxyz", GO, lambda s: s.root_quat),
    "root_lin_vel_w": ("Isaac Lab: root_lin_vel_w", GO, lambda s: s.lin_w),
    "root_ang_vel_w": ("Isaac Lab: root_ang_vel_w", GO, lambda s: s.ang_w),
    "joint_pos_limit_normalized": (
        "Isaac Lab: joint_pos_limit_normalized",
        GO,
        lambda s: 2.0 * (s.q - s.limits[:, 0]) / (s.limits[:, 1] - s.limits[:, 0]) - 1.0,
    ),
    "joint_effort": ("Isaac Lab: joint_effort", GO, lambda s: s.applied),
    "height_scan": (
        "Isaac Lab: height_scan (mjlab's offset is 0 by default)",
        {"sensor": "scan", "offset": 0.1},
        lambda s: np.repeat(s.root_pos[:, 2:] - 0.1, 4, axis=1),
    ),
    "imu_orientation": ("Isaac Lab 2: imu_orientation", {"sensor": "imu"}, lambda s: s.root_quat),
    "imu_projected_gravity": (
        "Isaac Lab 2: imu_projected_gravity",
        {"sensor": "imu"},
        lambda s: s.gravity_b,
    ),
    "last_action": ("Isaac Lab, mjlab: last_action", {}, lambda s: s.action),
    "current_time_s": ("Isaac Lab: current_time_s", {}, lambda s: np.full((len(s.q), 1), s.time)),
    "remaining_time_s": (
        "Isaac Lab: remaining_time_s",
        {},
        lambda s: np.full((len(s.q), 1), 1000 * STEP_DT - s.time),
    ),
    "get_rigid_object_pose": (
        "EmbodiChain: get_rigid_object_pose",
        {"entity_cfg": {"uid": "cube"}},
        lambda s: s.cube,
    ),
    "get_object_pose": (
        "EmbodiChain: get_object_pose",
        {"entity_cfg": {"uid": "cube"}},
        lambda s: s.cube,
    ),
}

# name -> the test that holds its numbers: events that draw, and what needs another scene.
ELSEWHERE = {
    "time_out": "test_general_rewards",
    "body_incoming_wrench": "test_sensor_terms",
    "distance_to_target": "test_reaching_rewards",
    "incremental_distance_to_target": "test_reaching_rewards",
    "orientation_alignment": "test_reaching_rewards",
    "reaching_behind_object": "test_reaching_rewards",
    "joint_limit_penalty": "test_joint_rewards",
    "get_rigid_object_velocity": "test_body_observations",
    "get_robot_eef_pose": "test_observations",
    "get_object_body_scale": "test_observations",
    "get_object_uid": "test_observations",
    "get_rigid_object_physics_attributes": "test_observations",
    "get_articulation_joint_drive": "test_observations",
    "normalize_robot_joint_data": "test_observations",
    "target_position": "test_observations",
    "reset_scene_to_default": "test_state_events",
    "reset_root_state_uniform": "test_state_events",
    "reset_joints_by_offset": "test_state_events",
    "reset_joints_by_scale": "test_state_events",
    "push_by_setting_velocity": "test_state_events",
    "apply_external_force_torque": "test_state_events",
    "apply_body_impulse": "test_state_events",
    "push_articulation_by_setting_velocity": "test_state_events",
    "encoder_bias": "test_encoder_bias",
    "randomize_actuator_gains": "test_physics_events",
    "randomize_joint_parameters": "test_physics_events",
    "randomize_physics_scene_gravity": "test_physics_events",
    "randomize_rigid_body_material": "test_physics_events",
    "randomize_articulation_mass": "test_physics_events",
    "randomize_rigid_object_mass": "test_physics_events",
    "randomize_rigid_object_center_of_mass": "test_physics_events",
    "randomize_rigid_object_scale": "test_physics_events",
    "randomize_rigid_objects_scale": "test_physics_events",
    "randomize_articulation_root_pose": "test_pose_events",
    "randomize_rigid_object_pose": "test_pose_events",
    "randomize_robot_eef_pose": "test_pose_events",
    "randomize_target_pose": "test_pose_events",
    "sample_rigid_object_pose_from_workspace": "test_pose_events",
    "randomize_robot_qpos": "test_events",
    "randomize_visual_material": "test_visual_events",
    "randomize_light": "test_visual_events",
    "set_rigid_object_visual_material": "test_visual_events",
    "randomize_camera_intrinsics": "test_camera_events",
    "record_camera_data": "test_record",
    "modify_reward_weight": "test_curriculum_manager",
    "planner_grid_cell_sampler": "test_scene_events",
    "prepare_extra_attr": "test_scene_events",
    "register_info_to_env": "test_scene_events",
    "register_entity_attrs": "test_scene_events",
    "register_entity_pose": "test_scene_events",
    "set_detached_uids_for_env_reset": "test_scene_events",
}


def _stepped(env: Any, rows: Any, i: int) -> tuple[Any, Any]:
    """The last control step of environment i again, in MuJoCo.

    Returns:
        (8,) efforts before the limit in its last physics step, and (SUBSTEPS, 4) contact forces.
    """
    engine, robot = env.sim.engine, env.robot
    model = engine.model_of(i)
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, rows, mujoco.mjtState.mjSTATE_INTEGRATION)
    data.ctrl[:] = engine.state("ctrl")[i]
    feet = [model.body(f"go/{name}").id for name in FEET]
    force = np.zeros((SUBSTEPS, 4))
    asked = np.zeros(robot.dof)
    for step in range(SUBSTEPS):
        q = data.qpos[robot.entity.qpos_adr]
        v = data.qvel[robot.entity.dof_adr]
        asked = 40.0 * (data.ctrl[robot.entity.ctrl_ids] - q) - 1.5 * v
        mujoco.mj_step(model, data)
        net = np.zeros((4, 3))
        for c in range(data.ncon):
            wrench = np.zeros(6)
            mujoco.mj_contactForce(model, data, c, wrench)
            world = data.contact[c].frame.reshape(3, 3).T @ wrench[:3]
            for side, sign in ((0, -1.0), (1, 1.0)):
                body = model.geom_bodyid[data.contact[c].geom[side]]
                if body in feet:
                    net[feet.index(body)] += sign * world
        force[step] = np.linalg.norm(net, axis=1)
    assert np.allclose(data.qpos, engine.state("qpos")[i], atol=1e-12)
    return asked, force


def _body_velocity(model: Any, data: Any, body: int) -> Any:
    """(3,) linear velocity of a body's origin, world axes."""
    found = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, found, 0)
    return found[3:]


class Walk:
    """Steps of the scene, and what formulas read after each."""

    def __init__(self, env: Any) -> None:
        self.env = env
        self.count = env.num_envs
        self._actions = [np.zeros((self.count, 8))] * 2
        self._links = [n for n in env.robot.link_names]
        self._before = self._velocities()
        self._air = np.zeros((self.count, 4))
        self._steps = 0

    def _velocities(self) -> tuple[Any, Any]:
        robot, found = self.env.robot, []
        for i in range(self.count):
            data = self.env.sim.engine.data_of(i)
            model = self.env.sim.engine.model_of(i)
            ids = [model.body(f"go/{name}").id for name in self._links]
            found.append([_body_velocity(model, data, body) for body in ids])
        return robot.read_qvel().copy(), np.array(found)

    def step(self, action: Any) -> tuple[States, dict[str, Any], dict[str, Any]]:
        """Step with (N, 8) actions; return what formulas read, rewards, and observations."""
        env = self.env
        engine = env.sim.engine
        rows = engine.rows.copy()
        commands = {n: env.command_manager.values(n).copy() for n in ("velocity", "pose")}
        obs, _, _, _, info = env.step(torch.as_tensor(action, dtype=torch.float32))
        again = [_stepped(env, rows[i], i) for i in range(self.count)]
        v_before, links_before = self._before
        self._before = self._velocities()
        read: dict[str, list[Any]] = {}
        for i in range(self.count):
            model, data = engine.model_of(i), engine.data_of(i)
            trunk = model.body("go/trunk").id
            feet = [model.body(f"go/{name}").id for name in FEET]
            twist = np.zeros(6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, trunk, twist, 0)
            one = {
                "root_pos": data.xpos[trunk],
                "root_quat": data.xquat[trunk],
                "rot": data.xmat[trunk].reshape(3, 3),
                "lin_w": twist[3:],
                "ang_w": twist[:3],
                "feet_pos": data.xpos[feet],
                "feet_quat": data.xquat[feet],
                "feet_vel": [_body_velocity(model, data, body) for body in feet],
                "cube": data.body("cube").xpos,
                "goal": data.body("goal").xpos,
            }
            for name, values in one.items():
                read.setdefault(name, []).append(np.array(values))
        given = np.asarray(action, np.float32).astype(np.float64)
        gravity = np.array([1.5, -0.8, -9.3])
        robot = env.robot
        self._steps += 1
        states = States(
            first=self._steps == 1,
            gravity=gravity / np.linalg.norm(gravity),
            q=robot.read_qpos().copy(),
            v=self._before[0],
            v_before=v_before,
            home=np.asarray(robot.parsed.init_qpos, np.float64),
            limits=np.asarray(robot.parsed.qpos_limits, np.float64),
            fastest=5.0,
            asked=np.array([asked for asked, _ in again]),
            most=6.0,
            action=given,
            previous=self._actions[-1],
            before_previous=self._actions[-2],
            force=np.array([force for _, force in again]),
            link_vel=self._before[1],
            link_vel_before=links_before,
            air=self._air,
            time=self._steps * STEP_DT,
            **commands,
            **{name: np.array(values) for name, values in read.items()},
        )
        self._actions = [*self._actions, given][-2:]
        self._air = np.where(states.touched, 0.0, self._air + STEP_DT)
        return states, info["rewards"], obs


@pytest.fixture(scope="module")
def steps(tmp_path_factory) -> Iterator[list[tuple[States, dict[str, Any], dict[str, Any]]]]:
    """The steps of one episode, with every term of the tables."""
    folder = tmp_path_factory.mktemp("names")
    (folder / "task").mkdir()
    legs = "".join(_LEG.format(name=n, x=x, y=y) for n, (x, y) in _LEGS.items())
    (folder / "task" / "go.xml").write_text(_ROBOT.format(legs=legs))
    tree = yaml.safe_load(_TASK)
    tree["robot"]["fpath"] = str(folder / "task" / "go.xml")
    tree["rewards"] = {n: {"func": n, "params": p} for n, (_, p, _) in VALUES.items()}
    observed = {n: {"func": n, "params": p} for n, (_, p, _) in OBSERVATIONS.items()}
    tree["observations"] = observed
    (folder / "task" / "tumble.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
    env = embodichain.make("tumble", 3, ["seed=4"], config_dir=folder)
    rng = np.random.default_rng(1)
    try:
        env.reset()
        walk = Walk(env.unwrapped)
        found = []
        for _ in range(STEPS):
            states, rewards, obs = walk.step(rng.normal(size=(3, 8)) * 1.5)
            kept = {n: obs[n].double().numpy().copy() for n in OBSERVATIONS}
            found.append((states, {n: r.double().numpy().copy() for n, r in rewards.items()}, kept))
        yield found
    finally:
        env.close()


@pytest.mark.parametrize("name", VALUES)
def test_a_name_gives_the_number_of_its_source(steps, name) -> None:
    _, _, formula = VALUES[name]
    wanted = np.array([np.asarray(formula(states), np.float64) for states, _, _ in steps])
    found = np.array([rewards[name] for _, rewards, _ in steps])
    assert found == pytest.approx(wanted, rel=2e-5, abs=2e-6)


@pytest.mark.parametrize("name", OBSERVATIONS)
def test_an_observation_gives_the_numbers_of_its_source(steps, name) -> None:
    _, _, formula = OBSERVATIONS[name]
    for states, _, seen in steps:
        wanted, found = np.asarray(formula(states), np.float64), seen[name]
        if found.shape[1:] == (4, 4):  # a pose as a matrix
            found = found[:, :3, 3]
        found = found.reshape(len(found), -1)
        assert found == pytest.approx(wanted, rel=2e-5, abs=2e-6)


def test_the_scene_tells_formulas_apart(steps) -> None:
    """Formulas are compared where they are not 0 all the time, in one environment at least."""
    constant = set()
    for name, (_, _, formula) in VALUES.items():
        values = np.array([np.asarray(formula(states), np.float64) for states, _, _ in steps])
        if np.ptp(values) == 0:
            constant.add(name)
    assert constant == {"is_alive", "is_terminated", "success_reward"}


UPSTREAM = json.loads(
    (ROOT / "embodichain" / "compat" / "upstream_names.json").read_text(encoding="utf-8")
)
EMBODICHAIN = {
    name
    for module in ("events", "observations", "randomization", "rewards", "record")
    for name in UPSTREAM[f"embodichain.lab.gym.envs.managers.{module}"]
}
TABLES = {**VALUES, **OBSERVATIONS}
OURS = {
    *("joint_within", "joint_vel_within", "joint_pos_outside", "tolerance_joint_position"),
    *("tolerance_joint_velocity", "tolerance_action", "within_distance", "distance_tanh"),
    *("tolerance_distance", "within_orientation", "orientation_error", "orientation_tanh"),
    *("tolerance_orientation", "height_above", "height_below", "object_height"),
    *("tolerance_height", "out_of_bounds", "tolerance_velocity", "joint_position_relative"),
    *("base_height", "generated_command", "joint_position", "default_offset_joint_position"),
    *("relative_joint_position", "joint_position_to_limits", "joint_velocity"),
    *("absolute_eef_pose", "relative_eef_pose", "randomize_link_com", "randomize_link_inertia"),
    *("randomize_ground_material", "randomize_effort_limits", "randomize_actuator_strength"),
}
"""Aliases that are no name of these projects."""


def _registered() -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    for kind in KINDS:
        for name, spec in TERMS[kind].items():
            if spec.func.__module__.startswith("embodichain."):
                found.setdefault(name, []).append(spec)
    return found


def test_every_alias_and_every_name_of_these_projects_is_in_a_table() -> None:
    theirs = ISAAC_LAB | MJLAB | EMBODICHAIN
    registered = _registered()
    aliases = {n for n, specs in registered.items() if any(isinstance(s, AliasSpec) for s in specs)}
    wanted = (registered.keys() & theirs) | aliases
    missing = wanted - TABLES.keys() - ELSEWHERE.keys() - OURS
    assert not missing, f"give {sorted(missing)} a row: their source's formula, or a test"
    gone = (TABLES.keys() | ELSEWHERE.keys() | OURS) - registered.keys()
    assert not gone, f"not registered any more: {sorted(gone)}"
    assert not OURS & theirs


@pytest.mark.parametrize("name", ELSEWHERE)
def test_other_names_are_held_by_a_test(name) -> None:
    file = next(ROOT.glob(f"tests/lab/gym/**/{ELSEWHERE[name]}.py"))
    assert name in file.read_text(encoding="utf-8")


@pytest.mark.parametrize(("project", "names"), [("Isaac Lab", ISAAC_LAB), ("mjlab", MJLAB)])
def test_every_name_of_a_project_is_registered_or_answered(project, names) -> None:
    registered = _registered()
    table = translations()[project]
    for name in sorted(names - registered.keys()):
        with pytest.raises(ConfigError) as error:
            resolve_term("reward", name)
        assert f"It is a name of {project}" in str(error.value) or " and mjlab" in str(error.value)
        assert table[name] in str(error.value)
    assert not table.keys() & registered.keys(), "registered names need no translation"


def _terms_in(text: str) -> list[Any]:
    """The ``{func: ...}`` in a text."""
    found = []
    start = text.find("{func:")
    while start >= 0:
        depth = 0
        for end in range(start, len(text)):
            depth += {"{": 1, "}": -1}.get(text[end], 0)
            if depth == 0:
                break
        found.append(yaml.safe_load(text[start : end + 1]))
        start = text.find("{func:", end)
    return found


def _check_term(term: Any) -> None:
    """A term that a translation names exists, and has the parameters and shapes."""
    specs = _registered()[term["func"]]
    params = term.get("params", {})
    assert any(s.written(params).keys() == params.keys() for s in specs), term
    for inner in params.get("terms", {}).values():
        _check_term(inner)
    shapes = term.get("shape", [])
    for shape in shapes if isinstance(shapes, list) else [shapes]:
        assert (shape if isinstance(shape, str) else next(iter(shape))) in SHAPES, term


@pytest.mark.parametrize("project", ["Isaac Lab", "mjlab"])
def test_what_a_translation_names_exists(project) -> None:
    for name, text in translations()[project].items():
        terms = _terms_in(text)
        assert terms or text.startswith(("nothing", "no term", "a reward with")), (name, text)
        for term in terms:
            _check_term(term)


@pytest.mark.parametrize(
    ("kind", "name", "here"),
    [
        ("observation", "joint_pos_rel", "joint_position_relative"),
        ("observation", "joint_vel_rel", "joint_velocity"),
        ("observation", "generated_commands", "generated_command"),
        ("observation", "base_pos_z", "base_height"),
        ("observation", "image", "camera_image"),
        ("observation", "imu_ang_vel", "imu_angular_velocity"),
        ("action", "JointPositionAction", "bounds: null"),
    ],
)
def test_an_unknown_name_is_answered_with_what_to_write(kind, name, here) -> None:
    with pytest.raises(ConfigError, match=f"unknown {kind} term '{name}'.*here: {{func: .*{here}"):
        resolve_term(kind, name)
