"""Names of EmbodiChain's functors: those with another name here, and those that are left out.

Functors in no table are looked up among the terms by their own names.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from embodichain.compat.gym_config.vocabulary import each

__all__ = [
    "ACTIONS",
    "LEFT_OUT",
    "NEEDS_ANY",
    "OF_CAMERA",
    "PARAMS_LEFT_OUT",
    "RENAMED",
    "VISUAL",
]

_RAYS = "it changes what only a ray tracer draws"
_LOOK_AT = "position_range and rotation_range move the camera in its own axes"
_GROUPS = "object groups are not available"

LEFT_OUT: Final[Mapping[str, Mapping[str, str]]] = {
    "event": {
        "replace_assets_from_group": "a mesh is compiled once, from its file",
        "drop_rigid_object_group_sequentially": _GROUPS,
        **each(
            "constraints are equality constraints of an MJCF scene or robot",
            "create_rigid_constraint remove_rigid_constraint",
        ),
        **each(
            "scene expansion is not available", "apply_expansion_profile_reset ExpandSceneLayout"
        ),
        **each(_RAYS, "randomize_indirect_lighting randomize_emission_light"),
        "randomize_camera_extrinsics": "use randomize_camera_pose",
        "set_rigid_object_group_visual_material": _GROUPS,
        "randomize_rigid_object_body_scale": "it is deprecated: use randomize_rigid_object_scale",
        "record_camera_data_async": "use record_camera_data: one encoder process an environment",
        "validation_cameras": "use record_camera_data, or embodichain replay --video",
    },
    "observation": {
        "get_sensor_pose_in_robot_frame": "use camera_pose, in the environment's frame",
        "get_sensor_intrinsics": "use camera_intrinsics: fx, fy, cx, cy",
        "compute_semantic_mask": "use camera_mask, an image of one entity",
        "compute_exteroception": "observations contain the images of cameras, camera_image others",
    },
    "reward": {},
    "action": {
        "QposNormalizedTerm": "it only changes what a data set records",
    },
}
"""Kind -> functor -> why it is left out. A registered term of the name has precedence."""

_TEXTURES = "use randomize_texture, which draws one of the textures that the object declares"
PARAMS_LEFT_OUT: Final[Mapping[str, Mapping[str, str]]] = {
    "randomize_anchor_height": {"include_groups": _GROUPS},
    "sample_rigid_object_pose_from_workspace": each(
        "no maps of a workspace are kept: poses are drawn until inverse kinematics succeed",
        "strategy use_workspace_orientation min_score",
    ),
    "randomize_camera_pose": each(_LOOK_AT, "eye_range target_range up_range"),
    "randomize_visual_material": {
        "shared": "every environment draws its own material",
        "ior_range": "rasterizers do not refract",
        **each(_TEXTURES, "texture_path random_texture_prob fallback_to_new p_original p_library"),
        **each(_TEXTURES, "p_solid solid_texture_count"),
    },
}
"""Functor -> parameter that the term of that name here does not have -> why."""
NEEDS_ANY: Final[Mapping[str, tuple[str, ...]]] = {
    "randomize_visual_material": ("base_color_range", "metallic_range", "roughness_range"),
    "randomize_camera_pose": ("position_range", "rotation_range"),
}
"""Functor -> parameters; if none of them remains, the functor has no effect and is left out."""

RENAMED: Final[Mapping[str, str]] = {"randomize_camera_extrinsics": "randomize_camera_pose"}
"""Event -> term here."""
OF_CAMERA: Final[Mapping[str, Mapping[str, str]]] = {
    "randomize_camera_pose": {
        "entity_cfg": "camera",
        "pos_range": "position_range",
        "euler_range": "rotation_range",
    },
    "randomize_camera_intrinsics": {"entity_cfg": "sensor"},
}
"""Term of a camera -> parameter there -> parameter here; ``entity_cfg`` names the camera there."""

VISUAL: Final = (
    "randomize_visual_material",
    "randomize_indirect_lighting",
    "randomize_light",
    "randomize_emission_light",
    "randomize_camera_pose",
    "randomize_camera_intrinsics",
    "set_rigid_object_visual_material",
    "set_rigid_object_group_visual_material",
)
"""Events that `env.filter_visual_rand` leaves out."""

ACTIONS: Final[Mapping[str, str]] = {
    **each(
        "relative_joint_position",
        "DeltaQposTerm RelativeJointPositionAction joint_position.relative@1",
    ),
    **each("joint_position", "QposTerm JointPositionAction joint_position.absolute@1"),
    **each(
        "joint_position_to_limits",
        "QposDenormalizedTerm JointPositionToLimitsAction joint_position.limits@1",
    ),
    **each(
        "default_offset_joint_position",
        "DefaultJointPositionAction joint_position.default_offset@1",
    ),
    **each("joint_velocity", "QvelTerm JointVelocityAction joint_velocity@1"),
    **each("joint_effort", "QfTerm JointEffortAction joint_effort@1"),
    **each("absolute_eef_pose", "EefPoseTerm EefPoseAction eef_pose.absolute@1"),
    **each("relative_eef_pose", "RelativeEefPoseAction eef_pose.relative@1"),
    **each("parallel_gripper", "ParallelGripperAction gripper.parallel@1"),
}
"""Action functor or contract -> term here."""
