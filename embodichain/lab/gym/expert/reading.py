"""Reading steps from plain values: `read_steps`.

A step is a map with one key, its name: ``{grasp: {of: cube, speed: 0.5}}``. ``{grasp: cube}`` sets
its first parameter, and ``release`` alone has none. ``repeat`` performs steps several times,
``together`` those of several arms at the same time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import groupby
from typing import Any, get_args

from embodichain.lab.gym.envs.managers.param_types import Fraction
from embodichain.lab.gym.envs.managers.terms.check import check_params
from embodichain.lab.gym.envs.managers.terms.registry import TermSpec, describe_term
from embodichain.lab.gym.expert.instructions import Grip, Instruction, Phase, Target
from embodichain.lab.gym.expert.step_register import (
    COMPOSITES,
    STEPS,
    Arm,
    Maker,
    Symmetry,
    TargetParam,
)
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.fields.type_errors import show_value
from embodichain.utils.suggest import did_you_mean

__all__ = ["ParsedStep", "flat_steps", "read_steps"]

_SUBJECT_KEYS = ("to", "of", "align")
"""Parameters whose value tells steps of one kind apart in messages; the first that is set does."""


@dataclass(frozen=True)
class ParsedStep:
    """A step.

    Attributes:
        path: Its key path, down to its name.
        phases: What it is made of.
        targets: Key path and target of all that it refers to.
        arms: Its arms by parameter; "" is the only arm.
        inner_steps: The steps that it contains.
        lane: The arm of the lane of `together` that it is in, or None.
    """

    path: str
    phases: list[Phase]
    targets: list[tuple[str, Target]]
    arms: Mapping[str, str]
    inner_steps: Sequence[ParsedStep] = ()
    lane: str | None = None

    @property
    def grips(self) -> bool:
        """Whether it needs a gripper."""
        if self.inner_steps:  # then they do
            return False
        return any(isinstance(instruction, Grip) for instruction in self.instructions())

    def flat(self) -> Iterator[ParsedStep]:
        """This step and those within it."""
        yield self
        for step in self.inner_steps:
            yield from step.flat()

    def instructions(self) -> Iterator[Instruction]:
        """All that it is made of, phase by phase, arm by arm."""
        for phase in self.phases:
            for instructions in phase.values():
                yield from instructions


def flat_steps(steps: Sequence[ParsedStep]) -> Iterator[ParsedStep]:
    """These steps, each followed by those within it."""
    for step in steps:
        yield from step.flat()


def read_steps(
    values: Sequence[Any], path: str = "expert", number: str = "", lane: str | None = None
) -> tuple[list[ParsedStep], list[Problem]]:
    """Read steps from plain values.

    Args:
        values: As in a task file.
        path: Key path of the list.
        number: Number of the step around them, for messages.
        lane: The arm of the lane that they are in.

    Returns:
        The steps that could be read, and every mistake.
    """
    steps: list[ParsedStep] = []
    problems: list[Problem] = []
    for i, value in enumerate(values):
        try:
            steps.append(_read_step(value, f"{path}.{i}", f"{number}{i + 1}", lane))
        except ConfigError as error:
            problems += error.problems
    return steps, problems


def _read_step(value: Any, path: str, number: str, lane: str | None) -> ParsedStep:
    """Read one step, also one that contains others.

    Raises:
        ConfigError: If something in it is wrong.
    """
    if isinstance(value, str):
        value = {value: None}
    if not isinstance(value, Mapping) or len(value) != 1:
        names = ", ".join(map(str, value)) if isinstance(value, Mapping) else show_value(value)
        allowed = ", ".join([*STEPS, *COMPOSITES])
        message = f"a step is a map with one key, its name, got {names}; steps: {allowed}"
        raise ConfigError([Problem(path, message)])
    name, params = next(iter(value.items()))
    path = f"{path}.{name}"
    if name == "repeat":
        return _read_repeat(params, path, number, lane)
    if name == "together":
        return _read_together(params, path, number, lane)
    if name not in STEPS:
        raise ConfigError([_unknown_step(str(name), path)])
    return _read_plain_step(name, params, path, number, lane)


def _read_plain_step(name: str, value: Any, path: str, number: str, lane: str | None) -> ParsedStep:
    """Read a step that contains no others: check its parameters, and make its instructions."""
    spec = _describe(name)
    params = _named_params(value, next(iter(spec.params), ""), path)
    shared_params: dict[str, Any] = {
        key: params.pop(key) for key in ("arm", "speed") if key in params
    }
    values, problems = check_params(spec, params, path)
    problems += _check_turning(spec, values, path)
    shared, shared_problems = check_params(_shared_spec(), shared_params, path)
    if problems or shared_problems:
        raise ConfigError([*problems, *shared_problems])

    arm = shared.get("arm", lane or "")
    other_arms = {key: values[key] for key in _parameters_of_type(spec, Arm) if key in values}
    if lane is not None:
        _check_lane(lane, arm, other_arms, path)
    targets = [
        (f"{path}.{key}", values[key])
        for key in _parameters_of_type(spec, TargetParam)
        if values.get(key) is not None
    ]
    subject = next((values[key] for key in _SUBJECT_KEYS if isinstance(values.get(key), str)), "")
    maker = Maker(
        step=f"step {number}, {name} {subject}".rstrip(),
        arm=arm,
        speed=shared.get("speed", 1.0),
    )
    instructions = STEPS[name](maker, **spec.arguments(values))
    # A step that goes on with another arm waits for the first one: that is another phase.
    phases: list[Phase] = [
        {arm_name: list(group)}
        for arm_name, group in groupby(instructions, lambda instruction: instruction.arm)
    ]
    return ParsedStep(path, phases, targets, {"arm": arm} | other_arms, lane=lane)


def _check_turning(spec: TermSpec, values: Mapping[str, Any], path: str) -> list[Problem]:
    """Return the keys of a step that turn the tool in a way that another key replaces."""
    has_symmetry = "symmetry" in _parameters_of_type(spec, Symmetry)
    if not has_symmetry or "align" not in spec.params:
        return []
    has_orientation = values.get("rpy") is not None
    if has_orientation:
        message = "has no effect: rpy is the whole orientation; leave one of them out"
        return [
            Problem(f"{path}.{key}", message) for key in ("align", "symmetry") if values.get(key)
        ]
    align = values.get("align", spec.params["align"].default)
    if "symmetry" in values and not align:
        return [Problem(f"{path}.symmetry", "has no effect: nothing to align with is given")]
    return []


def _check_lane(lane: str, arm: str, other_arms: Mapping[str, str], path: str) -> None:
    """Refuse a step in the lane of one arm that names another."""
    contradiction = next(iter(other_arms), None)
    if arm != lane:
        contradiction = "arm"
    if contradiction is not None:
        message = f"contradicts {lane!r}, whose steps these are"
        raise ConfigError([Problem(f"{path}.{contradiction}", message)])


def _unknown_step(name: str, path: str) -> Problem:
    """Name the steps that exist, and the packages with steps that could not be loaded."""
    names = [*STEPS, *COMPOSITES]
    besides = "".join(f" Besides, {reason}." for reason in STEPS.broken)
    message = f"unknown step {name!r}; allowed: {', '.join(names)}.{besides}"
    return Problem(path, message, did_you_mean(name, names).strip())


def _parameters_of_type(spec: TermSpec, kind: Any) -> list[str]:
    """Names of the parameters annotated with a type, or with it or None, in order."""
    return [name for name, hint in spec.hints().items() if hint == kind or kind in get_args(hint)]


@cache
def _describe(name: str) -> TermSpec:
    """Describe the parameters that belong to one step."""
    return describe_term("step", STEPS[name], name)


@cache
def _shared_spec() -> TermSpec:
    """Describe the parameters that every step has."""

    def every(make: Maker, arm: str = "", speed: Fraction = 1.0) -> None:
        """The parameters of all steps."""

    return describe_term("step", every)


def _named_params(value: Any, first: str, path: str) -> dict[str, Any]:
    """Return parameters by name; a plain value is that of the first one."""
    if value is None:
        return {}
    if isinstance(value, Mapping):
        return {str(key): param for key, param in value.items()}
    if not first:
        raise ConfigError([Problem(path, f"takes no plain value, got {show_value(value)}")])
    return {first: value}


def _read_repeat(value: Any, path: str, number: str, lane: str | None) -> ParsedStep:
    """Read ``{times: 3, steps: [...]}``."""
    if not isinstance(value, Mapping) or set(value) != {"times", "steps"}:
        raise ConfigError([Problem(path, f"needs times and steps, got {show_value(value)}")])
    times = value["times"]
    if not isinstance(times, int) or isinstance(times, bool) or times < 1:
        message = f"must be an integer of at least 1, got {show_value(times)}"
        raise ConfigError([Problem(f"{path}.times", message)])
    steps = _read_inner_steps(value["steps"], f"{path}.steps", number, lane)
    phases: list[Phase] = []
    for step in steps:
        phases += step.phases
    return ParsedStep(path, times * phases, targets=[], arms={}, inner_steps=steps, lane=lane)


def _read_together(value: Any, path: str, number: str, lane: str | None) -> ParsedStep:
    """Read ``{ARM: steps, ARM: steps}``; each arm with its steps is a lane."""
    if not isinstance(value, Mapping) or not value:
        message = f"needs a map from arms to their steps, got {show_value(value)}"
        raise ConfigError([Problem(path, message)])
    if lane is not None:
        raise ConfigError([Problem(path, f"these are the steps of {lane!r} alone")])
    # One phase: arms do not wait for each other before all of their steps are done.
    phase: Phase = {}
    inner_steps: list[ParsedStep] = []
    for arm, values in value.items():
        steps = _read_inner_steps(values, f"{path}.{arm}", number, str(arm))
        instructions: list[Instruction] = []
        for step in steps:
            instructions += step.instructions()
        phase[str(arm)] = instructions
        inner_steps += steps
    arms = {str(arm): str(arm) for arm in value}
    return ParsedStep(path, [phase], targets=[], arms=arms, inner_steps=inner_steps)


def _read_inner_steps(values: Any, path: str, number: str, lane: str | None) -> list[ParsedStep]:
    """Read the steps of one that contains others."""
    if not isinstance(values, list) or not values:
        raise ConfigError([Problem(path, f"needs a list of steps, got {show_value(values)}")])
    steps, problems = read_steps(values, path, f"{number}.", lane)
    if problems:
        raise ConfigError(problems)
    return steps
