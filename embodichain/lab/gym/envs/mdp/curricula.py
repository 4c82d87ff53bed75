"""Curricula that follow the number of control steps."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from embodichain.lab.gym.envs.cfg import EnvCfg, TermCfg
from embodichain.lab.gym.envs.managers.param_types import Finite
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.managers.terms.check import (
    check_params,
    check_term_shape,
    check_weight,
)
from embodichain.lab.gym.envs.managers.terms.registry import (
    SECTIONS,
    TermSpec,
    register_term,
    resolve_term,
)
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex

__all__ = [
    "ModifyRewardWeight",
    "ModifyTermParam",
]

_STAGES = 100
"""Number of stages of a gradual change: each stage rebuilds the term."""


def get_at(tree: Any, path: Sequence[str]) -> Any:
    """Return the value at a path of keys and indices.

    Raises:
        ConfigError: If the path does not exist; lists the keys that do.
    """
    for depth, part in enumerate(path):
        keys = _keys(tree)
        if part not in keys:
            parent = ".".join(path[:depth]) or "the parameters"
            existing = ", ".join(keys) or "nothing"
            raise ConfigError(
                f"there is no {part!r} in {parent}; there is: {existing}.{did_you_mean(part, keys)}"
            )
        tree = tree[part] if isinstance(tree, dict) else tree[int(part)]
    return tree


def _keys(tree: Any) -> list[str]:
    """The keys of a map, the indices of a list, nothing of anything else."""
    if isinstance(tree, dict):
        return [str(key) for key in tree]
    if isinstance(tree, (list, tuple)):
        return [str(i) for i in range(len(tree))]
    return []


def with_value(tree: Any, path: Sequence[str], value: Any) -> Any:
    """Return a copy of nested lists and maps with another value at an existing path."""
    if not path:
        return value
    key, *rest = path
    if isinstance(tree, dict):
        return {**tree, key: with_value(tree.get(key), rest, value)}
    copy_of_list = list(tree)
    copy_of_list[int(key)] = with_value(tree[int(key)], rest, value)
    return copy_of_list


def between(start: Any, end: Any, fraction: float) -> Any:
    """Return the linear interpolation of two values, number by number in lists and maps.

    Raises:
        ConfigError: If the two are not numbers, or lists or maps of the same form.
    """
    if isinstance(start, dict) and isinstance(end, dict) and start.keys() == end.keys():
        return {key: between(start[key], end[key], fraction) for key in start}
    are_lists = isinstance(start, (list, tuple)) and isinstance(end, (list, tuple))
    if are_lists and len(start) == len(end):
        return [between(a, b, fraction) for a, b in zip(start, end, strict=True)]
    if not (_is_number(start) and _is_number(end)):
        raise ConfigError(f"cannot go gradually from {start!r} to {end!r}")
    if fraction == 0.0:
        return start  # an integer stays one
    # Exact at the other end too, unlike start + fraction * (end - start).
    return (1.0 - fraction) * start + fraction * end


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def progress(step: int, start: int, end: int, gradual: bool) -> float:
    """Return the progress of a change at a control step: 0 to 1, in `_STAGES` stages.

    Args:
        step: The current control step.
        start: The step at which a gradual change begins.
        end: The step at which the change is complete.
        gradual: Whether the change is gradual; otherwise progress is 0 or 1.
    """
    if step >= end:
        return 1.0
    if not gradual or step <= start:
        return 0.0
    return (step - start) * _STAGES // (end - start) / _STAGES


Steps = Annotated[int, Field(ge=0)]
Section = Literal["commands", "events", "observations", "rewards", "terminations", "metrics"]


@register_term("curriculum", name="modify_reward_weight")
class ModifyRewardWeight(Term):
    """Changes the weight of a reward, at once or gradually. Isaac Lab's term of the same name.

    Its value is the weight in force.

    Example:
        ``{func: modify_reward_weight, params: {term_name: effort, weight: -0.1, num_steps: 9000}}``

    Args:
        term_name: The reward.
        weight: The new weight.
        num_steps: Control steps until the change is complete; a reset after them applies it.
        interpolate: Whether the weight changes linearly.
        start_step: Control steps before a gradual change begins.
    """

    whole_batch = ""  # it depends on the number of control steps alone

    def __init__(
        self,
        env: TermContext,
        term_name: str,
        weight: Finite,
        num_steps: Steps,
        interpolate: bool = False,
        start_step: Steps = 0,
    ) -> None:
        self._name = term_name
        self._rewards = env.reward_manager
        self._first_weight = self._rewards.weights[term_name]
        self._last_weight = weight
        self._start_step = start_step
        self._end_step = num_steps
        self._is_gradual = interpolate

    @classmethod
    def check_task(cls, task: EnvCfg, params: Mapping[str, Any], allow_import: bool) -> Any:
        """Return mistakes that depend on the whole task."""
        problems = check_weight("weight", params["weight"])
        return problems + _check_name("rewards", task, params) + _check_times(params)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> float:
        """Set the weight for the current control step."""
        share = progress(env.control_step, self._start_step, self._end_step, self._is_gradual)
        if share > 0.0:
            weight = between(self._first_weight, self._last_weight, share)
            env.reward_manager.set_weight(self._name, weight)
        return env.reward_manager.weights[self._name]

    def stage_dict(self) -> dict[str, Any]:
        """The weight in force."""
        return {"weight": self._rewards.weights[self._name]}

    def load_stage_dict(self, stage: Mapping[str, Any]) -> None:
        """Set the weight."""
        self._rewards.set_weight(self._name, stage["weight"])


@register_term("curriculum", name="modify_term_param")
class ModifyTermParam(Term):
    """Changes a parameter of a term, at once or gradually.

    Isaac Lab's ``modify_term_cfg``, without code. Its value is the parameter if that is a number,
    else the progress of the change.

    Example:
        ``{func: modify_term_param, params: {section: commands, term_name: velocity, param: ranges.lin_vel_x, value: [-2, 2], num_steps: 9000}}``

    Args:
        section: The section of the task with the term.
        term_name: The term.
        param: The parameter; dots pick a part of it, as in ``position_range.1.2``. ``shape.tanh``
            is a parameter of a shape, ``shape.0.tanh`` of one in a list.
        value: The new value.
        num_steps: Control steps until the change is complete; a reset after them applies it.
        interpolate: Whether the value changes linearly, number by number.
        start_step: Control steps before a gradual change begins.
    """  # noqa: E501  (an example is one line)

    whole_batch = ""  # likewise

    def __init__(
        self,
        env: TermContext,
        section: Section,
        term_name: str,
        param: str,
        value: Any,
        num_steps: Steps,
        interpolate: bool = False,
        start_step: Steps = 0,
    ) -> None:
        self._manager = env.managers[section]
        self._name = term_name
        self._path = param.split(".")
        self._start_step = start_step
        self._end_step = num_steps
        self._is_gradual = interpolate
        self._first_value = self._current_value()
        self._last_value = value
        self._share = 0.0

    @classmethod
    def check_task(cls, task: EnvCfg, params: Mapping[str, Any], allow_import: bool) -> Any:
        """Return mistakes that depend on the whole task: term, parameter, type of the value."""
        section = params["section"]
        problems = _check_name(section, task, params)
        if problems:
            return problems
        term = getattr(task, section)[params["term_name"]]
        try:
            spec = resolve_term(SECTIONS[section], term.func, allow_import=allow_import)
        except ConfigError:
            return []  # reported at the term
        path = params["param"].split(".")
        values = _values(spec, term)
        try:
            first_value = get_at(values, path)
        except ConfigError as error:
            return [Problem("param", p.message, p.hint) for p in error.problems]
        try:
            if params.get("interpolate"):
                between(first_value, params["value"], 0.5)
        except ConfigError as error:
            return [Problem("value", p.message) for p in error.problems]
        changed_values = with_value(values, path, params["value"])
        new_problems, new_shapes = _check_values(spec, changed_values)
        old_problems, old_shapes = _check_values(spec, values)
        if not new_problems and new_shapes != old_shapes:
            message = "the shapes of a term stay the same: name a parameter of one, as shape.tanh"
            return [Problem("param", message)]
        # Mistakes that the term has without the change are reported at the term.
        old_paths = {p.path for p in old_problems}
        problems = [
            Problem("value", f"{p.path[1:]}: {p.message}", p.hint)
            for p in new_problems
            if p.path not in old_paths
        ]
        return problems + _check_times(params)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> float:
        """Set the value for the current control step."""
        share = progress(env.control_step, self._start_step, self._end_step, self._is_gradual)
        value = self._last_value
        if 0.0 < share < 1.0:
            value = between(self._first_value, self._last_value, share)
        if share != self._share:
            self._set_value(value)
            self._share = share
        if not _is_number(self._first_value):
            return share
        return float(value if share > 0.0 else self._first_value)

    def _current_value(self) -> Any:
        """The value in force."""
        term = self._manager.terms[self._name]
        return get_at(_values(term.spec, term.cfg), self._path)

    def _set_value(self, value: Any) -> None:
        """Rebuild the term with another value."""
        term = self._manager.terms[self._name]
        values = with_value(_values(term.spec, term.cfg), self._path, value)
        params, shape = _split_values(term.spec, values)
        self._manager.set_params(self._name, params, shape)

    def stage_dict(self) -> dict[str, Any]:
        """The progress of the change, and the value in force."""
        return {"share": self._share, "value": self._current_value()}

    def load_stage_dict(self, stage: Mapping[str, Any]) -> None:
        """Set the value; one that was not changed yet stays what the task says."""
        if stage["share"] > 0.0:
            self._set_value(stage["value"])
            self._share = stage["share"]

    def state_dict(self) -> dict[str, Any]:
        """The progress of the change; the manager has the values."""
        return {"share": self._share}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._share = state["share"]


def _values(spec: TermSpec, cfg: TermCfg) -> dict[str, Any]:
    """The parameters of a term, defaults included, and its ``shape``."""
    values: dict[str, Any] = {}
    shape = getattr(cfg, "shape", None)
    if shape is not None:
        values["shape"] = shape
    set_names = spec.written(cfg.params).values()
    for name, parameter in spec.params.items():
        if parameter.default is not inspect.Parameter.empty and name not in set_names:
            values[name] = parameter.default
    return {**values, **copy.deepcopy(cfg.params)}


def _split_values(spec: TermSpec, values: Mapping[str, Any]) -> tuple[dict[str, Any], Any]:
    """Split the result of `_values` into parameters and shape."""
    params = dict(values)
    if "shape" in spec.params:  # then it is a parameter of the term's own
        return params, None
    shape = params.pop("shape", None)
    return params, shape


def _check_values(spec: TermSpec, values: Mapping[str, Any]) -> tuple[list[Problem], list[str]]:
    """Every mistake in parameters and shapes, and the shapes' names."""
    params, shape = _split_values(spec, values)
    shapes, shape_problems = check_term_shape(shape, ".shape")
    _, problems = check_params(spec, params, "")
    return problems + shape_problems, [shape_spec.name for shape_spec, _ in shapes]


def _check_name(section: str, task: EnvCfg, params: Mapping[str, Any]) -> list[Problem]:
    """Return a mistake if the section has no such term."""
    terms = getattr(task, section)
    name = params["term_name"]
    if name in terms:
        return []
    message = f"there is no {name!r} in {section}; there are: {', '.join(terms) or 'none'}"
    return [Problem("term_name", message, did_you_mean(name, terms).strip())]


def _check_times(params: Mapping[str, Any]) -> list[Problem]:
    """Return a mistake if the change cannot begin at its first step."""
    start = params.get("start_step", 0)
    end = params["num_steps"]
    is_gradual = params.get("interpolate")
    if start and not is_gradual:
        return [Problem("start_step", "has a meaning with interpolate: true only")]
    if is_gradual and start >= end:
        return [Problem("start_step", f"must be before num_steps, {end}")]
    return []
