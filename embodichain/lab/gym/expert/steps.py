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


@dataclass(frozen=True, kw_only=True)
class Step:
    """One step; the parameters of all.

    Attributes:
        arm: The arm: its action term or its robot; it may be left out if there is only one.
        speed: Share of the largest speed.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(
        extra="forbid", arbitrary_types_allowed=True
    )
    first: ClassVar[str] = ""
    """The parameter that a plain value sets."""
    targets: ClassVar[tuple[str, ...]] = ()
    """Parameters that are a `Target`."""
    grips: ClassVar[bool] = False
    """Whether it needs a gripper."""

    arm: str | None = None
    speed: Share = 1.0

    def phases(self, step: str) -> Iterator[Phase]:
        """What it is made of; `step` names it in messages."""
        yield {self.arm or "": list(self.instructions(step))}

    def instructions(self, step: str) -> Iterator[Instruction]:
        """What its arm does."""
        raise NotImplementedError

    def arms(self) -> Iterator[tuple[str, str]]:
        """Parameter and name of the arms that it names."""
        if self.arm is not None:
            yield "arm", self.arm

    def goal(self, target: Target | None, **values: Any) -> Goal:
        """A goal with the parameters of the same names."""
        own = {f.name for f in dataclasses.fields(self)}
        same = {n: getattr(self, n) for n in ("offset", "axes", "symmetry", "rpy") if n in own}
        return Goal(target, **(same | values))

    def move(self, goal: Goal, step: str, tolerance: float | None = None) -> Move:
        """A motion at the speed of the step."""
        return Move(goal, self.speed, tolerance, step)


@dataclass(frozen=True, kw_only=True)
class MoveTo(Step):
    """Moves the tool to a target: one straight line.

    Args:
        to: The target; without one, relative to where the tool was sent last.
        offset: Metres from it.
        axes: Axes of `offset` and `rpy`.
        align: Turns the tool to this entity, as `grasp` does.
        symmetry: As of `grasp`.
        rpy: Orientation: roll, pitch, yaw in rad; else it is kept.
        held: Whether what the gripper holds is moved there, instead of the tool.
        tolerance: Metres; the step fails if the tool does not come that near. None goes on as soon
            as the tool was sent there.
    """

    first: ClassVar[str] = "to"
    targets: ClassVar[tuple[str, ...]] = ("to", "align")

    to: Target | None = None
    offset: Vector = _ZERO
    axes: Axes = "world"
    align: Target | None = None
    symmetry: Turns = 4
    rpy: Vector | None = None
    held: bool = False
    tolerance: Positive | None = 0.01

    def instructions(self, step: str) -> Iterator[Instruction]:
        """One motion."""
        goal = self.goal(self.to, align=self.align, level=True, held=self.held)
        yield self.move(goal, step, self.tolerance)


@dataclass(frozen=True, kw_only=True)
class Grasp(Step):
    """Moves behind the target, then to it, closes the gripper, checks that it holds something.

    Args:
        of: What is grasped.
        offset: Metres from its origin to the tool.
        axes: Axes of `offset` and `rpy`.
        approach: Metres along the tool's z axis from where the tool moves to the target.
        align: Whether a tool that points up or down is turned about the vertical, so that its
            fingers are parallel to faces of the target.
        symmetry: Directions in a full turn in which the target can be grasped: 4 for a cube, 2 for
            a bar, 1 for one direction only.
        rpy: Orientation, as of `move_to`.
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

    def instructions(self, step: str) -> Iterator[Instruction]:
        """Two motions and the fingers."""
        align = self.of if self.align and self.rpy is None else None
        if self.approach:
            yield self.move(self.goal(self.of, align=align, back=self.approach), step)
        yield self.move(self.goal(self.of, align=align), step, _NEAR)
        yield Grip(False, self.of, step)


@dataclass(frozen=True, kw_only=True)
class Release(Step):
    """Opens the gripper, then moves back.

    Args:
        retreat: Metres back along the tool's z axis.
    """

    first: ClassVar[str] = "retreat"
    grips: ClassVar[bool] = True

    retreat: NonNegative = 0.0

    def instructions(self, step: str) -> Iterator[Instruction]:
        """The fingers and perhaps a motion."""
        yield Grip(True, None, step)
        if self.retreat:
            yield self.move(Goal(back=self.retreat), step)


@dataclass(frozen=True, kw_only=True)
class Close(Step):
    """Closes the gripper on nothing, as for pressing."""

    grips: ClassVar[bool] = True

    def instructions(self, step: str) -> Iterator[Instruction]:
        """The fingers."""
        yield Grip(False, None, step)


@dataclass(frozen=True, kw_only=True)
class Lift(Step):
    """Moves the tool up.

    Args:
        by: Metres.
    """

    first: ClassVar[str] = "by"

    by: Positive = 0.1

    def instructions(self, step: str) -> Iterator[Instruction]:
        """One motion."""
        yield self.move(Goal(offset=(0.0, 0.0, self.by)), step)


