"""Checks of terms: that they exist, and their parameters against signatures.

For a whole task, and for one term when it is built. `scene_setup` checks that the entities in
parameters exist. Imports no torch.
"""

from __future__ import annotations

import dataclasses
import inspect
import typing
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from pydantic import PydanticSchemaGenerationError, TypeAdapter, ValidationError

from embodichain.lab.gym.envs.cfg import (
    LARGEST_WEIGHT,
    ActionTermCfg,
    EnvCfg,
    EventCfg,
    ObservationCfg,
    SceneEntityCfg,
    TermCfg,
    ValueCfg,
)
from embodichain.lab.gym.envs.managers.param_types import references
from embodichain.lab.gym.envs.managers.term import ActionTerm, CommandTerm
from embodichain.lab.gym.envs.managers.terms.registry import (
    SECTIONS,
    SHAPES,
    TERMS,
    Kind,
    TermSpec,
    call_mistake,
    resolve_term,
)
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.fields.type_errors import (
    expected_kind,
    said_twice,
    unknown_key,
    what_is_wrong,
)
from embodichain.utils.suggest import did_you_mean, listing

__all__ = [
    "CheckedTerm",
    "check_in_task",
    "check_params",
    "check_term",
    "check_term_shape",
    "check_terms",
    "check_weight",
]

_ENTITIES = (
    "entity_cfg",
    "source_entity_cfg",
    "target_entity_cfg",
    "end_effector_cfg",
    "object_cfg",
    "goal_cfg",
    "reference_entity_cfg",
)
"""Parameters that EmbodiChain reads as references to entities because of their names;
`entity_cfgs` is a list of them."""
_REFERENCES = {"command_name": "commands", "sensor": "sensors"}
"""Parameters whose value is the name of an entry of another section."""


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
            checked, mistakes = check_term(kind, term, path, allow_import=allow_import)
            problems += mistakes
            if checked is not None:
                problems += check_in_task(checked, cfg, f"{path}.params", allow_import)
    problems += check_corruption(cfg)
    problems += _check_modifiers(cfg)
    return problems


@dataclass(frozen=True)
class CheckedTerm:
    """A declared term without a mistake.

    Attributes:
        spec: The function or class behind it.
        values: Its parameters as `check_params` returns them.
        names: Parameter, by its name in Python and in configs -> the name that this config writes.
        shapes: Its shapes in order, with their parameters.
    """

    spec: TermSpec
    values: dict[str, Any]
    names: dict[str, str]
    shapes: tuple[tuple[TermSpec, dict[str, Any]], ...] = ()


def check_in_task(
    term: CheckedTerm, cfg: EnvCfg, path: str, allow_import: bool = True
) -> list[Problem]:
    """Check a term against the whole task: references to commands and sensors, and curricula.

    A term class may have a class method ``check_task(task, params, allow_import)`` that returns
    such mistakes, with paths relative to the parameters.

    Args:
        term: The term.
        cfg: The task.
        path: Key path of the parameters.
        allow_import: See `check_terms`.
    """
    spec = term.spec
    problems: list[Problem] = []
    for name, section in _REFERENCES.items():
        if name in spec.params:
            problems += _check_entry(name, term.values.get(name), section, cfg)
    hints = spec.hints()
    for name, value in term.values.items():
        for reference in references(hints.get(name)):
            problems += [Problem(name, p.message, p.hint) for p in reference.check(cfg, value)]
    check_task = getattr(spec.func, "check_task", None)
    if check_task is not None:
        problems += check_task(cfg, term.values, allow_import)
    return [Problem(f"{path}.{p.path}", p.message, p.hint) for p in problems]


def _check_entry(name: str, value: Any, section: str, cfg: EnvCfg) -> list[Problem]:
    """Return the mistake that a parameter names an entry of a section that does not exist."""
    entries = getattr(cfg, section)
    if not isinstance(value, str) or value in entries:
        return []
    if section == "sensors" and cfg.id is not None:
        return []  # Python code may add sensors
    kind = section.removesuffix("s")
    message = f"no {kind} is called {value!r}; there are: {listing(entries, value)}"
    return [Problem(name, message, did_you_mean(value, entries).strip())]


def check_term(
    kind: Kind, term: TermCfg, path: str, *, allow_import: bool = True
) -> tuple[CheckedTerm | None, list[Problem]]:
    """Check one declared term.

    Args:
        kind: The manager that runs it.
        term: Its declaration.
        path: Its key path, for messages.
        allow_import: See `check_terms`.

    Returns:
        The term (None if it has a mistake), and every mistake.
    """
    problems: list[Problem] = []
    if isinstance(term, ActionTermCfg | ObservationCfg) and term.noise is not None:
        problems += [problem.below(f"{path}.noise") for problem in term.noise.check()]
    shapes, mistakes = check_term_shape(getattr(term, "shape", None), f"{path}.shape")
    problems += mistakes
    try:
        spec = resolve_term(kind, term.func, allow_import=allow_import)
    except ConfigError as error:
        problems += [Problem(f"{path}.func", p.message, p.hint) for p in error.problems]
        return None, problems
    problems += _check_class(f"{path}.func", spec)
    if isinstance(term, EventCfg) and term.strength != 1.0 and not spec.takes_strength:
        events = TERMS["event"].values()
        able = ", ".join(sorted(event.name for event in events if event.takes_strength))
        message = f"{spec.name} draws nothing that has a default; these events do: {able}"
        problems.append(Problem(f"{path}.strength", message))
    values, mistakes = check_params(spec, term.params, f"{path}.params")
    problems += mistakes
    if problems:
        return None, problems
    written = {parameter: name for name, parameter in spec.written(term.params).items()}
    in_python = {name: written.get(word, word) for name, word in spec.python_names().items()}
    names = {**in_python, **written}
    return CheckedTerm(spec=spec, values=values, names=names, shapes=shapes), []


