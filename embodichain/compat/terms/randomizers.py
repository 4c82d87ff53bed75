"""`randomize` under the names of EmbodiChain, Isaac Lab and mjlab."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from embodichain.compat.terms._alias import alias
from embodichain.lab.gym.envs.mdp._model_fields import need_articulation, need_object
from embodichain.lab.gym.envs.mdp.events.randomize import Randomize
from embodichain.lab.sim.compiler.names import match
from embodichain.utils.errors import ConfigError, Problem

ENTITY = {"entity_cfg": "entity_cfg"}
WAYS = ("operation", "distribution")
FRICTIONS = {
    "friction_range": "friction",
    "torsional_range": "torsional_friction",
    "rolling_range": "rolling_friction",
}
RELATIVE = (bool, False, "True adds the draw to the compiled mass, False takes it as the mass.")
_event = partial(alias, "event", target=Randomize, caller=__name__)


def _optional(names: Mapping[str, str]) -> dict[str, None]:
    return dict.fromkeys(names)


def _adds(params: dict[str, Any]) -> dict[str, Any]:
    """EmbodiChain's `relative` as an operation."""
    if params.pop("relative", False):
        if params.get("operation") not in (None, "add"):
            message = f"relative: true adds, but operation is {params['operation']!r}"
            raise ConfigError([Problem("operation", f"{message}: give one of them")])
        params["operation"] = "add"
    return params


def _object_mass(env: Any, params: dict[str, Any]) -> dict[str, Any]:
    need_object(params["entity_cfg"])
    return _adds(params)


def _link_mass(env: Any, params: dict[str, Any]) -> dict[str, Any]:
    entity, patterns = params["entity_cfg"], params.pop("link_names", None)
    need_articulation(entity)
    if patterns is not None:
        names = list(entity.link_names or entity.asset.parsed.link_names)
        found: list[str] = []
        for pattern in [patterns] if isinstance(patterns, str) else patterns:
            ids, problems = match(
                pattern, names, f"link of {entity.uid!r}", f"link_names.{pattern}"
            )
            if problems:
                raise ConfigError(problems)
            found += [names[i] for i in ids]
        params["entity_cfg"] = replace(
            entity, link_names=tuple(name for name in names if name in found)
        )
    return _adds(params)


def _object(env: Any, params: dict[str, Any]) -> dict[str, Any]:
    need_object(params["entity_cfg"])
    return params


def _articulation(env: Any, params: dict[str, Any]) -> dict[str, Any]:
    need_articulation(params["entity_cfg"])
    return params


