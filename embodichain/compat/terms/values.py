"""Names of terms that EmbodiChain, Isaac Lab, mjlab and earlier tasks use, one line each.

Each stands for a quantity with a shape, and has the parameters it has there; `from`, `to` and `of`
are called `source_entity_cfg`, `target_entity_cfg` and `entity_cfg`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from embodichain.lab.gym.envs.managers.aliases import Alias, P, alias, register_aliases
from embodichain.lab.gym.envs.managers.param_types import Angle, Bounds, NonNegative, Positive

__all__ = ["OBSERVATIONS", "VALUES"]

_STD = {"tanh": P("std")}
_NEAR = {"below": P("threshold", hint=Positive)}
_TOUCH = P("threshold", 1.0, hint=NonNegative)
_TOLERANCE = {"tolerance": P("*")}
_EXCESS = [{"excess": 0.0}, "l1"]

VALUES: Final[Mapping[str, Alias]] = {
    # Joints
    "joint_vel_l1": alias("joint_velocity", "l1"),
    "joint_vel_l2": alias("joint_velocity", "l2"),
    "joint_acc_l2": alias("joint_velocity", ["rate", "l2"]),
    "joint_torques_l2": alias("joint_effort", "l2"),
    "joint_deviation_l1": alias("joint_position", "l1", relative=True, periodic=False),
    "joint_pos_limits": alias("joint_position_excess", _EXCESS),
    "joint_vel_limits": alias(
        "joint_velocity_excess", [{"clip": [0.0, 1.0]}, "l1"], max_velocity=None
    ),
    "applied_torque_limits": alias("joint_effort_excess", _EXCESS),
    "joint_within": alias("joint_position", {"within": P("bounds", hint=Bounds)}),
    "joint_vel_within": alias("joint_speed", _NEAR),
    "joint_pos_out_of_limit": alias("joint_position_excess", {"above": 0.0}),
    "joint_pos_outside": alias(
        "joint_position", {"outside": P("bounds", hint=Bounds)}, relative=False, periodic=False
    ),
    "joint_vel_out_of_limit": alias("joint_velocity_excess", {"above": 0.0}, soft_ratio=1.0),
    "joint_effort_out_of_limit": alias(
        "joint_effort_excess", {"above": {"threshold": 0.0, "inclusive": True}}
    ),
    "tolerance_joint_position": alias("joint_position", _TOLERANCE, relative=False),
    "tolerance_joint_velocity": alias("joint_velocity", _TOLERANCE),
    # Actions
    "action_l2": alias("action", "l2"),
    "action_rate_l2": alias("action", [{"rate": "step"}, "l2"]),
    "action_acc_l2": alias("action", [{"rate": {"per": "step", "order": 2}}, "l2"]),
    "action_smoothness_penalty": alias("action", [{"rate": "step"}, "norm", "negative"]),
    "tolerance_action": alias("action", _TOLERANCE),
    # Distances and angles of two entities
    "within_distance": alias("distance", _NEAR),
    "distance_tanh": alias("distance", _STD),
    "tolerance_distance": alias("distance", _TOLERANCE),
    "within_orientation": alias("angle", {"below": P("threshold", hint=Angle)}),
    "orientation_error": alias("angle"),
    "orientation_tanh": alias("angle", _STD),
    "tolerance_orientation": alias(
        "angle", _TOLERANCE, from_=P("entity_cfg"), to=P("target_entity_cfg")
    ),
    # One entity, or link
    "height_above": alias("height", {"above": P("threshold")}, above=0.0),
    "height_below": alias("height", {"below": P("threshold")}, above=0.0),
    "root_height_below_minimum": alias("height", {"below": P("minimum_height")}, above=0.0),
    "base_height_l2": alias("height", "l2", above=P("target_height", needed=True)),
    "object_height": alias(
        "height", [{"excess": 0.0}, {"at_most": P("most", None, hint=Positive | None)}]
    ),
    "tolerance_height": alias("height", _TOLERANCE, above=0.0),
    "out_of_bounds": alias("position", {"outside": P("bounds")}, axes="xyz"),
    "bad_orientation": alias("tilt", {"above": P("limit_angle", hint=Angle)}),
    "flat_orientation_l2": alias("projected_gravity", "l2", axes="xy"),
    "lin_vel_z_l2": alias("linear_velocity", "l2", frame="body", axes="z"),
    "ang_vel_xy_l2": alias("angular_velocity", "l2", frame="body", axes="xy"),
    "body_lin_acc_l2": alias("linear_velocity", ["rate", "l2"], frame="world", axes="xyz"),
    "tolerance_velocity": alias("speed", _TOLERANCE),
    # Commands
    "track_lin_vel_xy_exp": alias("linear_velocity_error", {"gaussian": P("std")}),
    "track_ang_vel_z_exp": alias("angular_velocity_error", {"gaussian": P("std")}),
    "position_command_error_tanh": alias("position_command_error", _STD),
    # Contacts
    "undesired_contacts": alias("contact_found", "l1", threshold=_TOUCH),
    "desired_contacts": alias("contact_found", ["l1", {"below": 0.5}], threshold=_TOUCH),
    "contact_forces": alias(
        "contact_force",
        [{"excess": P("threshold", needed=True, hint=NonNegative)}, "l1"],
        norm=True,
    ),
    "illegal_contact": alias("contact_found", {"above": 0.5}, threshold=_TOUCH),
}
"""Rewards and metrics, and terminations where they are truths."""
OBSERVATIONS: Final[Mapping[str, Alias]] = {
    "joint_position_relative": alias("joint_position", relative=True, periodic=False),
    "root_pos_w": alias("position", axes="xyz"),
    "root_lin_vel_w": alias("linear_velocity", frame="world", axes="xyz"),
    "root_ang_vel_w": alias("angular_velocity", frame="world", axes="xyz"),
    "base_lin_vel": alias("linear_velocity", frame="body", axes="xyz"),
    "base_ang_vel": alias("angular_velocity", frame="body", axes="xyz"),
    "base_height": alias("height", above=0.0),
    "generated_command": alias("command"),
}

register_aliases(VALUES)
register_aliases(OBSERVATIONS, "observation")
