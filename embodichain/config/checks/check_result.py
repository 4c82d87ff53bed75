"""`Check`: the result of checking a whole config."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from embodichain.config.keys.check_types import TypeCheck
from embodichain.utils.errors import Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.scene_setup.declared_scene import DeclaredScene

__all__ = ["Check"]


@dataclass(frozen=True, slots=True)
class Check:
    """The result of checking a whole config.

    Attributes:
        problems: Every mistake; empty if there is none.
        types: The config with the task's suggestions, as plain values and as data classes.
        scene: The scene that the task declares, with its files read; None if the part of the config
            with its entities has mistakes.
        notes: Given keys that change nothing, and values that look as if in another unit.
    """

    problems: list[Problem]
    types: TypeCheck
    scene: DeclaredScene | None = None
    notes: tuple[Problem, ...] = ()
