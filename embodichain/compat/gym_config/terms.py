"""Converts functors of a gym config to terms; parameters are checked with the whole task."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from embodichain.compat.gym_config.draft import Draft, Path
from embodichain.compat.gym_config.functors import (
    ACTIONS,
    LEFT_OUT,
    NEEDS_ANY,
    OF_CAMERA,
    PARAMS_LEFT_OUT,
    RENAMED,
    VISUAL,
)
from embodichain.compat.gym_config.vocabulary import (
    ACTION,
    EVENT,
    OBSERVATION,
    REWARD,
    Vocabulary,
)
from embodichain.lab.gym.envs.managers.terms.registry import TERMS, Kind, TermSpec

__all__ = ["convert_actions", "convert_terms"]

_TABLES: Mapping[str, tuple[Kind, Vocabulary]] = {
    "events": ("event", EVENT),
    "observations": ("observation", OBSERVATION),
    "rewards": ("reward", REWARD),
}
_OWN = "embodichain."
_JOINTS = {
    "part_name": "control_parts",
    "control_parts": "control_parts",
    "joint_names": "joint_names",
    "joint_ids": "joint_ids",
    "preserve_order": "preserve_order",
}
"""Parameters that pick a robot's joints -> the equivalent key of a reference."""
_EVERY_JOINT = "actions have only these; robot/qpos, robot/qvel and robot/qf have every joint"
_CLIPPED_THERE = ("default_offset_joint_position",)
"""Terms for which EmbodiChain clamps actions to the same bounds as here."""


def convert_terms(draft: Draft, section: str, env: Mapping[str, Any], robot: str) -> None:
    """Convert `env.events`, `env.observations` or `env.rewards`.

    Args:
        draft: The draft; the terms are added to it.
        section: ``events``, ``observations`` or ``rewards``.
        env: The section `env`.
        robot: The robot's uid, for functors that name none.
    """
    kind, vocabulary = _TABLES[section]
    for source, name, functor in draft.entries(env.get(section), ("env", section)):
        spec, func = _find_term(draft, kind, functor, source)
        if func is None:
            continue
        if func in VISUAL and env.get("filter_visual_rand"):
            draft.note(source, f"{func}: env.filter_visual_rand leaves it out")
            continue
        params = _drop_params(draft, _params(draft, functor, source), func, source)
        params = _rename_camera_params(params, func)
        if func in NEEDS_ANY and all(params.get(key) is None for key in NEEDS_ANY[func]):
            draft.note(source, f"{func}: nothing is left that it would change")
            continue
        target = (section, name)
        draft.put((*target, "func"), func, (*source, "func"))
        if section == "observations":
            # EmbodiChain's default is to modify, here it is to add.
            draft.put((*target, "mode"), functor.get("mode", "modify"), (*source, "mode"))
        draft.apply_rules(functor, source, target, vocabulary)
        if params:
            params = _with_entity(params, spec, {"uid": robot})
            draft.put((*target, "params"), params, (*source, "params"))


def convert_actions(draft: Draft, env: Mapping[str, Any], robot: str) -> None:
    """Convert `env.actions`; without it, actions are position targets of active parts or joints.

    Args:
        draft: The draft; the terms are added to it.
        env: The section `env`.
        robot: The robot's uid.
    """
    entity: dict[str, Any] = {"uid": robot}
    for key, name in (("active_joint_ids", "joint_ids"), ("control_parts", "control_parts")):
        if not env.get(key):
            continue
        entity = {"uid": robot, name: env[key]}
        draft.note(("env", key), _EVERY_JOINT)
        if not env.get("actions"):
            term = {"func": "joint_position", "params": {"entity_cfg": entity}}
            draft.put(("actions", "qpos"), term, ("env", key))
    for source, name, functor in draft.entries(env.get("actions"), ("env", "actions")):
        spec, func = _find_term(draft, "action", functor, source)
        if func is not None:
            target = ("actions", name)
            draft.put((*target, "func"), func, (*source, "func"))
            draft.apply_rules(functor, source, target, ACTION)
            params = _action_params(draft, functor, source, spec, entity)
            draft.put((*target, "params"), params, (*source, "params"))


