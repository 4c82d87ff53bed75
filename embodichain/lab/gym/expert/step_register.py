"""The register of an expert's steps, and what a step is: `STEPS`, `expert_step`, `Maker`.

A step is a function that yields the instructions it is made of. Its first argument is a `Maker`,
the others are its parameters in a task file, checked by their types::

    @expert_step("nudge")
    def nudge(make: Maker, of: TargetParam, by: Positive = 0.02) -> Made:
        yield make.move(Goal(of, above=by))
        yield make.move(Goal(of))

A package outside names its module with an entry point of the group ``embodichain.steps``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, PlainValidator

from embodichain.lab.gym.expert.instructions import (
    Goal,
    Grip,
    Instruction,
    Move,
    Target,
    Wait,
)
from embodichain.utils.register import Register

__all__ = [
    "COMPOSITES",
    "PASSING_DISTANCE",
    "STEPS",
    "Aim",
    "Along",
    "Arm",
    "Axes",
    "Made",
    "Maker",
    "Symmetry",
    "TargetParam",
    "Turns",
    "expert_step",
]


def _as_target(value: Any) -> Target:
    if not isinstance(value, str) and not callable(value):
        raise ValueError("must be an entity, ENTITY/NAME, a command or world")
    return value


TargetParam = Annotated[Target, PlainValidator(_as_target)]
"""A parameter that is a target: it must exist in the task."""
Arm = Annotated[str, "arm"]
"""A parameter that names another arm, which then takes part in the step."""
Axes = Literal["world", "target", "tool"]
Along = Literal["tool", "joints"]
Symmetry = Annotated[int, Field(ge=1)]
"""A parameter that is the number of directions in a full turn that are as good."""
Made = Iterator[Instruction]
# Older names.
Aim = TargetParam
Turns = Symmetry
PASSING_DISTANCE = 0.03
"""Distance in metres that the tool must be within at a place that it passes."""


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

    def move(self, goal: Goal, near: float | None = PASSING_DISTANCE, share: float = 1.0) -> Move:
        """Return a motion of the tool to a goal, at a share of the speed of the step."""
        return Move(self.step, self.arm, goal, self.speed * share, near)

    def open_gripper(self) -> Grip:
        """Return that the gripper opens."""
        return Grip(self.step, self.arm, opens=True, takes=None)

    def close_gripper(self, on: Target | None = None) -> Grip:
        """Return that the gripper closes; the step fails unless it then holds what `on` names."""
        return Grip(self.step, self.arm, opens=False, takes=on)

    def grip(self, opens: bool, takes: Target | None = None) -> Grip:
        """The older name of `open_gripper` and `close_gripper`."""
        return Grip(self.step, self.arm, opens, takes)

    def wait(self, seconds: float) -> Wait:
        """Return that the arm waits for a time."""
        return Wait(self.step, self.arm, seconds)


STEPS: Register[Callable[..., Made]] = Register(
    "step of an expert",
    group="embodichain.steps",
    modules=("embodichain.lab.gym.expert.steps",),
)
"""Name in a task file -> the function that makes the step."""
COMPOSITES = ("repeat", "together")
"""Names of what contains steps; `reading` has them."""

Step = TypeVar("Step", bound=Callable[..., Made])


def expert_step(name: str) -> Callable[[Step], Step]:
    """Register a function ``step(make, **params)`` that yields instructions as a step.

    Parameters `arm` and `speed` belong to every step and are not the function's own; `make` has
    them. A parameter of type `TargetParam` is a target, one of type `Arm` another arm. What is
    written without a key in a task file, ``{grasp: cube}``, is the first parameter.

    Args:
        name: Its name in task files.

    Returns:
        A decorator that returns its argument.

    Raises:
        ValueError: If another function has the name, or it is one of `COMPOSITES`.
    """
    if name in COMPOSITES:
        raise ValueError(f"a step cannot be called {name!r}: that contains steps")
    return STEPS.add(name)
