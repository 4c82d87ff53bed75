"""The steps of an expert: one class for each, which says what motions it is made of.

A step is a map with one key, its name: ``{grasp: {of: cube, speed: 0.5}}``. ``{grasp: cube}`` sets
its first parameter, and ``release`` alone has none. `read_steps` makes them from plain values.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field

from embodichain.lab.gym.expert.instructions import (
    Goal,
    Grip,
    Instruction,
    Move,
    Phase,
    Target,
    Vector,
    Wait,
)
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean
from embodichain.utils.type_errors import from_dict, show_value

__all__ = ["STEPS", "Step", "read_steps"]

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(gt=0, le=1)]
Axes = Literal["world", "target", "tool"]
Turns = Annotated[int, Field(ge=1)]
_ZERO: Vector = (0.0, 0.0, 0.0)
_NEAR = 0.004
"""M: how near the tool must be to a place where it grasps, releases or presses."""
_PASS = 0.03
"""M: how near it must be to a place that it passes."""


@dataclass(frozen=True, kw_only=True)
class Step:
    """One step. Lengths are in metres, a speed is a share of the largest one.

    Parameters that several steps have: `offset` from the target to the tool, in `axes`; `approach`
    and `retreat`, lengths along the tool's z axis, which points out of a gripper, from where it
    comes and to where it goes back; `rpy`, an orientation in `axes`: roll, pitch, yaw about fixed
    axes in rad; `align`, a target to which the tool (or what is held) is turned about the vertical,
    until axes are parallel; `symmetry`, the directions in a full turn that are as good.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(
        extra="forbid", arbitrary_types_allowed=True
    )
    first: ClassVar[str] = ""  # the parameter that a plain value sets
    targets: ClassVar[tuple[str, ...]] = ()  # the parameters that are targets
    grips: ClassVar[bool] = False  # whether it needs a gripper

    arm: str | None = None  # its action term or robot; may be left out if there is only one
    speed: Share = 1.0

    def phases(self, step: str) -> Iterator[Phase]:
        """What it is made of; `step` names it in messages."""
        yield {self.arm or "": list(self._instructions(step))}

    def _instructions(self, step: str) -> Iterator[Instruction]:
        raise NotImplementedError

    def arms(self) -> Iterator[tuple[str, str]]:
        """Parameter and name of the arms that it names."""
        if self.arm is not None:
            yield "arm", self.arm

    def _goal(self, target: Target | None, **values: Any) -> Goal:
        """A goal with the parameters of the same names."""
        own = {f.name for f in dataclasses.fields(self)}
        same = {n: getattr(self, n) for n in ("offset", "axes", "symmetry", "rpy") if n in own}
        return Goal(target, **(same | values))

    def _move(self, goal: Goal, step: str, near: float | None = _PASS, share: float = 1.0) -> Move:
        """A motion at a share of the speed of the step."""
        return Move(goal, self.speed * share, near, step)

    def _retreating(self, step: str, distance: float) -> Iterator[Instruction]:
        """A motion back along the tool's z axis, unless the distance is 0."""
        if distance:
            yield self._move(Goal(back=distance), step)


@dataclass(frozen=True, kw_only=True)
class MoveTo(Step):
    """One straight line to a target; without one, from where the tool is."""

    first: ClassVar[str] = "to"
    targets: ClassVar[tuple[str, ...]] = ("to", "align")

    to: Target | None = None
    offset: Vector = _ZERO
    axes: Axes = "world"
    align: Target | None = None
    symmetry: Turns = 4
    rpy: Vector | None = None
    held: bool = False  # whether what is held is moved there, instead of the tool
    tolerance: Positive | None = 0.01  # fails farther away; below 0.02 the tool comes to rest

    def _instructions(self, step: str) -> Iterator[Instruction]:
        goal = self._goal(self.to, align=self.align, level=True, held=self.held)
        yield self._move(goal, step, self.tolerance)


