"""Each parameter that refers to an entity says whether it takes links, sites or geoms of it."""

import typing

from embodichain.lab.gym.envs.managers.param_types import references
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.terms.registry import TERMS

BY_FIELD = {
    "randomize",  # each field says it: a link has a mass, a geom has friction
    "randomize_actuator_gains",
    "randomize_actuator_strength",
    "randomize_effort_limits",
    "randomize_joint_parameters",
    "randomize_link_inertia",
    "randomize_rigid_body_material",
    "randomize_rigid_object_scale",
    "randomize_rigid_objects_scale",
}
BY_JOINTS = {"joint_limit_penalty", "joint_velocity_penalty"}  # `joints_of` says it


def refers(hint) -> bool:
    return hint is ResolvedEntity or any(map(refers, typing.get_args(hint)))


def test_no_reference_is_without_a_mark() -> None:
    unmarked = {
        (name, parameter)
        for terms in TERMS.values()
        for name in terms
        for parameter, hint in terms[name].hints().items()
        if refers(hint) and not list(references(hint))
    }
    assert {name for name, _ in unmarked} - BY_FIELD - BY_JOINTS == set()
