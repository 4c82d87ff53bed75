"""What steps are made of: `Move` the tool, `Grip`, `Wait`; and `Phase`, a list for each arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

__all__ = [
    "EXACT",
    "Beyond",
    "Facing",
    "Goal",
    "Grip",
    "Instruction",
    "Move",
    "Oriented",
    "Phase",
    "Target",
    "Turn",
    "Vector",
    "Wait",
]

Target = str | Callable[..., Any]
"""``ENTITY``, ``ENTITY/LINK``, a command, ``world``; in Python also ``f(env) -> (N, 7)`` poses."""
EXACT = 0.02
"""Tolerance in metres below which a motion ends at rest."""
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Facing:
    """Turns the tool, or what it holds, about the vertical until its axes are a target's.

    Attributes:
        target: What it is turned to.
        symmetry: Directions in a full turn that are as good.
        level: Whether a tool that does not point up or down is turned as well.
    """

    target: Target
    symmetry: int = 4
    level: bool = False


@dataclass(frozen=True)
class Oriented:
    """Gives the tool an orientation.

    Attributes:
        rpy: Roll, pitch, yaw about fixed axes, those of the goal, in rad.
    """

    rpy: Vector


Turn = Facing | Oriented


@dataclass(frozen=True)
class Beyond:
    """A place beyond the target, on the horizontal line from another one.

    Attributes:
        start: The other target.
        distance: Metres.
    """

    start: Target
    distance: float


@dataclass(frozen=True)
class Goal:
    """A pose for the tool, or for what it holds, computed when the motion begins.

    Three examples. ``Goal("cube", back=0.1)`` is 10 cm behind the cube along the tool's own axis:
    where a grasp begins. ``Goal("goal", held=True)`` has what the gripper holds at the goal,
    wherever it was grasped: where it is placed. ``Goal("cube", beyond=Beyond("goal", 0.05))`` is
    5 cm beyond the cube, seen from the goal: where a push to the goal begins.

    Attributes:
        target: What the position is relative to; None is where the tool is on its path.
        offset: Metres.
        axes: Axes of `offset` and of an orientation: of the environment, the target or the tool.
        above: Metres up from there.
        back: Metres back along the tool's z axis, which points out of a gripper.
        turn: How it is turned; None keeps the orientation.
        beyond: A place beyond the target instead.
        held: Whether the pose is that of what the gripper holds.
        free: Whether any orientation of the tool will do.
        along: What moves straight on the way: the tool, or each joint.
        tips: Whether the ends of the fingers, beyond the tool, are at the place.
    """

    target: Target | None = None
    offset: Vector = (0.0, 0.0, 0.0)
    axes: Literal["world", "target", "tool"] = "world"
    above: float = 0.0
    back: float = 0.0
    turn: Turn | None = None
    beyond: Beyond | None = None
    held: bool = False
    free: bool = False
    along: Literal["tool", "joints"] = "tool"
    tips: bool = False


@dataclass(frozen=True)
class Instruction:
    """What one arm does: `step` names the step in messages, "" is the only arm."""

    step: str
    arm: str


@dataclass(frozen=True)
class Move(Instruction):
    """Moves the tool along a straight line, at a share of the largest speed.

    `tolerance` is how near the measured pose must come to the goal, in metres, at rest if it is
    below `EXACT`; with None it continues as soon as the goal was asked for.
    """

    goal: Goal
    speed: float
    tolerance: float | None


@dataclass(frozen=True)
class Grip(Instruction):
    """Opens or closes the gripper, until the fingers rest; `takes` must be between them then."""

    opens: bool
    takes: Target | None


@dataclass(frozen=True)
class Wait(Instruction):
    """Waits."""

    seconds: float


Phase = dict[str, list[Instruction]]
"""Arm -> what it does. The next phase begins when all arms have finished."""