@dataclass(frozen=True, kw_only=True)
class Grasp(Step):
    """Moves before the target, then to it, closes the gripper, checks that it holds something.

    A tool that points up or down is turned about the vertical, so that its fingers are parallel to
    faces of the target, unless `align` is false.
    """

    first: ClassVar[str] = "of"
    targets: ClassVar[tuple[str, ...]] = ("of",)
    grips: ClassVar[bool] = True

    of: Target
    offset: Vector = _ZERO
    axes: Axes = "world"
    approach: NonNegative = 0.1
    align: bool = True
    symmetry: Turns = 4
    rpy: Vector | None = None

    def _instructions(self, step: str) -> Iterator[Instruction]:
        align = self.of if self.align and self.rpy is None else None
        if self.approach:
            yield self._move(self._goal(self.of, align=align, back=self.approach), step)
        yield self._move(self._goal(self.of, align=align), step, _NEAR)
        yield Grip(False, self.of, step)


@dataclass(frozen=True, kw_only=True)
class Release(Step):
    """Opens the gripper, then moves back."""

    first: ClassVar[str] = "retreat"
    grips: ClassVar[bool] = True

    retreat: NonNegative = 0.0

    def _instructions(self, step: str) -> Iterator[Instruction]:
        yield Grip(True, None, step)
        yield from self._retreating(step, self.retreat)


@dataclass(frozen=True, kw_only=True)
class Close(Step):
    """Closes the gripper on nothing, as for pressing."""

    grips: ClassVar[bool] = True

    def _instructions(self, step: str) -> Iterator[Instruction]:
        yield Grip(False, None, step)


@dataclass(frozen=True, kw_only=True)
class Lift(Step):
    """Moves the tool up."""

    first: ClassVar[str] = "by"

    by: Positive = 0.1

    def _instructions(self, step: str) -> Iterator[Instruction]:
        yield self._move(Goal(offset=(0.0, 0.0, self.by)), step)


@dataclass(frozen=True, kw_only=True)
class Place(Step):
    """Moves what is held above the target, lowers it, opens the gripper and moves back."""

    first: ClassVar[str] = "to"
    targets: ClassVar[tuple[str, ...]] = ("to", "align")
    grips: ClassVar[bool] = True

    to: Target
    offset: Vector = _ZERO
    axes: Axes = "world"
    above: NonNegative = 0.08
    align: Target | None = None
    symmetry: Turns = 4
    retreat: NonNegative = 0.08
    lowering: Share = 0.5  # its speed

    def _instructions(self, step: str) -> Iterator[Instruction]:
        goal = self._goal(self.to, align=self.align, level=True, held=True)
        if self.above:
            yield self._move(dataclasses.replace(goal, above=self.above), step)
        yield self._move(goal, step, _NEAR, self.lowering)
        yield Grip(True, None, step)
        yield from self._retreating(step, self.retreat)


@dataclass(frozen=True, kw_only=True)
class Push(Step):
    """Lowers the tool behind an object and moves it straight on, until the object is at a target.

    The tool is `behind` the object's origin when it touches it, and `height` above it.
    """

    first: ClassVar[str] = "of"
    targets: ClassVar[tuple[str, ...]] = ("of", "to")

    of: Target
    to: Target
    behind: NonNegative = 0.05
    clearance: NonNegative = 0.05  # farther behind, where it is lowered
    height: float = 0.0
    above: NonNegative = 0.1

    def _instructions(self, step: str) -> Iterator[Instruction]:
        offset = (0.0, 0.0, self.height)
        start = Goal(self.of, offset, beyond=self.behind + self.clearance, start=self.to)
        yield self._move(dataclasses.replace(start, above=self.above), step)
        yield self._move(start, step)
        yield self._move(Goal(self.to, offset, beyond=-self.behind, start=self.of), step)
        yield self._move(Goal(above=self.above), step)


@dataclass(frozen=True, kw_only=True)
class Open(Grasp):
    """Grasps a handle, as `grasp` does, and moves it along a straight line."""

    by: Vector
    pull: Share = 0.5  # its speed

    def _instructions(self, step: str) -> Iterator[Instruction]:
        yield from super()._instructions(step)
        axes: Axes = "tool" if self.axes == "tool" else "world"
        yield self._move(Goal(offset=self.by, axes=axes), step, _PASS, self.pull)


