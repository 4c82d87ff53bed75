"""Checks of terms: their parameters against signatures, and their keys besides `func` and `params`.

For a whole task, and for one term when it is built. `scene_setup` checks that the entities in
parameters exist. Imports no torch.
"""

from __future__ import annotations

import dataclasses
import inspect
import typing
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import PydanticSchemaGenerationError, TypeAdapter, ValidationError

from embodichain.lab.gym.envs.cfg import (
    ActionTermCfg,
    CommandCfg,
    EnvCfg,
    EventCfg,
    NoiseCfg,
    ObservationCfg,
    RewardCfg,
    SceneEntityCfg,
    SummandCfg,
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
    "check_shape",
    "check_term",
    "check_terms",
    "check_weight",
]

_ENTITIES = (
    *("entity_cfg", "source_entity_cfg", "target_entity_cfg", "end_effector_cfg", "object_cfg"),
    *("goal_cfg", "reference_entity_cfg"),
)
"""Parameters that EmbodiChain reads as references to entities because of their names;
`entity_cfgs` is a list of them."""
_LARGEST_WEIGHT = float(np.finfo(np.float32).max)
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
            checked, found = check_term(kind, term, path, allow_import=allow_import)
            problems += found
            if checked is not None:
                problems += check_in_task(checked, cfg, f"{path}.params", allow_import)
    return problems + check_corruption(cfg) + _check_modifiers(cfg)


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
    found: list[Problem] = []
    spec, values = term.spec, term.values
    for name, section in _REFERENCES.items():
        there, value = getattr(cfg, section), values.get(name)
        if isinstance(value, str) and value not in there and name in spec.params:
            if section == "sensors" and cfg.id is not None:
                continue  # Python code may add sensors
            what, known = section.removesuffix("s"), listing(there, value)
            message = f"no {what} is called {value!r}; there are: {known}"
            found.append(Problem(name, message, did_you_mean(value, there).strip()))
    hints = spec.hints()
    for name, value in values.items():
        for reference in references(hints.get(name)):
            found += [Problem(name, p.message, p.hint) for p in reference.check(cfg, value)]
    check = getattr(spec.func, "check_task", None)
    if check is not None:
        found += check(cfg, values, allow_import)
    return [Problem(f"{path}.{p.path}", p.message, p.hint) for p in found]


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
    problems = check_fields(path, term)
    shapes, found = check_shape(getattr(term, "shape", None), f"{path}.shape")
    problems += found
    try:
        spec = resolve_term(kind, term.func, allow_import=allow_import)
    except ConfigError as error:
        found = [Problem(f"{path}.func", p.message, p.hint) for p in error.problems]
        return None, problems + found
    problems += _check_class(f"{path}.func", spec)
    values, found = check_params(spec, term.params, f"{path}.params")
    problems += found
    if problems:
        return None, problems
    written = {meant: name for name, meant in spec.written(term.params).items()}
    python = {name: written.get(word, word) for name, word in spec.python_names().items()}
    return CheckedTerm(spec, values, {**python, **written}, shapes), []


