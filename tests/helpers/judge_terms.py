"""Parameters of every built-in reward, metric and termination for the UR10 scene of the tests.

They need the commands `velocity` and `pose` and poses kept as ``env.target_pose``.
"""

from typing import Any

from embodichain.lab.gym.envs.cfg import CommandCfg, EventCfg

ARM = {"entity_cfg": {"uid": "ur10"}}
CUBE = {"entity_cfg": {"uid": "cube"}}
TOOL = {"uid": "ur10", "link_names": ["ee_link"]}
LINK = {"entity_cfg": TOOL}
PAIR = {"source_entity_cfg": TOOL, "target_entity_cfg": {"uid": "goal"}}
WIDE = [[-9, -9, -9], [9, 9, 9]]
VELOCITY = {"command_name": "velocity"}
POSE = {"command_name": "pose"}
RANGES = {"lin_vel_x": [-1.0, 1.0], "lin_vel_y": [-0.2, 0.2], "ang_vel_z": [-1.0, 1.0]}
BOX = [[-0.2, -0.2, -0.2], [0.2, 0.2, 0.2]]
FAR = {**PAIR, "threshold": 0.9}
HIGH = {**LINK, "threshold": 1.2}
NEAR_AND_HIGH = {
    "near": {"func": "within_distance", "params": FAR},
    "high": {"func": "height_above", "params": HIGH},
}

COMMANDS = {
    "velocity": CommandCfg(
        func="uniform_velocity", resampling_time_s=[0.1, 0.3], params={**CUBE, "ranges": RANGES}
    ),
    "pose": CommandCfg(
        func="uniform_pose", params={**LINK, "position_range": BOX, "euler_range": BOX}
    ),
}
EVENTS = {"target": EventCfg(func="randomize_target_pose", params={"position_range": BOX})}

NEVER = {"never": {"func": "height_above", "params": {**CUBE, "threshold": 3.0}}}
PREDICATES: dict[str, dict[str, Any]] = {
    "within_distance": {**PAIR, "threshold": 0.08},
    "within_orientation": {**PAIR, "threshold": 0.5},
    "within_pose": {**PAIR, "position_threshold": 0.5, "orientation_threshold": 0.5},
    "height_above": {**LINK, "threshold": 3.0},
    "height_below": {**CUBE, "threshold": -0.5},
    "joint_within": {**ARM, "bounds": [-0.1, 0.0], "periodic": True},
    "joint_vel_within": {**ARM, "threshold": 0.01},
    "at_rest": {**LINK, "linear_threshold": 0.001, "angular_threshold": 0.1},
    "all_of": {"terms": NEAR_AND_HIGH},
    "any_of": {"terms": NEVER},
    "follows_velocity": {**CUBE, **VELOCITY, "linear_threshold": 0.1},
    "held_for": {"term": NEAR_AND_HIGH["near"], "steps": 7},
}
REWARDS: dict[str, dict[str, Any]] = {
    **PREDICATES,
    "distance_between_objects": {**PAIR, "exponential": True, "sigma": 0.3},
    "distance_to_target": {"source_entity_cfg": TOOL, "exponential": True, "sigma": 0.5},
    "incremental_distance_to_target": {"source_entity_cfg": TOOL, "negative_weight": 2.0},
    "reaching_behind_object": {
        "object_cfg": {"uid": "cube"},
        "target_pose_key": "target_pose",
    },
    "distance_tanh": {**PAIR, "std": 0.3},
    "object_goal_distance": {
        "object_cfg": TOOL,
        "goal_cfg": {"uid": "goal"},
        "std": 0.4,
        "minimal_height": 0.0,
    },
    "orientation_alignment": PAIR,
    "orientation_error": PAIR,
    "orientation_tanh": {**PAIR, "std": 0.7},
    "flat_orientation_l2": LINK,
    "upright": {**LINK, "std": 0.5},
    "success_reward": {},
    "is_alive": {},
    "is_terminated": {},
    "constant": {"value": -0.1},
    "joint_velocity_penalty": {"robot_uid": "ur10"},
    "joint_vel_l1": ARM,
    "joint_target_error": ARM,
    "joint_vel_l2": ARM,
    "joint_acc_l2": ARM,
    "joint_torques_l2": ARM,
    "joint_power": ARM,
    "joint_deviation_l1": ARM,
    "stand_still": {**ARM, **VELOCITY, "command_threshold": 0.5},
    "joint_limit_penalty": {"margin": 0.4},
    "joint_pos_limits": {**ARM, "soft_ratio": 0.2},
    "joint_vel_limits": {**ARM, "soft_ratio": 0.1},
    "applied_torque_limits": {**ARM, "soft_ratio": 0.1},
    "action_l2": {},
    "action_rate_l2": {},
    "action_acc_l2": {},
    "action_smoothness_penalty": {},
    "track_lin_vel_xy_exp": {**CUBE, **VELOCITY, "std": 0.7, "frame": "yaw"},
    "track_ang_vel_z_exp": {**CUBE, **VELOCITY, "std": 0.7},
    "lin_vel_z_l2": CUBE,
    "ang_vel_xy_l2": CUBE,
    "base_height_l2": {**CUBE, "target_height": 0.3},
    "object_height": LINK,
    "body_lin_acc_l2": LINK,
    "position_command_error": {**LINK, **POSE},
    "position_command_error_tanh": {**LINK, **POSE, "std": 0.5},
    "orientation_command_error": {**LINK, **POSE},
    "tolerance_distance": {**PAIR, "margin": 0.5},
    "tolerance_height": {**LINK, "bounds": [1.5, 9.0], "margin": 0.5, "sigmoid": "cosine"},
    "tolerance_orientation": {**LINK, "margin": 2.0, "sigmoid": "hyperbolic"},
    "tolerance_velocity": {
        **LINK,
        "bounds": [1.0, 2.0],
        "margin": 1.0,
        "sigmoid": "tanh_squared",
        "direction": [1, 1, 0],
        "frame": "body",
    },
    "tolerance_joint_position": {**ARM, "margin": 2.0, "sigmoid": "long_tail"},
    "tolerance_joint_velocity": {**ARM, "margin": 2.0, "sigmoid": "reciprocal"},
    "tolerance_action": {"margin": 5.0, "sigmoid": "quadratic", "value_at_margin": 0.0},
    "sum_of": {
        "terms": {
            "high": {"func": "object_height", "weight": -0.5, "params": LINK},
            "near": {"func": "distance_tanh", "weight": 2.0, "params": {**PAIR, "std": 1.0}},
        }
    },
    "product_of": {
        "terms": {
            "high": {"func": "object_height", "params": LINK},
            "near": {"func": "distance_tanh", "params": {**PAIR, "std": 1.0}},
        }
    },
}
TERMINATIONS: dict[str, dict[str, Any]] = {
    **PREDICATES,
    "all_of": {"terms": NEAR_AND_HIGH | NEVER},
    "time_out": {"time_limit_s": 0.5},
    "out_of_bounds": {**CUBE, "bounds": WIDE},
    "bad_orientation": {**CUBE, "limit_angle": 3.0},
    "root_height_below_minimum": {**CUBE, "minimum_height": -0.3},
    "joint_pos_out_of_limit": {**ARM, "soft_ratio": 0.9},
    "joint_pos_outside": {**ARM, "bounds": [-4.0, 4.0]},
    "joint_vel_out_of_limit": {**ARM, "max_velocity": 50.0},
    "joint_effort_out_of_limit": {
        "entity_cfg": {"uid": "ur10", "joint_names": "Joint1"},
    },
}