def check_term_shape(
    shape: Any, path: str
) -> tuple[tuple[tuple[TermSpec, dict[str, Any]], ...], list[Problem]]:
    """Check the `shape` of a term.

    Args:
        shape: A name, ``{name: parameters}``, or a list of these; None is none. Parameters are a
            map, or the value of the first one.
        path: Its key path.

    Returns:
        The shapes with their parameters, and every mistake.
    """
    TERMS["reward"]  # shapes are registered with the terms
    if shape is None:
        return (), []
    if not isinstance(shape, (list, tuple)):
        step, problems = _check_one_shape(shape, path)
        return (() if step is None else (step,)), problems
    steps: list[tuple[TermSpec, dict[str, Any]]] = []
    problems = []
    for i, value in enumerate(shape):
        step, mistakes = _check_one_shape(value, f"{path}.{i}")
        problems += mistakes
        if step is not None:
            steps.append(step)
    return tuple(steps), problems


def _check_one_shape(
    step: Any, path: str
) -> tuple[tuple[TermSpec, dict[str, Any]] | None, list[Problem]]:
    """Check one shape; return it with its parameters (None if it is unknown), and every mistake."""
    params: Any = {}
    if isinstance(step, str):
        name: Any = step
    elif isinstance(step, Mapping) and len(step) == 1:
        ((name, params),) = step.items()
    else:
        message = f"expected a name or one `name: parameters`, got {step!r}"
        return None, [Problem(path, message)]
    spec = SHAPES.get(name)
    if spec is None:
        message = f"unknown shape {name!r}; allowed: {', '.join(SHAPES)}"
        return None, [Problem(path, message, did_you_mean(str(name), SHAPES).strip())]
    if not isinstance(params, Mapping):  # the value of the first parameter
        params = {next(iter(spec.params), ""): params}
    values, problems = check_params(spec, params, f"{path}.{name}")
    return (spec, values), problems


def _check_class(path: str, spec: TermSpec) -> list[Problem]:
    if spec.kind == "action":
        if not (isinstance(spec.func, type) and issubclass(spec.func, ActionTerm)):
            return [Problem(path, f"{spec.label} must be a subclass of ActionTerm")]
    elif spec.kind == "command":
        if not (isinstance(spec.func, type) and issubclass(spec.func, CommandTerm)):
            return [Problem(path, f"{spec.label} must be a subclass of CommandTerm")]
    elif spec.is_class and "__call__" not in dir(spec.func):
        return [Problem(path, f"class {spec.name!r} must define __call__")]
    elif spec.is_class:
        mistake = call_mistake(spec, spec.kind)
        if mistake is not None:
            return [Problem(path, mistake)]
    return []


def _check_modifiers(cfg: EnvCfg) -> list[Problem]:
    """Check that modified entries were added before, or are the robot's or a sensor's."""
    entries: list[str] = ["robot/qpos", "robot/qvel", "robot/qf"]
    for uid, sensor in cfg.sensors.items():
        if sensor.observe:
            entries += [f"sensor/{uid}/{name}" for name in sensor.readings()]
    problems: list[Problem] = []
    for key, term in cfg.observations.items():
        name = term.name or key
        path = f"observations.{key}.name"
        if term.mode == "add" and name in entries:
            problems.append(Problem(path, f"the observation {name!r} exists already"))
        if term.mode == "modify" and name not in entries and not cfg.id:
            message = f"nothing to modify is called {name!r}; before it: {', '.join(entries)}"
            problems.append(Problem(path, message, did_you_mean(name, entries).strip()))
        entries.append(name)
    return problems