@dataclass(frozen=True, kw_only=True)
class Place(Step):
    """Moves what is held above the target, lowers it, opens the gripper and moves back.

    Args:
        to: Where the origin of what is held goes.
        offset: Metres from it.
        axes: Axes of `offset`.
        above: Metres above from where it is lowered.
        align: Turns what is held about the vertical to this entity.
        symmetry: As of `grasp`.
        retreat: Metres back along the tool's z axis.
        lowering: Share of the largest speed while it is lowered.
    """

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
    lowering: Share = 0.5

    def instructions(self, step: str) -> Iterator[Instruction]:
        """Two motions, the fingers, and a motion."""
        x, y, z = self.offset
        if self.above and self.axes == "world":
            high = self.goal(self.to, align=self.align, level=True, held=True)
            high = dataclasses.replace(high, offset=(x, y, z + self.above))
            yield self.move(high, step, 5 * _NEAR)
        goal = self.goal(self.to, align=self.align, level=True, held=True)
        yield Move(goal, self.speed * self.lowering, _NEAR, step)
        yield Grip(True, None, step)
        if self.retreat:
            yield self.move(Goal(back=self.retreat), step)


@dataclass(frozen=True, kw_only=True)
class Push(Step):
    """Moves behind an object and pushes it straight over the table to a target.

    Args:
        of: The object.
        to: Where its origin is pushed.
        behind: Metres from its origin, away from the target, where the tool starts and ends.
        height: Metres of the tool above its origin.
        above: Metres above that from where the tool is lowered.
    """

    first: ClassVar[str] = "of"
    targets: ClassVar[tuple[str, ...]] = ("of", "to")

    of: Target
    to: Target
    behind: NonNegative = 0.05
    clearance: NonNegative = 0.05
    height: float = 0.0
    above: NonNegative = 0.1

    def instructions(self, step: str) -> Iterator[Instruction]:
        """Three motions and one up."""
        far = self.behind + self.clearance
        for height in ([self.above] if self.above else []) + [0.0]:
            offset = (0.0, 0.0, self.height + height)
            yield self.move(Goal(self.of, offset, beyond=far, start=self.to), step, 5 * _NEAR)
        offset = (0.0, 0.0, self.height)
        end = Goal(self.to, offset, beyond=-self.behind, start=self.of)
        yield self.move(end, step, 5 * _NEAR)
        if self.above:
            yield self.move(Goal(offset=(0.0, 0.0, self.above)), step)


@dataclass(frozen=True, kw_only=True)
class Open(Grasp):
    """Grasps a handle and moves it along a straight line.

    Args:
        by: Metres.
    """

    by: Vector
    pull: Share = 0.5

    def instructions(self, step: str) -> Iterator[Instruction]:
        """`grasp`, then a motion."""
        yield from super().instructions(step)
        yield Move(Goal(offset=self.by, axes=self._pull_axes), self.speed * self.pull, 0.02, step)

    @property
    def _pull_axes(self) -> Axes:
        return "tool" if self.axes == "tool" else "world"


@dataclass(frozen=True, kw_only=True)
class Press(Step):
    """Moves behind the target, presses it along the tool's z axis, and moves back.

    Args:
        of: What is pressed.
        offset: Metres from its origin to the tool where it touches.
        axes: Axes of `offset`.
        depth: Metres beyond that.
        approach: Metres along the tool's z axis from where the tool moves to the target.
        pressing: Share of the largest speed while it presses.
    """

    first: ClassVar[str] = "of"
    targets: ClassVar[tuple[str, ...]] = ("of",)

    of: Target
    offset: Vector = _ZERO
    axes: Axes = "world"
    depth: Positive = 0.01
    approach: NonNegative = 0.05
    pressing: Share = 0.3

    def instructions(self, step: str) -> Iterator[Instruction]:
        """Three motions."""
        yield self.move(self.goal(self.of, back=self.approach), step, 2 * _NEAR)
        down = self.goal(self.of, back=-self.depth)
        yield Move(down, self.speed * self.pressing, None, step)
        yield Wait(0.3, step)
        yield self.move(Goal(back=self.approach + self.depth), step)


@dataclass(frozen=True, kw_only=True)
class HandOver(Grasp):
    """Carries what `arm` holds to a place, where another arm grasps it; then the first lets go.

    The other parameters are those of `grasp`.

    Args:
        of: What is handed over.
        to: The arm that takes it.
        at: Where its origin is handed over, in metres; None is where it is.
        retreat: Metres that the first arm moves back along its tool's z axis.
    """

    to: str
    at: Vector | None = None
    retreat: NonNegative = 0.1

    def phases(self, step: str) -> Iterator[Phase]:
        """A motion of the first arm, `grasp` of the other, `release` of the first."""
        giver = self.arm or ""
        if self.at is not None:
            yield {giver: [self.move(Goal("world", self.at, held=True), step, 5 * _NEAR)]}
        yield {self.to: list(self.instructions(step))}
        yield {giver: list(Release(retreat=self.retreat, speed=self.speed).instructions(step))}

    def arms(self) -> Iterator[tuple[str, str]]:
        """Both."""
        yield from super().arms()
        yield "to", self.to


@dataclass(frozen=True, kw_only=True)
class Waiting(Step):
    """Waits.

    Args:
        seconds: How long.
    """

    first: ClassVar[str] = "seconds"

    seconds: Positive

    def instructions(self, step: str) -> Iterator[Instruction]:
        """Nothing moves."""
        yield Wait(self.seconds, step)


@dataclass(frozen=True, kw_only=True)
class Repeat(Step):
    """Performs steps several times.

    Args:
        times: How often.
        steps: The steps.
    """

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
        yield from ((f"{arm}", arm) for arm in self.steps)


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
