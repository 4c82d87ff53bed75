"""Terms under the names of EmbodiChain, Isaac Lab, mjlab, dm_control and earlier tasks.

Each has its original parameters; references to entities are written `of`, `from` and `to`, or as
there `entity_cfg`, `source_entity_cfg` and `target_entity_cfg`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, Literal

from embodichain.compat.terms._targets import Articulation, RigidObject, joints_of
from embodichain.lab.gym.envs.managers.param_types import (
    Angle,
    Bounds,
    Box3,
    NonNegative,
    Positive,
    Range,
    Ranges,
    ScaleRange,
    Whole,
)
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.terms.aliases import Alias, P, alias, register_aliases
from embodichain.lab.gym.envs.mdp._model_fields import Operation
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext

__all__ = ["ACTIONS", "EVENTS", "OBSERVATIONS", "VALUES"]

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
    "joint_velocity_penalty": alias(
        "joint_velocity", ["norm", "negative"], of=joints_of, example="{robot_uid: ur10}"
    ),
    "joint_torques_l2": alias("joint_effort", "l2"),
    "joint_deviation_l1": alias(
        "joint_position", "l1", relative=True, periodic=False, biased=False
    ),
    "joint_pos_limits": alias("joint_position_excess", _EXCESS),
    "joint_vel_limits": alias(
        "joint_velocity_excess", [{"clip": [0.0, 1.0]}, "l1"], max_velocity=None
    ),
    "applied_torque_limits": alias("joint_effort_excess", _EXCESS),
    "joint_within": alias("joint_position", {"within": P("bounds", hint=Bounds)}, biased=False),
    "joint_vel_within": alias("joint_speed", _NEAR),
    "joint_pos_out_of_limit": alias("joint_position_excess", {"above": 0.0}),
    "joint_pos_outside": alias(
        "joint_position",
        {"outside": P("bounds", hint=Bounds)},
        relative=False,
        periodic=False,
        biased=False,
    ),
    "joint_vel_out_of_limit": alias("joint_velocity_excess", {"above": 0.0}, soft_ratio=1.0),
    "joint_effort_out_of_limit": alias("joint_effort_excess", {"above": 0.0}),
    "tolerance_joint_position": alias("joint_position", _TOLERANCE, relative=False, biased=False),
    "tolerance_joint_velocity": alias("joint_velocity", _TOLERANCE),
    # Actions
    "action_l2": alias("action", "l2"),
    "action_rate_l2": alias("action", [{"rate": {"per": "step", "before": "zeros"}}, "l2"]),
    "action_acc_l2": alias(
        "action", [{"rate": {"per": "step", "order": 2, "before": "zeros"}}, "l2"]
    ),
    "action_smoothness_penalty": alias("action", [{"rate": "step"}, "norm", "negative"]),
    "tolerance_action": alias("action", _TOLERANCE),
    # Distances and angles of two entities
    "within_distance": alias("distance", _NEAR),
    "distance_tanh": alias("distance", _STD),
    "tolerance_distance": alias("distance", _TOLERANCE),
    "within_orientation": alias("angle", {"below": P("threshold", hint=Angle)}),
    "orientation_error": alias("angle"),
    "orientation_tanh": alias("angle", _STD),
    "tolerance_orientation": alias("angle", _TOLERANCE, from_=P("of"), to=P("to")),
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
    "bad_orientation": alias(
        "tilt", {"above": P("limit_angle", hint=Angle)}, upwards="against_gravity"
    ),
    "flat_orientation_l2": alias("projected_gravity", "l2", axes="xy"),
    "lin_vel_z_l2": alias("linear_velocity", "l2", frame="body", axes="z"),
    "ang_vel_xy_l2": alias("angular_velocity", "l2", frame="body", axes="xy"),
    "body_lin_acc_l2": alias("link_acceleration", "l1"),
    "tolerance_velocity": alias("speed", _TOLERANCE),
    # Commands
    "track_lin_vel_xy_exp": alias("linear_velocity_error", {"gaussian": P("std")}),
    "track_ang_vel_z_exp": alias("angular_velocity_error", {"gaussian": P("std")}),
    "position_command_error_tanh": alias("position_command_error", _STD),
    # Contacts
    "undesired_contacts": alias("contact_found", "l1", threshold=_TOUCH),
    "desired_contacts": alias("contact_found", ["l1", {"below": 0.5}], threshold=_TOUCH),
    "contact_forces": alias(
        "largest_contact_force",
        [{"excess": P("threshold", needed=True, hint=NonNegative)}, "l1"],
    ),
    "illegal_contact": alias("contact_found", {"above": 0.5}, threshold=_TOUCH),
}
"""Rewards and metrics; terminations too, if they are booleans."""
OBSERVATIONS: Final[Mapping[str, Alias]] = {
    "joint_position_relative": alias("joint_position", relative=True, periodic=False),
    "root_pos_w": alias("position", axes="xyz"),
    "root_lin_vel_w": alias("linear_velocity", frame="world", axes="xyz"),
    "root_ang_vel_w": alias("angular_velocity", frame="world", axes="xyz"),
    "base_lin_vel": alias("linear_velocity", frame="body", axes="xyz"),
    "base_ang_vel": alias("angular_velocity", frame="body", axes="xyz"),
    "base_height": alias("height", above=0.0),
    "generated_command": alias("command"),
    "get_rigid_object_pose": alias("get_object_pose"),
}

# -- actions: `joint_action`, `eef_pose`, `eef_delta_pose` ----------------------------------------

_AFFINE = ("of", "scale", "offset", "clip")
_UNIT = P("clip", (-1.0, 1.0))


def _rotation_of(env: TermContext, pose_dim: Literal[6, 7] = 7) -> str:
    """Columns of the orientation.

    Args:
        pose_dim: 7 is a position and a quaternion (qw, qx, qy, qz), 6 a position and roll, pitch,
            yaw.
    """
    return "quat" if pose_dim == 7 else "rpy"


def _scale_of(
    env: TermContext, translation_scale: Positive = 0.02, rotation_scale: Positive = 0.1
) -> list[float]:
    """Units per unit of action.

    Args:
        translation_scale: Metres.
        rotation_scale: Rad.
    """
    return [translation_scale] * 3 + [rotation_scale] * 3


ACTIONS: Final[Mapping[str, Alias]] = {
    "joint_position": alias("joint_action", only=_AFFINE),
    "default_offset_joint_position": alias("joint_action", only=_AFFINE, centre="home", clip=_UNIT),
    "relative_joint_position": alias(
        "joint_action",
        only=_AFFINE,
        centre=P("reference", "qpos", hint=Literal["qpos", "target"]),
        example="{of: {uid: ur10}, scale: 0.05}",
        clip=_UNIT,
    ),
    "joint_position_to_limits": alias("joint_action", only=(*_AFFINE, "range"), centre="limits"),
    "joint_velocity": alias("joint_action", only=_AFFINE, control="velocity", clip=_UNIT),
    "joint_effort": alias("joint_action", only=_AFFINE, control="effort", clip=_UNIT),
    "absolute_eef_pose": alias(
        "eef_pose",
        only=("of", "position_range", "max_velocity"),
        frame="world",
        rotation=_rotation_of,
        example="{of: {uid: ur10}, pose_dim: 6}",
    ),
    "relative_eef_pose": alias(
        "eef_delta_pose",
        only=("of", "frame", "clip", "max_velocity"),
        reference="qpos",
        scale=_scale_of,
        example="{of: {uid: ur10}, translation_scale: 0.01}",
    ),
}

# -- events: `randomize`, `reset_joints`, `randomize_pose` ----------------------------------------

_WAYS = ("operation", "distribution")
_DRAW = ("distribution",)
_OBJECT = P("of", needed=True, hint=RigidObject, text="The rigid object.")
_ARTICULATION = P("of", needed=True, hint=Articulation, text="The robot; link names pick links.")


def _range(name: str, hint: Any = Ranges) -> P:
    return P(name, needed=True, hint=hint)


def _fields(uid: str, example: str, only: Sequence[str] = _WAYS, **params: Any) -> Alias:
    """`randomize` for fields of one entity; the example is of the entity `uid`."""
    text = "The robot or object; joint names, control parts or link names pick what changes."
    entity = P("of", needed=True, hint=ResolvedEntity, text=text)
    example = f"{{of: {{uid: {uid}}}, {example}}}"
    return alias("randomize", only=only, example=example, **{"of": entity, **params})


def _operation(
    env: Any, relative: bool = False, operation: Operation | None = None
) -> Operation | None:
    """What a drawn mass does to the compiled one.

    Args:
        relative: True adds the draw to the compiled mass, False takes it as the mass.
        operation: ``abs`` replaces the compiled mass, ``scale`` multiplies it, ``add`` adds to it;
            None is what `relative` says.
    """
    if relative and operation not in (None, "add"):
        message = f"relative: true adds, but operation is {operation!r}: give one of them"
        raise ConfigError([Problem("operation", message)])
    return "add" if relative else operation


def _links(
    env: Any, entity_cfg: Articulation, link_names: str | list[str] | None = None
) -> ResolvedEntity:
    """A robot with links that are picked by a parameter of their own.

    Args:
        entity_cfg: The robot or articulation.
        link_names: Regexes that pick links; None is those of `of`.
    """
    if link_names is None:
        return entity_cfg
    if entity_cfg.link_names:
        raise ConfigError([Problem("link_names", "`of` names links already")])
    return env.scene_entity({"uid": entity_cfg.uid, "link_names": link_names})


def _joints(env: Any, entity_cfg: Whole, joint_ids: list[int] | None = None) -> ResolvedEntity:
    """A robot with joints that are picked by a parameter of their own.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        joint_ids: Picks joints by index instead.
    """
    if joint_ids is None:
        return entity_cfg
    return env.scene_entity({"uid": entity_cfg.uid, "joint_ids": joint_ids})


def _of_position(env: Any, relative_qpos: bool = True) -> Operation:
    """What a drawn position does to the initial one.

    Args:
        relative_qpos: True adds the draw to the initial position, False takes it as the position.
    """
    return "add" if relative_qpos else "abs"


_MASS: Final[Mapping[str, Any]] = {
    "only": ("recompute_inertia", "min_mass", "distribution"),
    "mass": _range("mass_range"),
    "operation": _operation,
}
_FRICTION: Final[Mapping[str, Any]] = {
    "friction": P("friction_range"),
    "torsional_friction": P("torsional_range"),
    "rolling_friction": P("rolling_range"),
}
_SCALE = ("same_scale_all_axes", "fixed_density", "distribution")
_PLACE = (
    "position_range",
    "rotation_range",
    "relative_position",
    "relative_rotation",
    "relative_to",
    "physics_update_step",
)

EVENTS: Final[Mapping[str, Alias]] = {
    "randomize_rigid_object_mass": _fields("cube", "mass_range: [0.5, 2.0]", of=_OBJECT, **_MASS),
    "randomize_articulation_mass": _fields(
        "ur10", "mass_range: [0.8, 1.2], operation: scale", of=_links, **_MASS
    ),
    "randomize_rigid_object_center_of_mass": _fields(
        "cube",
        "com_pos_offset_range: [[-0.01, 0, 0], [0.01, 0, 0]]",
        _DRAW,
        of=_OBJECT,
        com=_range("com_pos_offset_range", Box3),
    ),
    "randomize_link_com": _fields(
        "ur10",
        "com_range: [[-0.02, -0.02, -0.02], [0.02, 0.02, 0.02]]",
        _DRAW,
        of=_ARTICULATION,
        com=_range("com_range", Box3),
    ),
    "randomize_link_inertia": _fields(
        "ur10", "inertia_range: [0.9, 1.1]", _DRAW, inertia=_range("inertia_range")
    ),
    "randomize_rigid_body_material": _fields("cube", "friction_range: [0.3, 1.2]", **_FRICTION),
    "randomize_ground_material": alias(
        "randomize", only=_WAYS, example="{friction_range: [0.4, 1.0]}", **_FRICTION
    ),
    "randomize_actuator_gains": _fields(
        "ur10",
        "stiffness_range: [0.8, 1.2], operation: scale",
        stiffness=P("stiffness_range"),
        damping=P("damping_range"),
    ),
    "randomize_effort_limits": _fields(
        "ur10",
        "effort_limit_range: {'.*': [50.0, 300.0]}",
        effort_limit=_range("effort_limit_range"),
    ),
    "randomize_joint_parameters": _fields(
        "ur10",
        "friction_range: [0.0, 2.0], armature_range: [0.0, 0.1]",
        joint_friction=P("friction_range"),
        armature=P("armature_range"),
        joint_damping=P("damping_range"),
        lower_limit=P("lower_limit_range"),
        upper_limit=P("upper_limit_range"),
    ),
    "randomize_actuator_strength": _fields(
        "ur10", "strength_range: [0.8, 1.1]", _DRAW, strength=_range("strength_range")
    ),
    "randomize_physics_scene_gravity": alias(
        "randomize",
        only=_WAYS,
        gravity=_range("gravity_range", Box3),
        example="{gravity_range: [[-0.2, -0.2, -0.5], [0.2, 0.2, 0.5]]}",
    ),
    "randomize_rigid_object_scale": _fields(
        "cube",
        "scale_factor_range: [0.8, 1.2]",
        _SCALE,
        scale=_range("scale_factor_range", ScaleRange),
    ),
    "randomize_rigid_objects_scale": alias(
        "randomize",
        only=("shared_sample", *_SCALE),
        entity_cfgs=P("entity_cfgs", needed=True, hint=list[ResolvedEntity]),
        scale=_range("scale_factor_range", ScaleRange),
        example="{entity_cfgs: [{uid: cube}, {uid: goal}], scale_factor_range: [0.9, 1.1]}",
    ),
    "reset_joints_by_offset": alias(
        "reset_joints",
        only=("of", "velocity_range"),
        position_range=P("position_range", hint=Range),
    ),
    "reset_joints_by_scale": alias(
        "reset_joints",
        only=("of", "velocity_range"),
        position_range=P("position_range", hint=Range),
        operation="scale",
        example="{of: {uid: ur10}, position_range: [0.9, 1.1], velocity_range: [0, 0]}",
    ),
    "randomize_robot_qpos": alias(
        "reset_joints",
        only=(),
        of=_joints,
        position_range=P("qpos_range"),
        operation=_of_position,
        example="{of: {uid: ur10}, qpos_range: [-0.1, 0.1]}",
    ),
    "randomize_rigid_object_pose": alias("randomize_pose", only=_PLACE, of=_OBJECT),
    "randomize_articulation_root_pose": alias(
        "randomize_pose",
        only=_PLACE,
        of=_ARTICULATION,
        example="{of: {uid: ur10}, position_range: [[-0.05, -0.05, 0], [0.05, 0.05, 0]]}",
    ),
}

register_aliases(VALUES)
register_aliases(OBSERVATIONS, "observation")
register_aliases(ACTIONS, "action")
register_aliases(EVENTS, "event")
