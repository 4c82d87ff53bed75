"""Checks of terms against their signatures, for a whole config and for one term being built.

Entities that parameters point at are checked against the scene elsewhere
(`embodichain.lab.sim.compiler.describe`). No torch here.
"""

from __future__ import annotations

import dataclasses
import inspect
import typing
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import PydanticSchemaGenerationError, TypeAdapter, ValidationError

from embodichain.lab.gym.envs.cfg import EnvCfg, SceneEntityCfg, TermCfg
from embodichain.lab.gym.envs.managers.check_fields import check_corruption, check_fields
from embodichain.lab.gym.envs.managers.param_types import FORMS
from embodichain.lab.gym.envs.managers.registry import Kind, TermSpec, resolve_term
from embodichain.lab.gym.envs.managers.term import ActionTerm, CommandTerm
from embodichain.lab.sim.sensors.cfg import readings
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["SECTIONS", "check_in_task", "check_params", "check_term", "check_terms"]

SECTIONS: dict[str, Kind] = {
    "actions": "action",
    "events": "event",
    "commands": "command",
    "observations": "observation",
    "rewards": "reward",
    "terminations": "termination",
    "metrics": "metric",
    "curriculum": "curriculum",
}
"""Sections of a task and the kind of term each holds."""

_ENTITIES = (
    *("entity_cfg", "source_entity_cfg", "target_entity_cfg", "end_effector_cfg", "object_cfg"),
    *("goal_cfg", "reference_entity_cfg"),
)
"""Parameters that EmbodiChain takes for references to entities by their names alone; so is
`entity_cfgs`, a list of them."""
_REFERENCES = {"command_name": "commands", "sensor": "sensors"}
"""Parameters that name an entry of another section."""


def check_terms(cfg: EnvCfg, *, allow_import: bool = True) -> list[Problem]:
    """Check every term of a task: that it exists and takes the parameters given.

    Args:
        cfg: The task.
        allow_import: Whether ``package.module:function`` is imported to read its signature; False
            makes such a term a problem (for configs that come from a log).

    Returns:
        Every mistake, with paths relative to the task; empty if there is none.
    """
    problems: list[Problem] = []
    for section, kind in SECTIONS.items():
        for name, term in getattr(cfg, section).items():
            path = f"{section}.{name}"
            spec, values, found = check_term(kind, term, path, allow_import=allow_import)
            problems += found
            if spec is not None and not found:
                problems += check_in_task(spec, values, cfg, f"{path}.params", allow_import)
    return problems + check_corruption(cfg) + _check_modifiers(cfg)


def check_in_task(
    spec: TermSpec, values: Mapping[str, Any], cfg: EnvCfg, path: str, allow_import: bool = True
) -> list[Problem]:
    """Check what only the whole task shows: references to commands and sensors, and curricula.

    A term class may bring a class method ``check_task(task, params, allow_import)`` that returns
    such mistakes, with paths relative to the parameters.

    Args:
        spec: The term.
        values: Its parameters as `check_params` returns them.
        cfg: The task.
        path: Key path of the parameters.
        allow_import: See `check_terms`.
    """
    found: list[Problem] = []
    for name, section in _REFERENCES.items():
        there, value = getattr(cfg, section), values.get(name)
        if isinstance(value, str) and value not in there and name in spec.params:
            if section == "sensors" and cfg.id is not None:
                continue  # Python code may add sensors
            what, known = section.removesuffix("s"), listing(there, value)
            message = f"no {what} is called {value!r}; there are: {known}"
            found.append(Problem(name, message, did_you_mean(value, there).strip()))
    check = getattr(spec.func, "check_task", None)
    if check is not None:
        found += check(cfg, values, allow_import)
    return [Problem(f"{path}.{p.path}", p.message, p.hint) for p in found]


def check_term(
    kind: Kind, term: TermCfg, path: str, *, allow_import: bool = True
) -> tuple[TermSpec | None, dict[str, Any], list[Problem]]:
    """Check one declared term.

    Args:
        kind: The manager that runs it.
        term: Its declaration.
        path: Its key path, for messages.
        allow_import: See `check_terms`.

    Returns:
        The function or class behind it (None if there is none), its parameters as `check_params`
        returns them, and every mistake.
    """
    problems = check_fields(path, term)
    try:
        spec = resolve_term(kind, term.func, allow_import=allow_import)
    except ConfigError as error:
        found = [Problem(f"{path}.func", p.message, p.hint) for p in error.problems]
        return None, {}, problems + found
    problems += _check_class(f"{path}.func", spec)
    values, found = check_params(spec, term.params, f"{path}.params")
    return spec, values, problems + found


