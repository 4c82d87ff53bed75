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

from embodichain.lab.gym.envs.managers.param_types import Fraction, NonNegative, Positive
from embodichain.lab.gym.expert.instructions import Beyond, Facing, Goal, Oriented, Turn, Vector
from embodichain.lab.gym.expert.step_register import (
    PASSING_DISTANCE,
    STEPS,
    Along,
    Arm,
    Axes,
    Made,
    Maker,
    Symmetry,
    TargetParam,
    expert_step,
)

__all__ = ["STEPS", "Maker"]

_ZERO: Vector = (0.0, 0.0, 0.0)
_NEAR = 0.004
"""Distance in metres that the tool must be within where it grasps, releases or presses."""


def _turn(
    align: TargetParam | None, symmetry: Symmetry, rpy: Vector | None = None, *, level: bool = False
) -> Turn | None:
    """How the tool is turned: to an orientation, or to a target, or not at all."""
    if rpy is not None:
        return Oriented(rpy)
    if align is not None:
        return Facing(align, symmetry, level)
    return None


@expert_step("move_to")
def move_to(
    make: Maker,
    to: TargetParam | None = None,
    offset: Vector = _ZERO,
    axes: Axes = "world",
    align: TargetParam | None = None,
    symmetry: Symmetry = 4,
    rpy: Vector | None = None,
    held: bool = False,
    free: bool = False,
    along: Along = "tool",
    tolerance: Positive | None = 0.01,
) -> Made:
    """One straight line of the tool, or of what is `held`, to a target; else from where it is.

    With `free`, the tool may turn on the way and end in any orientation. ``along: joints`` moves
    each joint straight to its end instead, where nothing is in the way.

    It fails farther from it than `tolerance`; below 0.02 it comes to rest there. With
    None it continues as soon as the tool was sent there.
    """
    turn = _turn(align, symmetry, rpy, level=True)
    goal = Goal(to, offset, axes, turn=turn, held=held, free=free, along=along)
    yield make.move(goal, tolerance)


@expert_step("grasp")
def grasp(
    make: Maker,
    of: TargetParam,
    offset: Vector = _ZERO,
    axes: Axes = "world",
    approach: NonNegative = 0.1,
    align: bool = True,
    symmetry: Symmetry = 4,
    rpy: Vector | None = None,
) -> Made:
    """Moves before the target, then to it, closes the gripper, checks that it holds something.

    With `align`, a tool that points up or down is turned about the vertical, so that its fingers
    are parallel to faces of the target.
    """
    turn = _turn(of if align else None, symmetry, rpy)
    goal = Goal(of, offset, axes, turn=turn)
    if approach:
        yield make.move(dataclasses.replace(goal, back=approach))
    yield make.move(goal, _NEAR)
    yield make.close_gripper(on=of)


@expert_step("release")
def release(make: Maker, retreat: NonNegative = 0.0) -> Made:
    """Opens the gripper, then moves back."""
    yield make.open_gripper()
    if retreat:
        yield make.move(Goal(back=retreat))


@expert_step("close")
def close(make: Maker) -> Made:
    """Closes the gripper on nothing, as for pressing."""
    yield make.close_gripper()


@expert_step("lift")
def lift(make: Maker, by: Positive = 0.1) -> Made:
    """Moves the tool up."""
    yield make.move(Goal(above=by))


@expert_step("place")
def place(
    make: Maker,
    to: TargetParam,
    offset: Vector = _ZERO,
    axes: Axes = "world",
    above: NonNegative = 0.08,
    align: TargetParam | None = None,
    symmetry: Symmetry = 4,
    retreat: NonNegative = 0.08,
    lowering: Fraction = 0.5,
) -> Made:
    """Moves what is held above the target, lowers it at the speed `lowering`, releases it."""
    turn = _turn(align, symmetry, level=True)
    goal = Goal(to, offset, axes, turn=turn, held=True)
    if above:
        yield make.move(dataclasses.replace(goal, above=above))
    yield make.move(goal, _NEAR, lowering)
    yield from release(make, retreat)


@expert_step("push")
def push(
    make: Maker,
    of: TargetParam,
    to: TargetParam,
    behind: NonNegative = 0.05,
    clearance: NonNegative = 0.05,
    height: float = 0.0,
    above: NonNegative = 0.1,
    free: bool = False,
) -> Made:
    """Lowers the tool behind an object, moves it straight on until that is at a target, then up.

    The tool is `behind` the object's origin when it touches it, `height` above it; it is lowered
    `clearance` farther behind. With `free`, it may turn on the way.
    """
    offset = (0.0, 0.0, height)
    start = Goal(of, offset, beyond=Beyond(to, behind + clearance), free=free)
    yield make.move(dataclasses.replace(start, above=above))
    yield make.move(start)
    yield make.move(Goal(to, offset, beyond=Beyond(of, -behind), free=free))
    yield from lift(make, above)


@expert_step("open")
def open_(
    make: Maker,
    of: TargetParam,
    by: Vector,
    offset: Vector = _ZERO,
    axes: Axes = "world",
    approach: NonNegative = 0.1,
    align: bool = True,
    symmetry: Symmetry = 4,
    rpy: Vector | None = None,
    pull: Fraction = 0.5,
) -> Made:
    """Grasps a handle, as `grasp` does, and moves it straight by a vector at the speed `pull`."""
    yield from grasp(make, of, offset, axes, approach, align, symmetry, rpy)
    direction: Axes = "tool" if axes == "tool" else "world"
    yield make.move(Goal(offset=by, axes=direction), PASSING_DISTANCE, pull)


@expert_step("press")
def press(
    make: Maker,
    of: TargetParam,
    offset: Vector = _ZERO,
    axes: Axes = "world",
    depth: Positive = 0.01,
    approach: NonNegative = 0.05,
    pressing: Fraction = 0.3,
    tips: bool = False,
) -> Made:
    """Moves before the target, `depth` beyond it at the speed `pressing`, and back.

    With `tips`, the ends of the fingers move there, which are beyond the tool.
    """
    yield make.move(Goal(of, offset, axes, back=approach, tips=tips), 2 * _NEAR)
    yield make.move(Goal(of, offset, axes, back=-depth, tips=tips), None, pressing)
    yield make.wait(0.3)
    yield make.move(Goal(back=approach + depth))


@expert_step("hand_over")
def hand_over(
    make: Maker,
    of: TargetParam,
    to: Arm,
    at: Vector | None = None,
    offset: Vector = _ZERO,
    axes: Axes = "world",
    approach: NonNegative = 0.1,
    align: bool = True,
    symmetry: Symmetry = 4,
    rpy: Vector | None = None,
    retreat: NonNegative = 0.1,
) -> Made:
    """The arm moves what it holds to a place, the arm `to` grasps it, the first releases it."""
    if at is not None:
        yield make.move(Goal("world", at, held=True))
    taker = dataclasses.replace(make, arm=to)
    yield from grasp(taker, of, offset, axes, approach, align, symmetry, rpy)
    yield from release(make, retreat)


@expert_step("wait")
def wait(make: Maker, seconds: Positive) -> Made:
    """Waits."""
    yield make.wait(seconds)