def check_params(
    spec: TermSpec, params: Mapping[str, Any], path: str
) -> tuple[dict[str, Any], list[Problem]]:
    """Check a term's parameters against its signature.

    Args:
        spec: The term.
        params: The parameters in the config.
        path: Key path of `params`, for messages.

    Returns:
        The values in the types of the annotations (dicts made `SceneEntityCfg`), without defaults,
        and every mistake.
    """
    values: dict[str, Any] = {}
    problems: list[Problem] = []
    hints = spec.hints()
    parameters = spec.written(params)
    for name, value in params.items():
        key = parameters.get(name)
        if key is None:
            allowed = ", ".join(spec.params) or "no parameters"
            message = f"unknown parameter of {spec.label}; it takes {allowed}"
            advice = did_you_mean(name, spec.params).strip()
            problems.append(Problem(f"{path}.{name}", message, advice))
        elif key != name and key in params:
            problems.append(Problem(f"{path}.{name}", said_twice(key)))
        else:
            hint = hints.get(key, Any)
            name_in_python = spec.params[key].name if key in spec.params else key
            try:
                values[key] = _convert(_type_of(name_in_python, hint, value), value)
            except ValidationError as error:
                problems += _problems_of(error, f"{path}.{name}", hint, value)
    for name, parameter in spec.params.items():
        if parameter.default is inspect.Parameter.empty and name not in parameters.values():
            message = f"missing; {spec.label} needs it"
            problems.append(Problem(f"{path}.{name}", message))
    return values, problems


def _type_of(name: str, hint: Any, value: Any) -> Any:
    """Return a parameter's type; without an annotation, its name says whether it is an entity."""
    if hint is not Any or not isinstance(value, (Mapping, list)):
        return hint
    if name in _ENTITIES:
        return SceneEntityCfg
    if name == "entity_cfgs":
        return list[SceneEntityCfg]
    return hint


def _convert(hint: Any, value: Any) -> Any:
    """Return a value in a type; raises pydantic's error if it does not fit."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    # A type that cannot be hashed cannot be a key of the cache.
    adapter = _adapter(hint) if isinstance(hint, Hashable) else _adapter.__wrapped__(hint)
    return value if adapter is None else adapter.validate_python(value)


@cache
def _adapter(hint: Any) -> TypeAdapter[Any] | None:
    """The pydantic adapter that checks a type; None if any value is allowed (users' types)."""
    try:
        return TypeAdapter(hint)
    except PydanticSchemaGenerationError:
        return None


def _problems_of(error: ValidationError, path: str, hint: Any, value: Any) -> list[Problem]:
    """Return pydantic's errors as problems, one a key path; members of a union all report."""
    places: dict[str, list[Any]] = {}
    for details in error.errors(include_url=False):
        tail = "".join(f".{key}" for key in _keys_of(details, value))
        places.setdefault(path + tail, []).append(details)
    problems: list[Problem] = []
    for place, errors in places.items():
        if any(other.startswith(f"{place}.") for other in places):
            continue  # of a member of a union that fits less
        first = errors[0]
        key = str(first["loc"][-1]) if first["loc"] else ""
        if first["type"] != "unexpected_keyword_argument":
            message, advice = what_is_wrong(errors)
        elif key == "weight" and _config_class(hint) is ValueCfg:
            message = _NO_WEIGHT
            advice = ""
        else:
            message, advice = unknown_key(key, _fields(hint))
        problems.append(Problem(place, message, advice, expected=expected_kind(errors)))
    return problems


_NO_WEIGHT = (
    "a term within this one has no weight: give it to the whole term, or use sum_of, whose terms "
    "have weights"
)


def _keys_of(details: Any, value: Any) -> Iterator[str | int]:
    """Yield the location of an error, without pydantic's tags of unions between the keys."""
    location = details["loc"]
    for i, part in enumerate(location):
        is_key = isinstance(value, Mapping) and part in value
        is_index = isinstance(value, (list, tuple)) and isinstance(part, int) and part < len(value)
        if is_key or is_index:
            value = value[part]
            yield part
        elif i == len(location) - 1 and details["type"] == "missing":
            yield part


def _fields(hint: Any) -> list[str]:
    """Return the keys of the config class that an annotation names; of an entity without one."""
    cls = _config_class(hint) or SceneEntityCfg
    return [field.name.removesuffix("_") for field in dataclasses.fields(cls)]


def _config_class(hint: Any) -> type[Any] | None:
    """Return the first config class in an annotation, within lists, maps and unions too."""
    has_own_schema = hasattr(hint, "__get_pydantic_core_schema__")
    if isinstance(hint, type) and dataclasses.is_dataclass(hint) and not has_own_schema:
        return hint
    for argument in typing.get_args(hint):
        cls = _config_class(argument)
        if cls is not None:
            return cls
    return None


def check_weight(path: str, weight: float) -> list[Problem]:
    """Return the mistake of a weight: that it is not finite, as float32.

    Args:
        path: Its key path.
        weight: The weight.
    """
    if abs(weight) <= LARGEST_WEIGHT:  # not so for NaN
        return []
    return [Problem(path, f"must be a finite number (of float32), got {weight}")]


def check_corruption(cfg: EnvCfg) -> list[Problem]:
    """Return the groups in `enable_corruption` that have no observation."""
    if isinstance(cfg.enable_corruption, bool):
        return []
    groups = list(dict.fromkeys(term.group for term in cfg.observations.values()))
    problems: list[Problem] = []
    for name in cfg.enable_corruption:
        if name not in groups:
            there_are = ", ".join(groups) or "none"
            message = f"no observation is in group {name!r}; there are: {there_are}"
            hint = did_you_mean(name, groups).strip()
            problems.append(Problem(f"enable_corruption.{name}", message, hint))
    return problems