def _find_term(draft: Draft, kind: Kind, functor: Any, source: Path) -> tuple[TermSpec | None, Any]:
    """Find the term for a functor.

    Returns:
        The term, if it is registered; and its name here, or the function that was declared in
        Python. None leaves the functor out; the draft has a note or a problem then.
    """
    if not isinstance(functor, Mapping):
        draft.refuse(source, f"expected a map, got {functor!r}")
        return None, None
    key = "contract" if "func" not in functor and "contract" in functor else "func"
    func = functor.get(key)
    if callable(func):  # declared in Python: a user's function
        return None, func
    if not isinstance(func, str) or not func:
        draft.refuse((*source, key), "missing value: the name of a functor")
        return None, None
    name = _local_name(func)
    terms = TERMS[kind]
    if kind == "action":
        name = ACTIONS.get(name, name)
    elif kind == "event":
        name = RENAMED.get(name, name)
    if name not in terms and name in LEFT_OUT[kind]:
        message = f"{name}: {LEFT_OUT[kind][name]}"
        if kind == "action" and name != "QposNormalizedTerm":
            draft.refuse((*source, key), message)  # leaving it out would change the control
        else:
            draft.note(source, message)
        return None, None
    return terms.get(name), name


def _local_name(name: str) -> str:
    """A functor's local name; ``package.module:function`` for a user's dotted name."""
    if "." not in name or ":" in name or "@" in name:
        return name
    module, _, function = name.rpartition(".")
    if name.startswith(_OWN):
        return function
    return f"{module}:{function}"


def _params(draft: Draft, functor: Mapping[str, Any], source: Path) -> dict[str, Any]:
    """The parameters of a functor; empty if they are not a map."""
    params = functor.get("params")
    if params is not None and not isinstance(params, Mapping):
        draft.refuse((*source, "params"), f"expected a map, got {params!r}")
        return {}
    return dict(params or {})


def _drop_params(draft: Draft, params: dict[str, Any], func: str, source: Path) -> dict[str, Any]:
    """Return the parameters without those that have no effect here; adds a note for each."""
    reasons = PARAMS_LEFT_OUT.get(func, {})
    for key in params:
        if key in reasons:
            draft.note((*source, "params", key), reasons[key])
    return {key: value for key, value in params.items() if key not in reasons}


def _rename_camera_params(params: dict[str, Any], func: str) -> dict[str, Any]:
    """Return the parameters of a camera's event under their names here."""
    names = OF_CAMERA.get(func, {})
    renamed = {names.get(key, key): value for key, value in params.items()}
    camera = renamed.get(names.get("entity_cfg", ""))
    if isinstance(camera, Mapping) and isinstance(camera.get("uid"), str):
        renamed[names["entity_cfg"]] = camera["uid"]
    return renamed


def _with_entity(
    params: dict[str, Any], spec: TermSpec | None, entity: Mapping[str, Any]
) -> dict[str, Any]:
    """Move parameters that pick joints, and that the term here lacks, into its `entity_cfg`."""
    if spec is None or "of" not in spec.params or "of" in spec.written(params).values():
        return params
    of_entity = {}
    for key in (*_JOINTS, "robot_uid"):
        if key in params and key not in spec.params:
            of_entity[key] = params[key]
    if not of_entity and spec.kind != "action":  # the user has to name the term's entity
        return params
    others = {key: value for key, value in params.items() if key not in of_entity}
    joints = {}
    for key, value in of_entity.items():
        if key in _JOINTS and value is not None:
            joints[_JOINTS[key]] = value
    names_joints = bool(joints.keys() - {"preserve_order"})
    reference = {} if names_joints else dict(entity)
    reference["uid"] = of_entity.get("robot_uid", entity["uid"])
    return {"entity_cfg": {**reference, **joints}, **others}


def _action_params(
    draft: Draft,
    functor: Mapping[str, Any],
    source: Path,
    spec: TermSpec | None,
    entity: Mapping[str, Any],
) -> dict[str, Any]:
    """Parameters of an action term: its joints, and those of its formula."""
    params = _params(draft, functor, source)
    if spec is None:
        return params
    clip = spec.params.get("clip")
    default = None if clip is None else clip.default
    if isinstance(default, tuple) and "clip" not in params and spec.name not in _CLIPPED_THERE:
        bounds = list(default)
        params["clip"] = bounds
        draft.note(source, f"actions are clamped to {bounds}: set clip for other bounds")
    return _with_entity(params, spec, entity)