RandomizeRigidObjectMass = _event(
    "randomize_rigid_object_mass",
    summary="Gives a dynamic object a random mass, kg: EmbodiChain's event.",
    params={**ENTITY, "mass_range": "mass"},
    options=("recompute_inertia", "min_mass", *WAYS),
    extra={"relative": RELATIVE},
    convert=_object_mass,
    example="{func: randomize_rigid_object_mass, mode: startup, params: "
    "{entity_cfg: {uid: cube}, mass_range: [0.5, 2.0]}}",
)
_event(
    "randomize_articulation_mass",
    summary="Gives links random masses, kg, each its own: EmbodiChain's event.",
    params={**ENTITY, "mass_range": "mass"},
    options=("recompute_inertia", "min_mass", *WAYS),
    extra={
        "relative": RELATIVE,
        "link_names": (str | list[str] | None, None, "Regexes that pick links; None is all."),
    },
    convert=_link_mass,
    example="{func: randomize_articulation_mass, mode: reset, params: "
    "{entity_cfg: {uid: ur10}, mass_range: [0.8, 1.2], operation: scale}}",
)
_event(
    "randomize_rigid_object_center_of_mass",
    summary="Shifts a dynamic object's centre of mass: EmbodiChain's event.",
    params={**ENTITY, "com_pos_offset_range": "com"},
    options=("distribution",),
    convert=_object,
    example="{func: randomize_rigid_object_center_of_mass, mode: reset, params: {entity_cfg: "
    "{uid: cube}, com_pos_offset_range: [[-0.01, -0.01, -0.01], [0.01, 0.01, 0.01]]}}",
)
_event(
    "randomize_link_com",
    summary="Shifts links' centres of mass: Isaac Lab's `randomize_rigid_body_com`.",
    params={**ENTITY, "com_range": "com"},
    options=("distribution",),
    convert=_articulation,
    example="{func: randomize_link_com, mode: startup, params: {entity_cfg: {uid: ur10, link_names:"
    " [forearm_link]}, com_range: [[-0.02, -0.02, -0.02], [0.02, 0.02, 0.02]]}}",
)
_event(
    "randomize_link_inertia",
    summary="Scales the principal moments of inertia of bodies by one factor; masses stay.",
    params={**ENTITY, "inertia_range": "inertia"},
    options=("distribution",),
    example="{func: randomize_link_inertia, mode: startup, params: "
    "{entity_cfg: {uid: ur10}, inertia_range: [0.9, 1.1]}}",
)
_event(
    "randomize_rigid_body_material",
    summary="Gives objects and links random coefficients of friction: Isaac Lab's event.",
    params={**ENTITY, **FRICTIONS},
    options=WAYS,
    defaults=_optional(FRICTIONS),
    example="{func: randomize_rigid_body_material, mode: reset, params: "
    "{entity_cfg: {uid: cube}, friction_range: [0.3, 1.2]}}",
)
_event(
    "randomize_ground_material",
    summary="Gives the ground plane random coefficients of friction.",
    params=FRICTIONS,
    options=WAYS,
    defaults=_optional(FRICTIONS),
    example="{func: randomize_ground_material, mode: reset, params: {friction_range: [0.4, 1.0]}}",
)
GAINS = {"stiffness_range": "stiffness", "damping_range": "damping"}
_event(
    "randomize_actuator_gains",
    summary="Gives the drives of joints random gains: Isaac Lab's event.",
    params={**ENTITY, **GAINS},
    options=WAYS,
    defaults=_optional(GAINS),
    example="{func: randomize_actuator_gains, mode: reset, params: {entity_cfg: {uid: ur10}, "
    "stiffness_range: [0.8, 1.2], damping_range: [0.8, 1.2], operation: scale}}",
)
_event(
    "randomize_effort_limits",
    summary="Gives the drives of joints random effort limits: mjlab's `effort_limits`.",
    params={**ENTITY, "effort_limit_range": "effort_limit"},
    options=WAYS,
    example="{func: randomize_effort_limits, mode: reset, params: "
    "{entity_cfg: {uid: ur10}, effort_limit_range: {'.*': [50.0, 300.0]}}}",
)
JOINTS = {
    "friction_range": "joint_friction",
    "armature_range": "armature",
    "damping_range": "joint_damping",
    "lower_limit_range": "lower_limit",
    "upper_limit_range": "upper_limit",
}
_event(
    "randomize_joint_parameters",
    summary="Gives joints random dry friction, armature, damping and limits: Isaac Lab's event.",
    params={**ENTITY, **JOINTS},
    options=WAYS,
    defaults=_optional(JOINTS),
    example="{func: randomize_joint_parameters, mode: reset, params: "
    "{entity_cfg: {uid: ur10}, friction_range: [0.0, 2.0], armature_range: [0.0, 0.1]}}",
)
_event(
    "randomize_actuator_strength",
    summary="Multiplies the force of joints' actuators by random factors.",
    params={**ENTITY, "strength_range": "strength"},
    options=("distribution",),
    example="{func: randomize_actuator_strength, mode: reset, params: "
    "{entity_cfg: {uid: ur10}, strength_range: [0.8, 1.1]}}",
)
_event(
    "randomize_physics_scene_gravity",
    summary="Gives each environment a random gravity: Isaac Lab's event.",
    params={"gravity_range": "gravity"},
    options=WAYS,
    example="{func: randomize_physics_scene_gravity, mode: reset, params: "
    "{gravity_range: [[-0.2, -0.2, -0.5], [0.2, 0.2, 0.5]]}}",
)
_event(
    "randomize_rigid_object_scale",
    summary="Gives an object a random size: EmbodiChain's event.",
    params={**ENTITY, "scale_factor_range": "scale"},
    options=("same_scale_all_axes", "fixed_density", "distribution"),
    example="{func: randomize_rigid_object_scale, mode: reset, params: "
    "{entity_cfg: {uid: cube}, scale_factor_range: [0.8, 1.2]}}",
)
_event(
    "randomize_rigid_objects_scale",
    summary="Gives several objects random sizes: EmbodiChain's event.",
    params={"entity_cfgs": "entity_cfgs", "scale_factor_range": "scale"},
    options=("same_scale_all_axes", "shared_sample", "fixed_density", "distribution"),
    example="{func: randomize_rigid_objects_scale, mode: reset, params: {entity_cfgs: "
    "[{uid: cube}, {uid: goal}], scale_factor_range: [0.9, 1.1], shared_sample: true}}",
)