@dataclass(frozen=True, kw_only=True)
class Press(Step):
    """Moves before the target, presses it by `depth` along the tool's z axis, and moves back."""

    first: ClassVar[str] = "of"
    targets: ClassVar[tuple[str, ...]] = ("of",)

    of: Target
    offset: Vector = _ZERO
    axes: Axes = "world"
    depth: Positive = 0.01
    approach: NonNegative = 0.05
    pressing: Share = 0.3  # its speed

    def _instructions(self, step: str) -> Iterator[Instruction]:
        yield self._move(self._goal(self.of, back=self.approach), step, 2 * _NEAR)
        yield self._move(self._goal(self.of, back=-self.depth), step, None, self.pressing)
        yield Wait(0.3, step)
        yield from self._retreating(step, self.approach + self.depth)


@dataclass(frozen=True, kw_only=True)
class HandOver(Grasp):
    """Carries what `arm` holds to a place, where another arm grasps it; then the first lets go."""

    to: str  # the arm that takes it
    at: Vector | None = None  # where its origin is then; None is where it is
    retreat: NonNegative = 0.1

    def phases(self, step: str) -> Iterator[Phase]:
        """A motion of the first arm, `grasp` of the other, `release` of the first."""
        giver = self.arm or ""
        if self.at is not None:
            yield {giver: [self._move(Goal("world", self.at, held=True), step)]}
        yield {self.to: list(self._instructions(step))}
        yield {giver: list(Release(retreat=self.retreat, speed=self.speed)._instructions(step))}

    def arms(self) -> Iterator[tuple[str, str]]:
        """Both."""
        yield from super().arms()
        yield "to", self.to


@dataclass(frozen=True, kw_only=True)
class Waiting(Step):
    """Waits."""

    first: ClassVar[str] = "seconds"

    seconds: Positive

    def _instructions(self, step: str) -> Iterator[Instruction]:
        yield Wait(self.seconds, step)


@dataclass(frozen=True, kw_only=True)
class Repeat(Step):
    """Performs steps several times."""

    first: ClassVar[str] = "steps"

    times: Annotated[int, Field(ge=1, le=1000)]
    steps: list[Any]

    def phases(self, step: str) -> Iterator[Phase]:
        """Those of the steps, again and again."""
        for _ in range(self.times):
            for one in self.steps:
                yield from one.phases()


@dataclass(frozen=True, kw_only=True)
class Together(Step):
    """Several arms perform steps at the same time: {ARM: steps, ARM: steps}."""

    first: ClassVar[str] = "steps"

    steps: dict[str, list[Any]]

    def phases(self, step: str) -> Iterator[Phase]:
        """One, in which each arm performs its steps."""
        lanes: Phase = {}
        for arm, steps in self.steps.items():
            parts = [part for one in steps for phase in one.phases() for part in phase.values()]
            lanes[arm] = [instruction for part in parts for instruction in part]
        yield lanes

    def arms(self) -> Iterator[tuple[str, str]]:
        """Those of the lanes."""
        yield from ((arm, arm) for arm in self.steps)


STEPS: dict[str, type[Step]] = {
    "move_to": MoveTo,
    "grasp": Grasp,
    "release": Release,
    "close": Close,
    "lift": Lift,
    "place": Place,
    "push": Push,
    "open": Open,
    "press": Press,
    "hand_over": HandOver,
    "wait": Waiting,
    "repeat": Repeat,
    "together": Together,
}
"""Name in a task file -> step."""


@dataclass(frozen=True)
class ReadStep:
    """A step as it was read.

    Attributes:
        path: Its key path, down to its name.
        label: Its name in messages: ``step 2, grasp cube``.
        step: The step.
        arm: The arm of the lane of `together` that it is in, or None.
    """

    path: str
    label: str
    step: Step
    arm: str | None = None

    def phases(self) -> Iterator[Phase]:
        """What the step is made of."""
        yield from self.step.phases(self.label)

    def summary(self) -> str:
        """Its instructions in words: ``move, move, close``."""
        words = []
        for phase in self.phases():
            for one in (one for lane in phase.values() for one in lane):
                grip = "open" if isinstance(one, Grip) and one.opens else "close"
                words.append(grip if isinstance(one, Grip) else type(one).__name__.lower())
        return ", ".join(words)

    def flat(self) -> Iterator[ReadStep]:
        """This step and those within it."""
        yield self
        inside = getattr(self.step, "steps", ())
        for steps in inside.values() if isinstance(inside, dict) else [inside]:
            for one in steps:
                yield from one.flat()


