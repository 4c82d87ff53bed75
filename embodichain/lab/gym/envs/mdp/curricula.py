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
from embodichain.lab.gym.envs.managers.terms.check import check_params, check_shape, check_weight
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
            where = ".".join(path[:depth]) or "the parameters"
            known = ", ".join(keys) or "nothing"
            raise ConfigError(
                f"there is no {part!r} in {where}; there is: {known}.{did_you_mean(part, keys)}"
            )
        tree = tree[part] if isinstance(tree, dict) else tree[int(part)]
    return tree


def _keys(tree: Any) -> list[str]:
    if isinstance(tree, dict):
        return [str(key) for key in tree]
    return [str(i) for i in range(len(tree))] if isinstance(tree, (list, tuple)) else []


def with_value(tree: Any, path: Sequence[str], value: Any) -> Any:
    """Return a copy of nested lists and maps with another value at an existing path."""
    if not path:
        return value
    part, rest = path[0], path[1:]
    if isinstance(tree, dict):
        return {**tree, part: with_value(tree.get(part), rest, value)}
    return [with_value(v, rest, value) if str(i) == part else v for i, v in enumerate(tree)]


def between(start: Any, end: Any, fraction: float) -> Any:
    """Return the linear interpolation of two values, number by number in lists and maps.

    Raises:
        ConfigError: If the two are not numbers, or lists or maps of the same form.
    """
    if isinstance(start, dict) and isinstance(end, dict) and start.keys() == end.keys():
        return {key: between(start[key], end[key], fraction) for key in start}
    lists = isinstance(start, (list, tuple)) and isinstance(end, (list, tuple))
    if lists and len(start) == len(end):
        return [between(a, b, fraction) for a, b in zip(start, end, strict=True)]
    if any(isinstance(v, bool) or not isinstance(v, (int, float)) for v in (start, end)):
        raise ConfigError(f"cannot go gradually from {start!r} to {end!r}")
    # Exact at both ends.
    return start if fraction == 0.0 else (1.0 - fraction) * start + fraction * end


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
        self._name, self._weight = term_name, weight
        self._rewards = env.reward_manager
        self._first = self._rewards.weights[term_name]
        self._when = start_step, num_steps, interpolate

    @classmethod
    def check_task(cls, task: EnvCfg, params: Mapping[str, Any], allow_import: bool) -> Any:
        """Return mistakes that depend on the whole task."""
        wrong = check_weight("weight", params["weight"])
        return wrong + _check_name("rewards", task, params) + _check_times(params)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> float:
        """Set the weight for the current control step."""
        share = progress(env.control_step, *self._when)
        if share > 0.0:
            env.reward_manager.set_weight(self._name, between(self._first, self._weight, share))
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
        self._name, self._value = term_name, value
        self._path = param.split(".")
        self._when = start_step, num_steps, interpolate
        term = self._manager.terms[term_name]
        self._first = get_at(_values(term.spec, term.cfg), self._path)
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
        now = _values(spec, term)
        try:
            first = get_at(now, path)
        except ConfigError as error:
            return [Problem("param", p.message, p.hint) for p in error.problems]
        try:
            if params.get("interpolate"):
                between(first, params["value"], 0.5)
        except ConfigError as error:
            return [Problem("value", p.message) for p in error.problems]
        found, shapes = _check_values(spec, with_value(now, path, params["value"]))
        before, shapes_before = _check_values(spec, now)
        if not found and shapes != shapes_before:
            message = "the shapes of a term stay the same: name a parameter of one, as shape.tanh"
            return [Problem("param", message)]
        known = {p.path for p in before}
        wrong = [p for p in found if p.path not in known]
        problems = [Problem("value", f"{p.path[1:]}: {p.message}", p.hint) for p in wrong]
        return problems + _check_times(params)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> float:
        """Set the value for the current control step."""
        share = progress(env.control_step, *self._when)
        value = between(self._first, self._value, share) if 0.0 < share < 1.0 else self._value
        if share != self._share:
            self._set(value)
            self._share = share
        number = isinstance(self._first, (int, float)) and not isinstance(self._first, bool)
        if not number:
            return share
        return float(value if share > 0.0 else self._first)

    def _set(self, value: Any) -> None:
        term = self._manager.terms[self._name]
        values = with_value(_values(term.spec, term.cfg), self._path, value)
        self._manager.set_params(self._name, *_divided(term.spec, values))

    def stage_dict(self) -> dict[str, Any]:
        """The progress of the change, and the value in force."""
        term = self._manager.terms[self._name]
        return {"share": self._share, "value": get_at(_values(term.spec, term.cfg), self._path)}

    def load_stage_dict(self, stage: Mapping[str, Any]) -> None:
        """Set the value; one that was not changed yet stays what the task says."""
        if stage["share"] > 0.0:
            self._set(stage["value"])
            self._share = stage["share"]

    def state_dict(self) -> dict[str, Any]:
        """The progress of the change; the manager has the values."""
        return {"share": self._share}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._share = state["share"]


def _values(spec: TermSpec, cfg: TermCfg) -> dict[str, Any]:
    """The parameters of a term, defaults included, and its ``shape``."""
    empty = inspect.Parameter.empty
    written = spec.written(cfg.params).values()
    defaults = {
        name: parameter.default
        for name, parameter in spec.params.items()
        if parameter.default is not empty and name not in written
    }
    shape = getattr(cfg, "shape", None)
    return {**({} if shape is None else {"shape": shape}), **defaults, **copy.deepcopy(cfg.params)}


def _divided(spec: TermSpec, values: Mapping[str, Any]) -> tuple[dict[str, Any], Any]:
    """Split the result of `_values` into parameters and shape."""
    params = dict(values)
    return params, params.pop("shape", None) if "shape" not in spec.params else None


def _check_values(spec: TermSpec, values: Mapping[str, Any]) -> tuple[list[Problem], list[str]]:
    """Every mistake in parameters and shapes, and the shapes' names."""
    params, shape = _divided(spec, values)
    steps, problems = check_shape(shape, ".shape")
    return check_params(spec, params, "")[1] + problems, [step.name for step, _ in steps]


def _check_name(section: str, task: EnvCfg, params: Mapping[str, Any]) -> list[Problem]:
    terms, name = getattr(task, section), params["term_name"]
    if name in terms:
        return []
    message = f"there is no {name!r} in {section}; there are: {', '.join(terms) or 'none'}"
    return [Problem("term_name", message, did_you_mean(name, terms).strip())]


def _check_times(params: Mapping[str, Any]) -> list[Problem]:
    start, end = params.get("start_step", 0), params["num_steps"]
    if not params.get("interpolate"):
        if start:
            return [Problem("start_step", "has a meaning with interpolate: true only")]
        return []
    return [] if start < end else [Problem("start_step", f"must be before num_steps, {end}")]
