"""Every key that a gym config may have, and what becomes of it.

A rule is `KEEP` (same name here), `As(NAME)` (another name here), `HANDLED` (code gives it its
meaning), or a text: the key is left out, and the text says why. Names of functors stand in
`functors`. Compatibility's page in the documentation lists what is left out from these tables.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

__all__ = ["HANDLED", "KEEP", "SECTIONS", "As", "Left", "Rule", "Vocabulary", "left_out"]


@dataclass(frozen=True, slots=True)
class As:
    """The key has another name here."""

    name: str


@dataclass(frozen=True, slots=True)
class _Marker:
    name: str


@dataclass(frozen=True, slots=True)
class Left:
    """A key that is left out.

    Attributes:
        section: Where it stands.
        key: Its name.
        reason: Why it is left out.
    """

    section: str
    key: str
    reason: str


KEEP: Final = _Marker("keep")
HANDLED: Final = _Marker("handled")
Rule = _Marker | As | str
Vocabulary = Mapping[str, Rule]

_PHYSX = "a PhysX setting; MuJoCo has none like it"
_SLEEP = "MuJoCo puts nothing to sleep here"
_RENDER = "MuJoCo's rasterizer draws, in a log viewer or with viewer=native"
_USD = "USD is not read"
_CAMERA = "cameras are not available yet"
_IK = "inverse kinematics is not available yet"
_RECORD = "the log of a run holds its trajectory: embodichain replay"
_MESH = "a mesh collides by its hull; `collision: decompose` splits it into convex parts"

TOP: Vocabulary = {
    "id": HANDLED,
    "max_episodes": HANDLED,
    "max_episode_steps": KEEP,
    "num_envs": HANDLED,
    "seed": HANDLED,
    "device": HANDLED,
    "physics_dt": HANDLED,
    "physics_config": HANDLED,
    "robot": HANDLED,
    "sensor": HANDLED,
    "light": HANDLED,
    "background": HANDLED,
    "rigid_object": HANDLED,
    "articulation": HANDLED,
    "env": HANDLED,
    "headless": "a run opens no window unless viewer=native asks for one",
    "gpu_id": "physics runs on the CPU",
    "arena_space": "every environment is its own world",
    "renderer": _RENDER,
    "render_cfg": _RENDER,
    "physics": "the physics is MuJoCo's",
    "enable_sensor": _CAMERA,
    "ground_plane_visible": "the ground plane is always drawn",
    "startup_summary": "embodichain show prints the scene",
    "scene_node_capacity": "there is no such limit",
    "enable_entity_gizmo": "gizmos are not available",
    "robot_ik_gizmo": "gizmos are not available",
    "visualization": "viewer=web shows the run in a browser, viewer=native in a window",
    "rigid_object_group": "object groups are not available: declare the objects one by one",
    "visual_object": "declare a rigid object with enable_collision false",
    "soft_object": "soft bodies are not available",
    "cloth_object": "cloth is not available",
    "collection": "expert data is not collected here",
    "objective": "expert data is not collected here",
    "expansion": "scene expansion is not available",
    "task_program": "task programs are not available",
    "environment": HANDLED,
    "embodiment": HANDLED,
    "scene": HANDLED,
}

PHYSICS: Vocabulary = {
    "gravity": KEEP,
    "physics_dt": KEEP,
    "device": "the root key device says it",
    **dict.fromkeys(
        (
            "bounce_threshold",
            "enable_pcm",
            "enable_tgs",
            "enable_ccd",
            "enable_enhanced_determinism",
            "enable_friction_every_iteration",
            "length_tolerance",
            "speed_tolerance",
            "cache_material",
            "tolerances",
            "gpu_memory",
        ),
        _PHYSX,
    ),
    **dict.fromkeys(
        (
            "num_substeps",
            "requires_grad",
            "use_cuda_graph",
            "sync_to_renderer",
            "debug_mode",
            "solver_cfg",
            "collision_cfg",
        ),
        "a setting of the Newton backend",
    ),
}

_POSE: Vocabulary = {
    "uid": HANDLED,
    "init_pos": KEEP,
    "init_rot": KEEP,
    "init_local_pose": KEEP,
}

ARTICULATION: Vocabulary = {
    **_POSE,
    "fpath": KEEP,
    "drive_pros": HANDLED,
    "joint_drive_props": HANDLED,
    "body_scale": KEEP,
    "attrs": HANDLED,
    "fix_base": KEEP,
    "root_props": HANDLED,
    "disable_self_collision": KEEP,
    "init_qpos": KEEP,
    "sleep_threshold": _SLEEP,
    "min_position_iters": _PHYSX,
    "min_velocity_iters": _PHYSX,
    "build_pk_chain": "kinematics are MuJoCo's",
    "compute_uv": _RENDER,
    "use_usd_properties": _USD,
    "link_attrs": "attributes of single links are not available",
    "qpos_limits": "limits are those of the robot's file",
    "asset_physics_mode": "physics comes from the file and from what stands here",
}

ROBOT: Vocabulary = {
    **ARTICULATION,
    "class_type": HANDLED,
    "robot_type": HANDLED,
    "init_qpos": HANDLED,
    "control_parts": KEEP,
    "urdf_cfg": HANDLED,
    "solver_cfg": HANDLED,
    "workspace_cfg": _IK,
    "sensors": _CAMERA,
    "enable_sensor": _CAMERA,
}

_ASSEMBLED = "robots are assembled when they are read: nothing is written"
URDF: Vocabulary = {
    "components": HANDLED,
    "base_link_name": KEEP,
    "component_prefix": KEEP,
    "name_case": KEEP,
    "sensors": _CAMERA,
    "use_signature_check": _ASSEMBLED,
    "fpath": _ASSEMBLED,
    "fname": _ASSEMBLED,
    "fpath_prefix": _ASSEMBLED,
}
URDF_COMPONENT: Vocabulary = {"component_type": KEEP, "urdf_path": KEEP, "transform": KEEP}
SOLVER: Vocabulary = {
    "end_link_name": KEEP,
    "root_link_name": KEEP,
    "tcp": KEEP,
    "class_type": "it gives the tool point; no solver runs",
    "urdf_path": "kinematics are those of the robot",
    "joint_names": "joints are those of the control part",
    **dict.fromkeys(
        (
            *("ik_nearest_weight", "pos_eps", "rot_eps", "max_iterations", "dt", "damp"),
            *("num_samples", "is_only_position_constraint", "ik_method", "ik_params", "mesh_path"),
            *("fixed_input_tasks", "variable_input_tasks", "fail_on_joint_limit_violation"),
            *("show_ik_warnings", "command_type", "use_relative_mode", "sort_ik", "safe_margin"),
            *("dh_params", "qpos_limits", "T_b_ob", "T_e_oe", "link_lengths", "ur_type"),
            *("rotation_directions", "a1", "a2", "b", "c1", "c2", "c3", "c4", "offsets"),
            *("flip_axes", "has_parallelogram"),
        ),
        "a setting of a solver, and none runs",
    ),
}

DRIVE: Vocabulary = {
    "drive_type": KEEP,
    "stiffness": KEEP,
    "damping": KEEP,
    "max_effort": KEEP,
    "max_velocity": KEEP,
    "friction": KEEP,
    "armature": KEEP,
    "target_mode": "what a target is follows from the action terms",
}

ROOT_PROPS: Vocabulary = {
    "fixed_base": As("fix_base"),
    "self_collision_enabled": HANDLED,
    "min_position_iters": _PHYSX,
    "min_velocity_iters": _PHYSX,
}

RIGID_OBJECT: Vocabulary = {
    **_POSE,
    "shape": HANDLED,
    "attrs": HANDLED,
    "body_type": HANDLED,
    "body_scale": KEEP,
    "max_convex_hull_num": _MESH,
    "sdf_resolution": _MESH,
    "use_usd_properties": _USD,
}

ATTRS: Vocabulary = {
    "mass": KEEP,
    "density": KEEP,
    "linear_damping": KEEP,
    "angular_damping": KEEP,
    "enable_collision": KEEP,
    "dynamic_friction": KEEP,
    "static_friction": "MuJoCo has one sliding coefficient, dynamic_friction",
    "restitution": "MuJoCo has no restitution coefficient",
    "contact_offset": "MuJoCo's soft contacts need no offset",
    "rest_offset": "MuJoCo's soft contacts need no offset",
    "sleep_threshold": _SLEEP,
    "enable_ccd": _PHYSX,
    "max_depenetration_velocity": _PHYSX,
    "min_position_iters": _PHYSX,
    "min_velocity_iters": _PHYSX,
    "max_linear_velocity": "MuJoCo has no velocity limit",
    "max_angular_velocity": "MuJoCo has no velocity limit",
}
ATTR_GROUPS: Final = ("mass_props", "rigid_props", "collision_props", "material_props")
"""Release 0.3 puts the keys of `ATTRS` into these."""

SHAPES: Mapping[str, Vocabulary] = {
    "Cube": {"size": KEEP},
    "Sphere": {"radius": KEEP, "resolution": "MuJoCo's sphere is exact"},
    "Mesh": {
        "fpath": KEEP,
        "load_option": "MuJoCo's importer reads the mesh",
        "compute_uv": _RENDER,
        "project_direction": _RENDER,
        "max_convex_hull_num": _MESH,
        "acd_method": _MESH,
        "sdf_resolution": _MESH,
        "collision": _MESH,
        "vertices": "a mesh is a file",
        "triangles": "a mesh is a file",
    },
}

MATERIAL: Vocabulary = {
    "base_color": KEEP,
    **dict.fromkeys(
        (
            "uid",
            "metallic",
            "roughness",
            "emissive",
            "emissive_intensity",
            "ior",
            "base_color_texture",
            "metallic_texture",
            "roughness_texture",
            "normal_texture",
            "ao_texture",
        ),
        "MuJoCo's rasterizer shows base_color",
    ),
}

LIGHT: Vocabulary = {
    **_POSE,
    "light_type": HANDLED,
    "color": KEEP,
    "intensity": KEEP,
    "direction": KEEP,
    **dict.fromkeys(
        ("radius", "enable_shadow", "spot_inner", "spot_outer", "width", "height"), _RENDER
    ),
}

LIGHTS: Vocabulary = {
    "direct": HANDLED,
    "indirect": "there is one background light",
}

SENSORS: Mapping[str, str] = {
    "Camera": _CAMERA,
    "StereoCamera": _CAMERA,
    "ContactSensor": "contacts are declared under sensors: {NAME: {sensor_type: contact, ...}}",
}

ENV: Vocabulary = {
    "events": HANDLED,
    "observations": HANDLED,
    "rewards": HANDLED,
    "actions": HANDLED,
    "extensions": KEEP,
    "control_parts": HANDLED,
    "active_joint_ids": HANDLED,
    "sim_steps_per_control": KEEP,
    "ignore_terminations": KEEP,
    "target_control_frequency": HANDLED,
    "dataset": "the log holds every step: `embodichain export last --format lerobot` makes it",
    "task_instruction": "it belongs to data sets",
    "success_params": "nothing reads it there either",
    "expert_trajectory": "expert data is not collected here",
    "filter_visual_rand": HANDLED,
    "filter_dataset_saving": "data sets are made of logs: `embodichain export --format lerobot`",
    "init_rollout_buffer": "a learner keeps its own buffer",
    "rollout_action_semantics": "a learner keeps its own buffer",
    "record_trajectory": _RECORD,
    "trajectory_uids": _RECORD,
    "trajectory_save_dir": _RECORD,
    "trajectory_auto_save": _RECORD,
    "profiler": "embodichain bench measures",
}

_FUNCTOR: Vocabulary = {
    "func": HANDLED,
    "params": HANDLED,
    "extra": "nothing reads it",
}
EVENT: Vocabulary = {
    **_FUNCTOR,
    "mode": KEEP,
    "interval_step": KEEP,
    "is_global": KEEP,
}
OBSERVATION: Vocabulary = {**_FUNCTOR, "mode": HANDLED, "name": KEEP}
REWARD: Vocabulary = {**_FUNCTOR, "mode": KEEP, "weight": KEEP}
ACTION: Vocabulary = {
    **_FUNCTOR,
    "contract": HANDLED,
    "mode": "actions are always read before physics",
}

SECTIONS: Mapping[str, Vocabulary] = {
    "": TOP,
    "physics_config": PHYSICS,
    "robot": ROBOT,
    "robot.urdf_cfg": URDF,
    "articulation[]": ARTICULATION,
    "drive_pros": DRIVE,
    "solver_cfg": SOLVER,
    "root_props": ROOT_PROPS,
    "rigid_object[], background[]": RIGID_OBJECT,
    "attrs": ATTRS,
    **{f"shape ({kind})": keys for kind, keys in SHAPES.items()},
    "visual_material": MATERIAL,
    "light": LIGHTS,
    "light.direct[]": LIGHT,
    "sensor[]": SENSORS,
    "env": ENV,
    "env.events.*": EVENT,
    "env.actions.*": ACTION,
}
"""Where each table counts, for documentation."""


def left_out() -> Iterator[Left]:
    """Every key that is known and left out, in the order of the tables."""
    for section, vocabulary in SECTIONS.items():
        for key, rule in vocabulary.items():
            if isinstance(rule, str):
                yield Left(section, key, rule)
