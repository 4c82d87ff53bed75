"""Every key that a gym config may have, with a rule for its conversion.

A rule is `KEEP` (the key has the same name here), `HANDLED` (converted by code), or a string with
the reason why the key is left out. Functors are in `functors`. docs/compatibility.md lists the
keys that are left out from these tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum, auto
from typing import Any, Final, TypeVar

__all__ = ["HANDLED", "KEEP", "Rule", "Vocabulary", "each"]


class Treatment(Enum):
    """Rules for keys that are not left out."""

    KEEP = auto()
    HANDLED = auto()


KEEP: Final = Treatment.KEEP
HANDLED: Final = Treatment.HANDLED
Rule = Treatment | str
Vocabulary = Mapping[str, Any]
"""Key -> its `Rule`."""


R = TypeVar("R")


def each(rule: R, names: str) -> dict[str, R]:
    """Return the same rule for several names, separated by spaces."""
    return dict.fromkeys(names.split(), rule)


_PHYSX = "a PhysX setting; MuJoCo has none like it"
_NEWTON = "a setting of the Newton backend"
_SLEEP = "MuJoCo puts nothing to sleep here"
_RENDER = "cameras and viewers draw with rasterizers: MuJoCo's, or this project's own"
_USD = "USD is not read"
_ROBOT_SENSORS = "a sensor on a robot is declared under sensor, with a link as parent"
_RECORD = "the log of a run contains its trajectory: embodichain replay"
_MESH = "a mesh collides as its convex hull; `collision: decompose` splits it into convex parts"
_EXPERT = "declare `expert:` in a task; `embodichain collect` makes demonstrations of it"
_ROLLOUT = "a learner has its own buffer"
_ASSEMBLED = "robots are assembled when they are read: nothing is written"

TOP: Vocabulary = {
    **each(HANDLED, "id max_episodes num_envs seed device physics_dt physics_config robot sensor"),
    **each(HANDLED, "light background rigid_object articulation env"),
    **each(HANDLED, "environment embodiment scene"),
    "max_episode_steps": KEEP,
    "headless": "a run opens no window unless viewer=native",
    "gpu_id": HANDLED,
    "arena_space": "every environment is its own world",
    **each(_RENDER, "renderer render_cfg"),
    "physics": "the physics is MuJoCo's",
    "enable_sensor": HANDLED,
    "ground_plane_visible": "`scene: {ground: {type: none}}` leaves it out, for collisions too",
    "startup_summary": "embodichain show prints the scene",
    "scene_node_capacity": "there is no such limit",
    **each("gizmos are not available", "enable_entity_gizmo robot_ik_gizmo"),
    "visualization": "viewer=web shows the run in a browser, viewer=native in a window",
    "rigid_object_group": "object groups are not available: declare the objects one by one",
    "visual_object": "declare a rigid object with enable_collision false",
    "soft_object": "soft bodies are not available",
    "cloth_object": "cloth is not available",
    **each(_EXPERT, "collection objective"),
    "expansion": "scene expansion is not available",
    "task_program": "task programs are not available",
}

PHYSICS: Vocabulary = {
    **each(KEEP, "gravity physics_dt"),
    "device": "the root key device says it",
    **each(_PHYSX, "bounce_threshold enable_pcm enable_tgs enable_ccd"),
    **each(_PHYSX, "enable_enhanced_determinism enable_friction_every_iteration"),
    **each(_PHYSX, "length_tolerance speed_tolerance cache_material tolerances gpu_memory"),
    **each(_NEWTON, "num_substeps requires_grad use_cuda_graph sync_to_renderer debug_mode"),
    **each(_NEWTON, "solver_cfg collision_cfg"),
}

_POSE: Vocabulary = {"uid": HANDLED, **each(KEEP, "init_pos init_rot init_local_pose")}

ARTICULATION: Vocabulary = {
    **_POSE,
    **each(KEEP, "fpath body_scale fix_base disable_self_collision init_qpos"),
    **each(HANDLED, "drive_pros joint_drive_props attrs root_props"),
    "sleep_threshold": _SLEEP,
    **each(_PHYSX, "min_position_iters min_velocity_iters"),
    "build_pk_chain": "kinematics are MuJoCo's",
    "compute_uv": _RENDER,
    "use_usd_properties": _USD,
    "link_attrs": "`contact:` sets the friction of single links, `randomize` draws masses",
    "qpos_limits": "limits are those of the robot's file",
    "asset_physics_mode": "physics comes from the robot's file and from this section",
}

ROBOT: Vocabulary = {
    **ARTICULATION,
    **each(HANDLED, "class_type robot_type init_qpos urdf_cfg solver_cfg"),
    "control_parts": KEEP,
    "workspace_cfg": "no maps of a workspace are kept",
    **each(_ROBOT_SENSORS, "sensors enable_sensor"),
}

URDF: Vocabulary = {
    "components": HANDLED,
    **each(KEEP, "base_link_name component_prefix name_case"),
    "sensors": _ROBOT_SENSORS,
    **each(_ASSEMBLED, "use_signature_check fpath fname fpath_prefix"),
}
URDF_COMPONENT: Vocabulary = each(KEEP, "component_type urdf_path transform")
_SOLVER_SETTINGS = """
    dt damp is_only_position_constraint ik_method ik_params mesh_path fixed_input_tasks
    variable_input_tasks fail_on_joint_limit_violation show_ik_warnings command_type
    use_relative_mode sort_ik safe_margin dh_params qpos_limits T_b_ob T_e_oe link_lengths ur_type
    rotation_directions a1 a2 b c1 c2 c3 c4 offsets flip_axes has_parallelogram
