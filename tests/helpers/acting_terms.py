"""Every built-in action and observation of the UR10 scene of the tests, by name.

They need the command `velocity` and poses kept as ``env.target_pose`` (see `judge_terms`).
"""

from typing import Any

from embodichain.lab.gym.envs.cfg import ActionTermCfg, NoiseCfg, ObservationCfg

ARM = {"entity_cfg": {"uid": "ur10"}}
CUBE = {"entity_cfg": {"uid": "cube"}}
TOOL = {"uid": "ur10", "link_names": ["ee_link"]}
LINKS = {"entity_cfg": {"uid": "ur10", "link_names": ["forearm_link", "wrist_.*_link"]}}
PAIR = {"source_entity_cfg": TOOL, "target_entity_cfg": {"uid": "cube"}}


def _act(func: str, joint: str, params: dict[str, Any], **fields: Any) -> ActionTermCfg:
    entity = {"uid": "ur10", "joint_names": joint}
    return ActionTermCfg(func=func, params={"entity_cfg": entity, **params}, **fields)


ACTIONS = {
    "absolute_eef_pose": ActionTermCfg(
        func="absolute_eef_pose", params={"entity_cfg": TOOL, "pose_dim": 7}
    ),
    "relative_eef_pose": ActionTermCfg(
        func="relative_eef_pose", params={"entity_cfg": TOOL, "rotation_scale": 0.02}
    ),
    "eef_pose": ActionTermCfg(
        func="eef_pose",
        params={"entity_cfg": TOOL, "rotation": "rpy", "posture_gain": 0.1},
        delay=1,
    ),
    "eef_delta_pose": ActionTermCfg(
        func="eef_delta_pose", params={"entity_cfg": TOOL, "frame": "tool", "reference": "qpos"}
    ),
    "joint_position": _act("joint_position", "Joint1", {}, delay=[0, 2]),
    "default_offset_joint_position": _act(
        "default_offset_joint_position",
        "Joint2",
        {"scale": {"Joint2": 0.3}},
        noise=NoiseCfg(std=0.05),
    ),
    "relative_joint_position": _act("relative_joint_position", "Joint3", {"scale": 0.05}),
    "joint_position_to_limits": _act("joint_position_to_limits", "Joint4", {"scale": 0.2}),
    # Before the velocity, which moves the target that it finds.
    "actuator_ctrl": ActionTermCfg(
        func="actuator_ctrl",
        params={**ARM, "actuator_names": "Joint5", "scale": 0.1, "offset": -1.5, "clip": 1.0},
    ),
    "joint_velocity": _act("joint_velocity", "Joint5", {"clip": 0.4}, delay=1),
    "joint_effort": _act("joint_effort", "Joint6", {"scale": 5.0}),
    "parallel_gripper": _act(
        "parallel_gripper", "Joint6", {"lower_command": -3.2, "upper_command": -3.0}
    ),
}
_PARAMS: dict[str, dict[str, Any]] = {
    "get_object_pose": CUBE,
    "get_rigid_object_pose": {**CUBE, "to_matrix": False},
    "link_pose": {**LINKS, "to_matrix": True, "in_root_frame": True},
    "link_velocity": {**LINKS, "in_root_frame": True},
    "get_rigid_object_velocity": CUBE,
    "velocity": CUBE,
    "get_robot_eef_pose": {},
    "target_position": {"target_pose_key": "target_pose"},
    "orientation": CUBE,
    "yaw": {"entity_cfg": TOOL},
    "joint_position": {"entity_cfg": {"uid": "ur10", "joint_names": "Joint[246]"}},
    "joint_position_relative": ARM,
    "joint_pos_limit_normalized": ARM,
    "joint_sin_cos": ARM,
    "joint_velocity": ARM,
    "joint_effort": ARM,
    "root_pos_w": CUBE,
    "root_quat_w": {**CUBE, "make_quat_unique": True},
    "root_lin_vel_w": CUBE,
    "root_ang_vel_w": CUBE,
    "base_lin_vel": CUBE,
    "base_ang_vel": {"entity_cfg": TOOL},
    "projected_gravity": {"entity_cfg": TOOL},
    "base_height": CUBE,
    "relative_position": {**PAIR, "in_source_frame": True},
    "relative_orientation": {**PAIR, "representation": "rot6d"},
    "relative_pose": PAIR,
    "relative_velocity": {**PAIR, "in_source_frame": True},
    "distance": PAIR,
    "gripper_opening": PAIR,
    "last_action": {"action_name": "joint_velocity"},
    "current_time_s": {},
    "remaining_time_s": {},
    "elapsed_fraction": {},
    "phase": {"period_s": 0.3, "offsets": [0.0, 0.5]},
    "get_object_body_scale": CUBE,
    "get_object_uid": CUBE,
    "get_rigid_object_physics_attributes": CUBE,
    "get_articulation_joint_drive": {**ARM, "gains": ["damping", "stiffness"]},
    "generated_command": {"command_name": "velocity"},
}
OBSERVATIONS = {
    **{name: ObservationCfg(func=name, params=params) for name, params in _PARAMS.items()},
    "normalize_robot_joint_data": ObservationCfg(
        func="normalize_robot_joint_data", mode="modify", name="robot/qpos"
    ),
}
