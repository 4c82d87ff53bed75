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
from embodichain.lab.gym.expert.instructions import Grip, Phase, Target
from embodichain.lab.gym.expert.step_register import COMPOSITES, STEPS, Aim, Arm, Maker
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.fields.type_errors import show_value
from embodichain.utils.suggest import did_you_mean

__all__ = ["ReadStep", "read_steps"]

_NAMING = ("to", "of", "align")
"""Parameters whose value tells steps of one kind apart in messages; the first that is set does."""


@dataclass(frozen=True)
class ReadStep:
    """A step.

    Attributes:
        path: Its key path, down to its name.
        phases: What it is made of.
        targets: Key path and target of all that it refers to.
        arms: Its arms by parameter; "" is the only arm.
        within: Steps in it.
        lane: The arm of the lane of `together` that it is in, or None.
    """

    path: str
    phases: list[Phase]
    targets: list[tuple[str, Target]]
    arms: Mapping[str, str]
    within: Sequence[ReadStep] = ()
    lane: str | None = None

    @property
    def grips(self) -> bool:
        """Whether it needs a gripper."""
        lanes = (lane for phase in self.phases for lane in phase.values())
        return not self.within and any(isinstance(one, Grip) for lane in lanes for one in lane)

    def flat(self) -> Iterator[ReadStep]:
        """This step and those within it."""
        yield self
        for one in self.within:
            yield from one.flat()


def read_steps(
    values: Sequence[Any], path: str = "expert", number: str = "", lane: str | None = None
) -> tuple[list[ReadStep], list[Problem]]:
    """Read steps from plain values.

    Args:
        values: As in a task file.
        path: Key path of the list.
        number: Number of the step around them, for messages.
        lane: The arm of the lane that they are in.

    Returns:
        The steps that could be read, and every mistake.
    """
    found: list[ReadStep] = []
    problems: list[Problem] = []
    for i, value in enumerate(values):
        try:
            found.append(_read(value, f"{path}.{i}", f"{number}{i + 1}", lane))
        except ConfigError as error:
            problems += error.problems
    return found, problems


def _read(value: Any, path: str, number: str, lane: str | None) -> ReadStep:
    """One step.

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
    name, given = next(iter(value.items()))
    path = f"{path}.{name}"
    if name == "repeat":
        return _repeated(given, path, number, lane)
    if name == "together":
        return _together(given, path, number, lane)
    if name not in STEPS:
        raise ConfigError([_unknown_step(str(name), path)])
    spec = _described(name)
    params = _params(given, next(iter(spec.params), ""), path)
    common: dict[str, Any] = {key: params.pop(key) for key in ("arm", "speed") if key in params}
    values, problems = check_params(spec, params, path)
    shared, found = check_params(_shared(), common, path)
    if problems or found:
        raise ConfigError([*problems, *found])
    arm = shared.get("arm", lane or "")
    other_arms = {key: values[key] for key in _parameters_of_type(spec, Arm) if key in values}
    if lane is not None:
        contradiction = "arm" if arm != lane else next(iter(other_arms), None)
        if contradiction is not None:
            message = f"contradicts {lane!r}, whose steps these are"
            raise ConfigError([Problem(f"{path}.{contradiction}", message)])
    targets = [
        (f"{path}.{key}", values[key])
        for key in _parameters_of_type(spec, Aim)
        if values.get(key) is not None
    ]
    named = next((values[key] for key in _NAMING if isinstance(values.get(key), str)), "")
    maker = Maker(f"step {number}, {name} {named}".rstrip(), arm, shared.get("speed", 1.0))
    made = STEPS[name](maker, **spec.arguments(values))
    phases: list[Phase] = [{arm: list(part)} for arm, part in groupby(made, lambda one: one.arm)]
    return ReadStep(path, phases, targets, {"arm": arm} | other_arms, lane=lane)


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
def _described(name: str) -> TermSpec:
    return describe_term("step", STEPS[name], name)


@cache
def _shared() -> TermSpec:
    def every(make: Maker, arm: str = "", speed: Fraction = 1.0) -> None:
        """The parameters of all steps."""

    return describe_term("step", every)


def _params(given: Any, first: str, path: str) -> dict[str, Any]:
    if given is None:
        return {}
    if isinstance(given, Mapping):
        return {str(key): value for key, value in given.items()}
    if not first:
        raise ConfigError([Problem(path, f"takes no plain value, got {show_value(given)}")])
    return {first: given}


def _repeated(given: Any, path: str, number: str, lane: str | None) -> ReadStep:
    """``{times: 3, steps: [...]}``."""
    if not isinstance(given, Mapping) or set(given) != {"times", "steps"}:
        raise ConfigError([Problem(path, f"needs times and steps, got {show_value(given)}")])
    times = given["times"]
    if not isinstance(times, int) or isinstance(times, bool) or times < 1:
        message = f"must be an integer of at least 1, got {show_value(times)}"
        raise ConfigError([Problem(f"{path}.times", message)])
    steps = _inside(given["steps"], f"{path}.steps", number, lane)
    phases = [phase for one in steps for phase in one.phases]
    return ReadStep(path, times * phases, [], {}, steps, lane)


def _together(given: Any, path: str, number: str, lane: str | None) -> ReadStep:
    """``{ARM: steps, ARM: steps}``."""
    if not isinstance(given, Mapping) or not given:
        message = f"needs a map from arms to their steps, got {show_value(given)}"
        raise ConfigError([Problem(path, message)])
    if lane is not None:
        raise ConfigError([Problem(path, f"these are the steps of {lane!r} alone")])
    phase: Phase = {}
    within: list[ReadStep] = []
    for arm, values in given.items():
        steps = _inside(values, f"{path}.{arm}", number, str(arm))
        made = [lane for one in steps for part in one.phases for lane in part.values()]
        phase[str(arm)] = [instruction for part in made for instruction in part]
        within += steps
    return ReadStep(path, [phase], [], {str(arm): str(arm) for arm in given}, within)


def _inside(values: Any, path: str, number: str, lane: str | None) -> list[ReadStep]:
    if not isinstance(values, list) or not values:
        raise ConfigError([Problem(path, f"needs a list of steps, got {show_value(values)}")])
    steps, problems = read_steps(values, path, f"{number}.", lane)
    if problems:
        raise ConfigError(problems)
    return steps