def read_steps(
    values: Sequence[Any], path: str = "expert", number: str = "", arm: str | None = None
) -> tuple[list[ReadStep], list[Problem]]:
    """Read steps from plain values.

    Args:
        values: As in a task file.
        path: Key path of the list.
        number: Number of the step around them, for messages.
        arm: The arm of the lane that they are in.

    Returns:
        The steps that could be read, and every mistake.
    """
    found: list[ReadStep] = []
    problems: list[Problem] = []
    for i, value in enumerate(values):
        try:
            found.append(_read(value, f"{path}.{i}", f"{number}{i + 1}", arm))
        except ConfigError as error:
            problems += error.problems
    return found, problems


def _read(value: Any, path: str, number: str, arm: str | None) -> ReadStep:
    """One step.

    Raises:
        ConfigError: If something in it is wrong.
    """
    if isinstance(value, str):
        value = {value: None}
    if not isinstance(value, Mapping) or len(value) != 1:
        names = ", ".join(map(str, value)) if isinstance(value, Mapping) else show_value(value)
        message = f"a step is a map with one key, its name, got {names}; steps: {', '.join(STEPS)}"
        raise ConfigError([Problem(path, message)])
    name, given = next(iter(value.items()))
    cls = STEPS.get(str(name))
    where = f"{path}.{name}"
    if cls is None:
        message = f"unknown step {str(name)!r}; allowed: {', '.join(STEPS)}."
        raise ConfigError([Problem(where, message, did_you_mean(str(name), STEPS).strip())])
    params = _params(cls, given, where)
    try:
        step: Step = from_dict(cls, params)
    except ConfigError as error:
        raise ConfigError([p.below(where) for p in error.problems]) from error
    if arm is not None:
        if step.arm is not None and step.arm != arm:
            message = f"contradicts {arm!r}, whose steps these are; leave it out"
            raise ConfigError([Problem(f"{where}.arm", message)])
        step = dataclasses.replace(step, arm=arm)
    return ReadStep(
        where, _label(number, str(name), params, cls), _filled(step, where, number), arm
    )


def _params(cls: type[Step], given: Any, path: str) -> dict[str, Any]:
    if cls is Together:
        return {"steps": given}
    if given is None:
        return {}
    if isinstance(given, Mapping):
        return {str(key): value for key, value in given.items()}
    if not cls.first:
        raise ConfigError([Problem(path, f"takes no plain value, got {show_value(given)}")])
    return {cls.first: given}


def _label(number: str, name: str, params: Mapping[str, Any], cls: type[Step]) -> str:
    main = params.get(cls.first)
    return f"step {number}, {name} {main}" if isinstance(main, str) else f"step {number}, {name}"


def _filled(step: Step, path: str, number: str) -> Step:
    """A step with the steps in it read."""
    if not isinstance(step, (Repeat, Together)):
        return step
    if isinstance(step, Repeat):
        steps, problems = read_steps(step.steps, f"{path}.steps", f"{number}.", step.arm)
        filled: Step = dataclasses.replace(step, steps=steps)
    else:
        lanes, problems = {}, []
        for lane, values in step.steps.items():
            lanes[lane], found = read_steps(values, f"{path}.{lane}", f"{number}.", lane)
            problems += found
            for one in (inner for read in lanes[lane] for inner in read.flat()):
                if isinstance(one.step, (Together, HandOver)):
                    message = "it needs several arms: it cannot be among the steps of one"
                    problems.append(Problem(one.path, message))
        filled = dataclasses.replace(step, steps=lanes)
    if problems:
        raise ConfigError(problems)
    return filled