def check_shape(
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
    steps: list[tuple[TermSpec, dict[str, Any]]] = []
    problems: list[Problem] = []
    several = isinstance(shape, (list, tuple))
    for i, step in enumerate(shape if several else [] if shape is None else [shape]):
        where = f"{path}.{i}" if several else path
        if isinstance(step, Mapping) and len(step) == 1:
            ((name, given),) = step.items()
        elif isinstance(step, str):
            name, given = step, {}
        else:
            message = f"expected a name or one `name: parameters`, got {step!r}"
            problems.append(Problem(where, message))
            continue
        spec = SHAPES.get(name)
        if spec is None:
            message = f"unknown shape {name!r}; allowed: {', '.join(SHAPES)}"
            problems.append(Problem(where, message, did_you_mean(str(name), SHAPES).strip()))
            continue
        if not isinstance(given, Mapping):
            given = {next(iter(spec.params), ""): given}
        values, found = check_params(spec, given, f"{where}.{name}")
        problems += found
        steps.append((spec, values))
    return tuple(steps), problems


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
    """Check that modified entries were added before, or are the robot's or a sensor's."""
    known: list[str] = ["robot/qpos", "robot/qvel", "robot/qf"]
    for uid, sensor in cfg.sensors.items():
        known += [f"sensor/{uid}/{name}" for name in sensor.readings() if sensor.observe]
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
        params: The parameters in the config.
        path: Key path of `params`, for messages.

    Returns:
        The values in the types of the annotations (dicts made `SceneEntityCfg`), without defaults,
        and every mistake.
    """
    values: dict[str, Any] = {}
    problems: list[Problem] = []
    hints, meant = spec.hints(), spec.written(params)
    for name, value in params.items():
        key = meant.get(name)
        if key is None:
            allowed = ", ".join(spec.params) or "no parameters"
            message = f"unknown parameter of {spec.label}; it takes {allowed}"
            hint = did_you_mean(name, spec.params).strip()
            problems.append(Problem(f"{path}.{name}", message, hint))
        elif key != name and key in params:
            problems.append(Problem(f"{path}.{name}", said_twice(key)))
        else:
            hint = hints.get(key, Any)
            try:
                name_in_python = spec.params[key].name if key in spec.params else key
                values[key] = _convert(_meant(name_in_python, hint, value), value)
            except ValidationError as error:
                problems += _problems_of(error, f"{path}.{name}", hint, value)
    for name, parameter in spec.params.items():
        if parameter.default is inspect.Parameter.empty and name not in meant.values():
            message = f"missing; {spec.label} needs it"
            problems.append(Problem(f"{path}.{name}", message))
    return values, problems


def _meant(name: str, hint: Any, value: Any) -> Any:
    """Read a parameter; without an annotation, its name says whether it refers to an entity."""
    if hint is not Any or not isinstance(value, (Mapping, list)):
        return hint
    if name in _ENTITIES:
        return SceneEntityCfg
    return list[SceneEntityCfg] if name == "entity_cfgs" else hint


def _convert(hint: Any, value: Any) -> Any:
    if isinstance(value, np.ndarray):
        value = value.tolist()
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
    """Pydantic's errors as problems, one for each key path; members of a union all report."""
    places: dict[str, list[Any]] = {}
    for details in error.errors(include_url=False):
        tail = "".join(f".{part}" for part in _keys_of(details, value))
        places.setdefault(path + tail, []).append(details)
    problems: list[Problem] = []
    for place, found in places.items():
        if any(other.startswith(f"{place}.") for other in places):
            continue  # of a member of a union that fits less
        key = str(found[0]["loc"][-1]) if found[0]["loc"] else ""
        if found[0]["type"] == "unexpected_keyword_argument":
            message, advice = unknown_key(key, _fields(hint))
            if key == "weight" and _config_class(hint) is ValueCfg:
                message, advice = _NO_WEIGHT, ""
        else:
            message, advice = what_is_wrong(found)
        problems.append(Problem(place, message, advice, expected=expected_kind(found)))
    return problems


_NO_WEIGHT = (
    "a term within this one has no weight: give it to the whole term, or use sum_of, whose terms "
    "have weights"
)


def _keys_of(details: Any, value: Any) -> Iterator[str | int]:
    """The location of an error without the tags of unions that pydantic puts between the keys."""
    for i, part in enumerate(details["loc"]):
        last = i == len(details["loc"]) - 1
        in_map = isinstance(value, Mapping) and part in value
        in_list = isinstance(value, (list, tuple)) and isinstance(part, int) and part < len(value)
        if in_map or in_list:
            value = value[part]
        elif not (last and details["type"] == "missing"):
            continue
        yield part


def _fields(hint: Any) -> list[str]:
    """Keys of the config class that an annotation names; of an entity if it names none."""
    cls = _config_class(hint) or SceneEntityCfg
    return [field.name for field in dataclasses.fields(cls)]


def _config_class(hint: Any) -> type[Any] | None:
    """The first config class in an annotation, within lists, maps and unions too."""
    own_schema = hasattr(hint, "__get_pydantic_core_schema__")
    if isinstance(hint, type) and dataclasses.is_dataclass(hint) and not own_schema:
        return hint
    found = map(_config_class, typing.get_args(hint))
    return next((cls for cls in found if cls is not None), None)


_NOISE = {
    "gaussian": ("mean", "std"),
    "uniform": ("low", "high", "n_min", "n_max"),
    "constant": ("bias",),
}
_ALIASES = (("low", "n_min"), ("high", "n_max"))


def check_fields(path: str, term: TermCfg) -> list[Problem]:
    """Return the mistakes of one term in keys other than `func` and `params`.

    Args:
        path: Its key path.
        term: Its declaration.
    """
    if isinstance(term, EventCfg):
        return _check_times(f"{path}.interval_range_s", term.interval_range_s)
    if isinstance(term, CommandCfg):
        return _check_times(f"{path}.resampling_time_s", term.resampling_time_s)
    if isinstance(term, ObservationCfg):
        return _check_observation(path, term)
    if isinstance(term, (RewardCfg, SummandCfg)):
        return check_weight(f"{path}.weight", term.weight)
    return _check_disturbance(path, term) if isinstance(term, ActionTermCfg) else []


def check_weight(path: str, weight: float) -> list[Problem]:
    """Return the mistake of a weight: that it is not finite, as float32.

    Args:
        path: Its key path.
        weight: The weight.
    """
    if abs(weight) <= _LARGEST_WEIGHT:  # not so for NaN
        return []
    return [Problem(path, f"must be a finite number (of float32), got {weight}")]


def _check_times(path: str, seconds: Sequence[float] | None) -> list[Problem]:
    if seconds is None or 0 < seconds[0] <= seconds[1] < float("inf"):
        return []
    return [Problem(path, f"needs 0 < low <= high, got [{seconds[0]}, {seconds[1]}]")]


def _check_observation(path: str, term: ObservationCfg) -> list[Problem]:
    found = _check_disturbance(path, term)
    if term.clip is not None and not term.clip[0] <= term.clip[1]:
        found.append(Problem(f"{path}.clip", f"low exceeds high in {list(term.clip)}"))
    if term.name is not None and not all(term.name.split("/")):
        found.append(Problem(f"{path}.name", f"has an empty part: {term.name!r}"))
    return found


def _check_disturbance(path: str, term: ActionTermCfg | ObservationCfg) -> list[Problem]:
    """Check noise and delay, which actions and observations have."""
    found = [] if term.noise is None else _check_noise(f"{path}.noise", term.noise)
    delay: Any = term.delay
    low, high = (delay, delay) if isinstance(delay, int) else delay
    if not 0 <= low <= high:
        found.append(Problem(f"{path}.delay", f"needs 0 <= low <= high, got {delay}"))
    return found


def _check_noise(path: str, noise: Any) -> list[Problem]:
    if not isinstance(noise, NoiseCfg):  # from Python; in YAML pydantic has checked the type
        kind = type(noise).__name__
        return [Problem(path, f"must be a NoiseCfg, got {kind}; NoiseCfg.from_dict makes one")]
    if noise.type not in _NOISE:
        hint = did_you_mean(str(noise.type), _NOISE).strip()
        message = f"unknown type {noise.type!r}; one of: {', '.join(_NOISE)}"
        return [Problem(f"{path}.type", message, hint)]
    allowed = _NOISE[noise.type]
    given = [n for names in _NOISE.values() for n in names if getattr(noise, n) is not None]
    strange = [name for name in given if name not in allowed]
    found = [
        Problem(f"{path}.{n}", f"noise of type {noise.type!r} takes {', '.join(allowed)}")
        for n in strange
    ]
    for name, alias in _ALIASES:
        if name in given and alias in given:
            found.append(Problem(f"{path}.{alias}", said_twice(name)))
    needed = {"gaussian": ("std",), "uniform": ("low", "high"), "constant": ("bias",)}[noise.type]
    aliases = dict(_ALIASES)
    missing = [n for n in needed if n not in given and aliases.get(n) not in given]
    found += [
        Problem(f"{path}.{n}", f"missing; noise of type {noise.type!r} needs it")
        for n in missing
        if not strange
    ]
    wild = [n for n in given if not np.isfinite(_numbers_in(getattr(noise, n))).all()]
    found += [Problem(f"{path}.{name}", "must be finite") for name in wild]
    return found or _check_noise_order(path, noise)


def _numbers_in(value: Any) -> NDArray[np.float64]:
    """The numbers of a number, a list or a map."""
    return np.asarray(list(value.values()) if isinstance(value, Mapping) else value, np.float64)


def _check_noise_order(path: str, noise: NoiseCfg) -> list[Problem]:
    if noise.type == "gaussian" and (_numbers_in(noise.std) < 0).any():
        return [Problem(f"{path}.std", f"must not be negative, got {noise.std}")]
    if noise.type != "uniform":
        return []
    low = noise.n_min if noise.low is None else noise.low
    high = noise.n_max if noise.high is None else noise.high
    if isinstance(low, Mapping) or isinstance(high, Mapping):
        return []  # compared when they are spread over columns
    lists = [bound for bound in (low, high) if isinstance(bound, list)]
    if len({len(bound) for bound in lists}) > 1:
        return [Problem(path, f"low has {len(lists[0])} values, high {len(lists[1])}")]
    if (np.asarray(low) > np.asarray(high)).any():
        return [Problem(path, f"low {low} exceeds high {high}")]
    return []


def check_corruption(cfg: EnvCfg) -> list[Problem]:
    """Return the groups in `enable_corruption` that have no observation."""
    if isinstance(cfg.enable_corruption, bool):
        return []
    groups = list(dict.fromkeys(term.group for term in cfg.observations.values()))
    return [
        Problem(
            f"enable_corruption.{name}",
            f"no observation is in group {name!r}; there are: {', '.join(groups) or 'none'}",
            did_you_mean(name, groups).strip(),
        )
        for name in cfg.enable_corruption
        if name not in groups
    ]
