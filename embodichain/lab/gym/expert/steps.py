"""The steps of an expert: functions that say what motions a step is made of.

Lengths are in metres, angles in rad; `speed` is a share of the largest one. Several steps have
these parameters: `offset`, from the target to the tool, in `axes`; `approach` and `retreat`,
lengths along the tool's z axis, which points out of a gripper, from where it comes and to where it
goes back; `rpy`, an orientation in `axes`: roll, pitch, yaw about fixed axes; `align`, a target to
which the tool (or what it holds) is turned about the vertical until axes are parallel; `symmetry`,
the directions in a full turn that are as good.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field, PlainValidator

from embodichain.lab.gym.envs.managers.param_types import Fraction, NonNegative, Positive
from embodichain.lab.gym.expert.instructions import (
    Goal,
    Grip,
    Instruction,
    Move,
    Target,
    Vector,
    Wait,
)

__all__ = ["STEPS", "Maker"]


def _as_target(value: Any) -> Target:
    if not isinstance(value, str) and not callable(value):
        raise ValueError("must be an entity, ENTITY/NAME, a command or world")
    return value


Aim = Annotated[Target, PlainValidator(_as_target)]
Axes = Literal["world", "target", "tool"]
Turns = Annotated[int, Field(ge=1)]
Made = Iterator[Instruction]
_ZERO: Vector = (0.0, 0.0, 0.0)
_NEAR = 0.004
"""M: how near the tool must be to a place where it grasps, releases or presses."""
_PASS = 0.03
"""M: how near it must be to a place that it passes."""


@dataclass(frozen=True)
class Maker:
    """Makes the instructions of a step.

    Attributes:
        step: The step, for messages.
        arm: Its arm; "" is the only one.
        speed: Share of the largest speed.
    """

    step: str
    arm: str = ""
    speed: float = 1.0

    def move(self, goal: Goal, near: float | None = _PASS, share: float = 1.0) -> Move:
        """A motion at a share of the speed of the step."""
        return Move(self.step, self.arm, goal, self.speed * share, near)

    def grip(self, opens: bool, takes: Target | None = None) -> Grip:
        """The fingers."""
        return Grip(self.step, self.arm, opens, takes)

    def wait(self, seconds: float) -> Wait:
        """Time."""
        return Wait(self.step, self.arm, seconds)


def move_to(
    make: Maker,
    to: Aim | None = None,
    offset: Vector = _ZERO,
    axes: Axes = "world",
    align: Aim | None = None,
    symmetry: Turns = 4,
    rpy: Vector | None = None,
    held: bool = False,
    tolerance: Positive | None = 0.01,
) -> Made:
    """One straight line of the tool, or of what is `held`, to a target; else from where it is.

    It fails farther from it than `tolerance`; below 0.02 it comes to rest there. With
    None it continues as soon as the tool was sent there.
    """
    goal = Goal(to, offset, axes, align=align, symmetry=symmetry, rpy=rpy, held=held, level=True)
    yield make.move(goal, tolerance)


def grasp(
    make: Maker,
    of: Aim,
    offset: Vector = _ZERO,
    axes: Axes = "world",
    approach: NonNegative = 0.1,
    align: bool = True,
    symmetry: Turns = 4,
    rpy: Vector | None = None,
) -> Made:
    """Moves before the target, then to it, closes the gripper, checks that it holds something.

    With `align`, a tool that points up or down is turned about the vertical, so that its fingers
    are parallel to faces of the target.
    """
    turned = of if align and rpy is None else None
    goal = Goal(of, offset, axes, align=turned, symmetry=symmetry, rpy=rpy)
    if approach:
        yield make.move(dataclasses.replace(goal, back=approach))
    yield make.move(goal, _NEAR)
    yield make.grip(False, of)


def release(make: Maker, retreat: NonNegative = 0.0) -> Made:
    """Opens the gripper, then moves back."""
    yield make.grip(True)
    if retreat:
        yield make.move(Goal(back=retreat))


def close(make: Maker) -> Made:
    """Closes the gripper on nothing, as for pressing."""
    yield make.grip(False)


def lift(make: Maker, by: Positive = 0.1) -> Made:
    """Moves the tool up."""
    yield make.move(Goal(above=by))


def place(
    make: Maker,
    to: Aim,
    offset: Vector = _ZERO,
    axes: Axes = "world",
    above: NonNegative = 0.08,
    align: Aim | None = None,
    symmetry: Turns = 4,
    retreat: NonNegative = 0.08,
    lowering: Fraction = 0.5,
) -> Made:
    """Moves what is held above the target, lowers it at the speed `lowering`, releases it."""
    goal = Goal(to, offset, axes, align=align, symmetry=symmetry, held=True, level=True)
    if above:
        yield make.move(dataclasses.replace(goal, above=above))
    yield make.move(goal, _NEAR, lowering)
    yield from release(make, retreat)


def push(
    make: Maker,
    of: Aim,
    to: Aim,
    behind: NonNegative = 0.05,
    clearance: NonNegative = 0.05,
    height: float = 0.0,
    above: NonNegative = 0.1,
) -> Made:
    """Lowers the tool behind an object, moves it straight on until that is at a target, then up.

    The tool is `behind` the object's origin when it touches it, `height` above it; it is lowered
    `clearance` farther behind.
    """
    offset = (0.0, 0.0, height)
    start = Goal(of, offset, beyond=behind + clearance, start=to)
    yield make.move(dataclasses.replace(start, above=above))
    yield make.move(start)
    yield make.move(Goal(to, offset, beyond=-behind, start=of))
    yield from lift(make, above)


def open_(
    make: Maker,
    of: Aim,
    by: Vector,
    offset: Vector = _ZERO,
    axes: Axes = "world",
    approach: NonNegative = 0.1,
    align: bool = True,
    symmetry: Turns = 4,
    rpy: Vector | None = None,
    pull: Fraction = 0.5,
) -> Made:
    """Grasps a handle, as `grasp` does, and moves it straight by a vector at the speed `pull`."""
    yield from grasp(make, of, offset, axes, approach, align, symmetry, rpy)
    yield make.move(Goal(offset=by, axes="tool" if axes == "tool" else "world"), _PASS, pull)


def press(
    make: Maker,
    of: Aim,
    offset: Vector = _ZERO,
    axes: Axes = "world",
    depth: Positive = 0.01,
    approach: NonNegative = 0.05,
    pressing: Fraction = 0.3,
) -> Made:
    """Moves before the target, `depth` beyond it at the speed `pressing`, and back."""
    yield make.move(Goal(of, offset, axes, back=approach), 2 * _NEAR)
    yield make.move(Goal(of, offset, axes, back=-depth), None, pressing)
    yield make.wait(0.3)
    yield make.move(Goal(back=approach + depth))


def hand_over(
    make: Maker,
    of: Aim,
    to: str,
    at: Vector | None = None,
    offset: Vector = _ZERO,
    axes: Axes = "world",
    approach: NonNegative = 0.1,
    align: bool = True,
    symmetry: Turns = 4,
    rpy: Vector | None = None,
    retreat: NonNegative = 0.1,
) -> Made:
    """The arm moves what it holds to a place, the arm `to` grasps it, the first releases it."""
    if at is not None:
        yield make.move(Goal("world", at, held=True))
    taker = dataclasses.replace(make, arm=to)
    yield from grasp(taker, of, offset, axes, approach, align, symmetry, rpy)
    yield from release(make, retreat)


def wait(make: Maker, seconds: Positive) -> Made:
    """Waits."""
    yield make.wait(seconds)


STEPS: dict[str, Callable[..., Made]] = {
    "move_to": move_to,
    "grasp": grasp,
    "release": release,
    "close": close,
    "lift": lift,
    "place": place,
    "push": push,
    "open": open_,
    "press": press,
    "hand_over": hand_over,
    "wait": wait,
}
"""Name in a task file -> the step; `reading` has ``repeat`` and ``together`` besides."""