def _check_class(path: str, spec: TermSpec) -> list[Problem]:
    if spec.kind == "action":
        if not (isinstance(spec.func, type) and issubclass(spec.func, ActionTerm)):
            return [Problem(path, f"{spec.label} must be a subclass of ActionTerm")]
    elif spec.kind == "command":
        if not (isinstance(spec.func, type) and issubclass(spec.func, CommandTerm)):
            return [Problem(path, f"{spec.label} must be a subclass of CommandTerm")]
    elif spec.is_class and "__call__" not in dir(spec.func):
        return [Problem(path, f"class {spec.name!r} must define __call__")]
    return []


def _check_modifiers(cfg: EnvCfg) -> list[Problem]:
    """An entry that is modified must have been added before, or be the robot's or a sensor's."""
    known: list[str] = ["robot/qpos", "robot/qvel", "robot/qf"]
    for uid, sensor in cfg.sensors.items():
        known += [f"sensor/{uid}/{name}" for name in readings(sensor) if sensor.observe]
    found: list[Problem] = []
    for key, term in cfg.observations.items():
        name = term.name or key
        path = f"observations.{key}.name"
        if term.mode == "add" and name in known:
            found.append(Problem(path, f"the observation {name!r} exists already"))
        if term.mode == "modify" and name not in known and not cfg.id:
            hint = did_you_mean(name, known).strip()
            message = f"nothing to modify is called {name!r}; before it: {', '.join(known)}"
            found.append(Problem(path, message, hint))
        known.append(name)
    return found


def check_params(
    spec: TermSpec, params: Mapping[str, Any], path: str
) -> tuple[dict[str, Any], list[Problem]]:
    """Check a term's parameters against its signature.

    Args:
        spec: The term.
        params: What the config gives.
        path: Key path of `params`, for messages.

    Returns:
        The values as the annotations ask for them (dicts made `SceneEntityCfg`), without defaults,
        and every mistake.
    """
    values: dict[str, Any] = {}
    problems: list[Problem] = []
    hints = spec.hints()
    for name, value in params.items():
        if name not in spec.params and not spec.open_params:
            allowed = ", ".join(spec.params) or "no parameters"
            message = f"unknown parameter of {spec.label}; it takes {allowed}"
            hint = did_you_mean(name, spec.params).strip()
            problems.append(Problem(f"{path}.{name}", message, hint))
            continue
        try:
            values[name] = _convert(_meant(name, hints.get(name, Any), value), value)
        except ValidationError as error:
            hint = hints.get(name, Any)
            problems += [_problem(f"{path}.{name}", e, hint) for e in error.errors()]
    for name, parameter in spec.params.items():
        if parameter.default is inspect.Parameter.empty and name not in params:
            message = f"missing; {spec.label} needs it"
            problems.append(Problem(f"{path}.{name}", message))
    return values, problems


def _meant(name: str, hint: Any, value: Any) -> Any:
    """What a parameter is read as: without an annotation, its name tells references to entities."""
    if hint is not Any or not isinstance(value, (Mapping, list)):
        return hint
    if name in _ENTITIES:
        return SceneEntityCfg
    return list[SceneEntityCfg] if name == "entity_cfgs" else hint


def _convert(hint: Any, value: Any) -> Any:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    try:
        adapter: TypeAdapter[Any] = TypeAdapter(hint)
    except PydanticSchemaGenerationError:  # a user's own type: any value passes
        return value
    return adapter.validate_python(value)


def _problem(path: str, error: Any, hint: Any) -> Problem:
    """One of pydantic's errors as a line with what was found."""
    tail = "".join(f".{part}" for part in error["loc"] if part not in FORMS)
    message = error["msg"].removeprefix("Value error, ")
    message = message[:1].lower() + message[1:]
    if error["type"] == "unexpected_keyword_argument":
        fields = _fields(hint)
        hint = did_you_mean(str(error["loc"][-1]), fields).strip()
        return Problem(path + tail, f"unknown key; allowed: {', '.join(fields)}", hint)
    if error["type"] != "missing":
        message += f", got {error['input']!r}"
    return Problem(path + tail, message)


def _fields(hint: Any) -> list[str]:
    """Keys of the config class that an annotation names; of an entity if it names none."""
    if dataclasses.is_dataclass(hint) and not hasattr(hint, "__get_pydantic_core_schema__"):
        return [field.name for field in dataclasses.fields(hint)]
    for part in typing.get_args(hint):
        if dataclasses.is_dataclass(part):
            return _fields(part)
    return list(SceneEntityCfg.__dataclass_fields__)
