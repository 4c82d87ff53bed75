"""Names of EmbodiChain's functors: those with another name here, and those that cannot come along.

Functors that are in no table are looked for among our terms under their own names.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from embodichain.compat.gym_config.vocabulary import Left

__all__ = ["ACTIONS", "LEFT_OUT", "NEEDS_ANY", "PARAMS_LEFT_OUT", "VISUAL", "left_out_functors"]

_RAYS = "it changes what only a ray tracer draws"
_CAMERA = "cameras are not available yet"
_GROUPS = "object groups are not available"
_IK = "inverse kinematics is not available yet"
_FILES = "a mesh is compiled once, from its file"

LEFT_OUT: Final[Mapping[str, Mapping[str, str]]] = {
    "event": {
        "replace_assets_from_group": _FILES,
        "drop_rigid_object_group_sequentially": _GROUPS,
        "create_rigid_constraint": "constraints are not available yet",
        "remove_rigid_constraint": "constraints are not available yet",
        "apply_expansion_profile_reset": "scene expansion is not available",
        "ExpandSceneLayout": "scene expansion is not available",
        "randomize_indirect_lighting": _RAYS,
        "randomize_emission_light": _RAYS,
        "randomize_camera_extrinsics": _CAMERA,
        "randomize_camera_intrinsics": _CAMERA,
        "set_rigid_object_group_visual_material": _GROUPS,
        "randomize_rigid_object_body_scale": "it is deprecated: use randomize_rigid_object_scale",
        "record_camera_data_async": "use record_camera_data: one encoder process an environment",
        "validation_cameras": _CAMERA,
    },
    "observation": {
        "get_sensor_pose_in_robot_frame": _CAMERA,
        "get_sensor_intrinsics": _CAMERA,
        "compute_semantic_mask": _CAMERA,
        "compute_exteroception": _CAMERA,
    },
    "reward": {},
    "action": {
        "QposNormalizedTerm": "it only changes what a data set records",
        "EefPoseTerm": _IK,
        "EefPoseAction": _IK,
        "eef_pose.absolute@1": _IK,
        "RelativeEefPoseAction": _IK,
        "eef_pose.relative@1": _IK,
    },
}
"""Kind -> functor -> why it is left out. A term of ours with the same name goes before it."""

_TEXTURES = "textures are not drawn: colours are"
PARAMS_LEFT_OUT: Final[Mapping[str, Mapping[str, str]]] = {
    "randomize_anchor_height": {"include_groups": _GROUPS},
    "sample_rigid_object_pose_from_workspace": dict.fromkeys(
        ("strategy", "use_workspace_orientation", "min_score"), "there is no workspace analysis"
    ),
    "randomize_visual_material": {
        "shared": "environments are drawn one by one",
        "ior_range": "MuJoCo's rasterizer does not refract",
        **dict.fromkeys(
            (
                "texture_path",
                "random_texture_prob",
                "fallback_to_new",
                "p_original",
                "p_library",
                "p_solid",
                "solid_texture_count",
            ),
            _TEXTURES,
        ),
    },
}
"""Functor -> parameter that means nothing to our term of that name -> why."""
NEEDS_ANY: Final[Mapping[str, tuple[str, ...]]] = {
    "randomize_visual_material": ("base_color_range", "metallic_range", "roughness_range"),
}
"""Functor -> parameters of which one at least must be left, or there is nothing to do."""

VISUAL: Final = (
    "randomize_visual_material",
    "randomize_indirect_lighting",
    "randomize_light",
    "randomize_emission_light",
    "randomize_camera_extrinsics",
    "randomize_camera_intrinsics",
    "set_rigid_object_visual_material",
    "set_rigid_object_group_visual_material",
)
"""Events that `env.filter_visual_rand` leaves out."""

_RELATIVE = "relative_joint_position"
_ABSOLUTE = "joint_position"
_LIMITS = "joint_position_to_limits"
_OFFSET = "default_offset_joint_position"
_VELOCITY = "joint_velocity"
_EFFORT = "joint_effort"
_GRIPPER = "parallel_gripper"

ACTIONS: Final[Mapping[str, str]] = {
    "DeltaQposTerm": _RELATIVE,
    "RelativeJointPositionAction": _RELATIVE,
    "joint_position.relative@1": _RELATIVE,
    "QposTerm": _ABSOLUTE,
    "JointPositionAction": _ABSOLUTE,
    "joint_position.absolute@1": _ABSOLUTE,
    "QposDenormalizedTerm": _LIMITS,
    "JointPositionToLimitsAction": _LIMITS,
    "joint_position.limits@1": _LIMITS,
    "DefaultJointPositionAction": _OFFSET,
    "joint_position.default_offset@1": _OFFSET,
    "QvelTerm": _VELOCITY,
    "JointVelocityAction": _VELOCITY,
    "joint_velocity@1": _VELOCITY,
    "QfTerm": _EFFORT,
    "JointEffortAction": _EFFORT,
    "joint_effort@1": _EFFORT,
    "ParallelGripperAction": _GRIPPER,
    "gripper.parallel@1": _GRIPPER,
}
"""Action functor or contract -> our term."""


def left_out_functors() -> Iterator[Left]:
    """Every functor and parameter that is known and left out, in the order of the tables."""
    for kind, reasons in LEFT_OUT.items():
        yield from (Left(f"{kind}s", name, reason) for name, reason in reasons.items())
    for functor, reasons in PARAMS_LEFT_OUT.items():
        yield from (Left(f"`{functor}`", name, reason) for name, reason in reasons.items())