"""
SOLVER: Vocabulary = {
    **each(KEEP, "end_link_name root_link_name tcp"),
    **each(KEEP, "ik_nearest_weight pos_eps rot_eps max_iterations num_samples"),
    "class_type": "the solver follows from the arm: closed form, or damped least squares",
    "urdf_path": "kinematics are those of the robot",
    "joint_names": "joints are those of the control part",
    **each("a setting of another solver", _SOLVER_SETTINGS),
}

DRIVE: Vocabulary = {
    **each(KEEP, "drive_type stiffness damping max_effort max_velocity friction armature"),
    "target_mode": "what a target is follows from the action terms",
}

ROOT_PROPS: Vocabulary = {
    **each(HANDLED, "fixed_base self_collision_enabled"),
    **each(_PHYSX, "min_position_iters min_velocity_iters"),
}

RIGID_OBJECT: Vocabulary = {
    **_POSE,
    **each(HANDLED, "shape attrs body_type"),
    "body_scale": KEEP,
    **each(_MESH, "max_convex_hull_num sdf_resolution"),
    "use_usd_properties": _USD,
}

ATTRS: Vocabulary = {
    **each(KEEP, "mass density linear_damping angular_damping enable_collision dynamic_friction"),
    "static_friction": "MuJoCo has one sliding coefficient, dynamic_friction",
    "restitution": "MuJoCo has no restitution coefficient",
    **each("MuJoCo's soft contacts need no offset", "contact_offset rest_offset"),
    "sleep_threshold": _SLEEP,
    **each(_PHYSX, "enable_ccd max_depenetration_velocity min_position_iters min_velocity_iters"),
    **each("MuJoCo has no velocity limit", "max_linear_velocity max_angular_velocity"),
}
ATTR_GROUPS: Final = ("mass_props", "rigid_props", "collision_props", "material_props")
"""Groups that contain the keys of `ATTRS` in release 0.3."""

SHAPES: Mapping[str, Vocabulary] = {
    "Cube": {"size": KEEP},
    "Sphere": {"radius": KEEP, "resolution": "MuJoCo's sphere is exact"},
    "Mesh": {
        "fpath": KEEP,
        "load_option": "MuJoCo's importer reads the mesh",
        **each(_RENDER, "compute_uv project_direction"),
        **each(_MESH, "max_convex_hull_num acd_method sdf_resolution collision"),
        **each("a mesh is a file", "vertices triangles"),
    },
}

_COLOR = "rasterizers show base_color and one texture"
MATERIAL: Vocabulary = {
    "base_color": KEEP,
    "base_color_texture": HANDLED,
    **each(_COLOR, "uid metallic roughness emissive emissive_intensity ior"),
    **each(_COLOR, "metallic_texture roughness_texture normal_texture ao_texture"),
}

LIGHT: Vocabulary = {
    **_POSE,
    "light_type": HANDLED,
    **each(KEEP, "color intensity direction"),
    **each(_RENDER, "radius enable_shadow spot_inner spot_outer width height"),
}

LIGHTS: Vocabulary = {"direct": HANDLED, "indirect": "there is one background light"}

_CAMERA: Vocabulary = {
    **each(HANDLED, "uid sensor_type"),
    **each(KEEP, "width height near far intrinsics extrinsics"),
    **each(KEEP, "enable_color enable_depth enable_mask enable_normal enable_position"),
    **each("extrinsics is the pose of a camera", "init_pos init_rot init_local_pose"),
}
CAMERAS: Mapping[str, Vocabulary] = {
    "Camera": _CAMERA,
    "StereoCamera": {
        **_CAMERA,
        **each(KEEP, "intrinsics_right left_to_right_pos left_to_right_rot enable_disparity"),
    },
}
SENSORS: Mapping[str, str] = {
    "ContactSensor": "contacts are declared under sensors: {NAME: {sensor_type: contact, ...}}",
}

ENV: Vocabulary = {
    **each(HANDLED, "events observations rewards actions control_parts active_joint_ids"),
    **each(HANDLED, "target_control_frequency filter_visual_rand"),
    **each(KEEP, "extensions sim_steps_per_control ignore_terminations"),
    "dataset": "the log contains every step: `embodichain export last --format lerobot` makes it",
    "task_instruction": "it belongs to data sets",
    "success_params": "EmbodiChain does not read it either",
    "expert_trajectory": _EXPERT,
    "filter_dataset_saving": "data sets are made of logs: `embodichain export --format lerobot`",
    **each(_ROLLOUT, "init_rollout_buffer rollout_action_semantics"),
    **each(_RECORD, "record_trajectory trajectory_uids"),
    **each(_RECORD, "trajectory_save_dir trajectory_auto_save"),
    "profiler": "embodichain bench measures",
}

_FUNCTOR: Vocabulary = {
    **each(HANDLED, "func params"),
    "extra": "it has no effect in EmbodiChain",
}
EVENT: Vocabulary = {**_FUNCTOR, **each(KEEP, "mode interval_step is_global")}
OBSERVATION: Vocabulary = {**_FUNCTOR, "mode": HANDLED, "name": KEEP}
REWARD: Vocabulary = {**_FUNCTOR, **each(KEEP, "mode weight")}
ACTION: Vocabulary = {
    **_FUNCTOR,
    "contract": HANDLED,
    "mode": "actions are always read before physics",
}
