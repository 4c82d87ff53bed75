"""One declaration of every event that places, pushes, registers or paints, for tests over all."""

from embodichain.lab.gym.envs.cfg import EventCfg
from embodichain.lab.sim.cfg import LightCfg

ARM = {"entity_cfg": {"uid": "ur10"}}
CUBE = {"entity_cfg": {"uid": "cube"}}
GOAL = {"entity_cfg": {"uid": "goal"}}
TOOL = {"entity_cfg": {"uid": "ur10", "link_names": ["ee_link"]}}
SMALL = [[-0.05, -0.05, -0.05], [0.05, 0.05, 0.05]]
COLORS = [[0, 0, 0], [1, 1, 1]]

LIGHTS = {"lamp": LightCfg(light_type="spot", init_pos=(0.5, 0.5, 2.0))}


def _at(mode: str, func: str, every: int = 10, **params) -> EventCfg:
    return EventCfg(func=func, mode=mode, interval_step=every, params=params)


EVENTS = {
    "detach": _at("startup", "set_detached_uids_for_env_reset", uids=["goal"]),
    "extra": _at(
        "startup",
        "prepare_extra_attr",
        attrs=[
            {
                "name": "grasp_pose_object",
                "entity_uids": "cube",
                "value": [0, 0, 0.1, 0.5, 0.5, 0.5, 0.5],
            }
        ],
    ),
    "finish": _at(
        "startup", "set_rigid_object_visual_material", **CUBE, mat_cfg={"base_color": [1, 0, 0, 1]}
    ),
    "base": _at("reset", "randomize_articulation_root_pose", **ARM, position_range=SMALL),
    "encoders": _at("reset", "encoder_bias", **ARM, bias_range=[-0.01, 0.01]),
    "scale": _at(
        "reset",
        "reset_joints_by_scale",
        entity_cfg={"uid": "ur10", "joint_names": "Joint[12]"},
        position_range=[0.9, 1.1],
    ),
    "offset": _at(
        "reset",
        "reset_joints_by_offset",
        entity_cfg={"uid": "ur10", "joint_names": "Joint[3-6]"},
        position_range=[-0.1, 0.1],
        velocity_range=[-0.1, 0.1],
    ),
    "tool": _at(
        "reset",
        "randomize_robot_eef_pose",
        **TOOL,
        position_range=SMALL,
        rotation_range=[[-9] * 3, [9] * 3],
    ),
    "cell": _at(
        "reset",
        "planner_grid_cell_sampler",
        position_range=[[0.3, -0.4], [0.7, 0.4]],
        reference_height=0.2,
        object_uid_list=["goal"],
        grid_size=[2, 3],
    ),
    "root": _at(
        "reset",
        "reset_root_state_uniform",
        **CUBE,
        pose_range={"x": [-0.1, 0.1], "roll": [-1, 1], "yaw": [-3, 3]},
        velocity_range={"z": [-0.5, 0.5], "pitch": [-1, 1]},
    ),
    "lift": _at(
        "reset",
        "randomize_anchor_height",
        anchor_uid="goal",
        height_delta_range=[-0.1, 0.1],
        store_key="lift",
    ),
    "settle": _at("reset", "wait_for_dynamic_objects_to_settle", max_steps=20),
    "target": _at(
        "reset",
        "randomize_target_pose",
        position_range=SMALL,
        rotation_range=[[-90] * 3, [90] * 3],
        relative_position=True,
        relative_rotation=True,
        reference_entity_cfg=TOOL["entity_cfg"],
    ),
    "attrs": _at("reset", "register_entity_attrs", **CUBE, attrs=["get_mass"]),
    "pose": _at("reset", "register_entity_pose", **CUBE, compute_relative=True),
    "info": _at(
        "reset",
        "register_info_to_env",
        registry=[{**TOOL, "pose_register_params": {"to_matrix": False}}],
    ),
    "shell": _at(
        "reset",
        "randomize_object_position_in_shell",
        entity_cfg={"uid": "goal"},
        relative_to={"uid": "ur10"},
        radius_range=[0.4, 1.1],
    ),
    "reach": _at(
        "reset",
        "sample_rigid_object_pose_from_workspace",
        robot_cfg=TOOL["entity_cfg"],
        entity_cfg={"uid": "goal"},
        position_bounds=[[-1, -1, 0.3], [1, 1, 1.8]],
    ),
    "back": _at("interval", "reset_scene_to_default", every=7),
    "shove": _at(
        "interval", "push_by_setting_velocity", every=2, **CUBE, velocity_range={"x": [-1, 1]}
    ),
    "knock": _at(
        "interval",
        "push_articulation_by_setting_velocity",
        every=1,
        **CUBE,
        interval_range_s=[0.05, 0.2],
        velocity_range={"y": [-1, 1], "roll": [-1, 1]},
    ),
    "pull": _at(
        "interval",
        "apply_external_force_torque",
        every=3,
        entity_cfg={"uid": "ur10", "link_names": ["wrist.*"]},
        force_range=[-5, 5],
        torque_range=[-0.1, 0.1],
    ),
    "impulse": _at(
        "interval",
        "apply_body_impulse",
        every=1,
        **CUBE,
        force_range=[-5, 5],
        torque_range=[-0.1, 0.1],
        duration_s=[0.04, 0.12],
        cooldown_s=[0.04, 0.12],
    ),
    "paint": _at(
        "reset",
        "randomize_visual_material",
        **CUBE,
        base_color_range=COLORS,
        roughness_range=[0, 1],
    ),
    "links": _at("reset", "randomize_visual_material", **ARM, base_color_range=COLORS),
    "lamp": _at(
        "interval",
        "randomize_light",
        every=4,
        entity_cfg={"uid": "lamp"},
        position_range=SMALL,
        color_range=COLORS,
        intensity_range=[-9, 9],
        direction_range=SMALL,
    ),
    "camera": _at(
        "reset", "randomize_camera_pose", position_range=SMALL, rotation_range=[[-3] * 3, [3] * 3]
    ),
    "view": _at("reset", "randomize_camera_fovy", fovy_range=[30, 50]),
    "lens": _at("reset", "randomize_camera_intrinsics", sensor="front", focal_x_range=[-2, 2]),
    "film": _at("interval", "record_camera_data", every=8, resolution=[32, 32], max_env_num=1),
}
