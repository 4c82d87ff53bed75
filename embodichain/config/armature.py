"""Armature that limited drives need at the task's time step, written into the config.

What is computed is in `lab.sim.compiler.chatter`; here it becomes part of the frozen tree, so that
a run says which model it had and another run of it has the same.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping
from typing import Any

from embodichain.config.check_types import check_types
from embodichain.config.problems import LocatedProblem

__all__ = ["with_armature"]


def with_armature(tree: Mapping[str, Any]) -> tuple[dict[str, Any], tuple[LocatedProblem, ...]]:
    """Return a copy of a checked, settled tree with the armature that its joints lack.

    Only joints whose armature the task does not give are changed.

    Args:
        tree: A settled tree without mistakes.

    Returns:
        The tree, and a note for every articulation that was changed.
    """
    from embodichain.lab.gym.envs.drive_changes import drive_changes
    from embodichain.lab.sim.compiler.scene_check import raised_armature

    root = check_types(tree).root
    if root is None:
        raise ValueError("with_armature needs a tree without mistakes")
    changed, notes = copy.deepcopy(dict(tree)), []
    for path, armature in raised_armature(root.task, drive_changes(root.task.events)).items():
        entity = changed["task"]
        for key in path.split("."):
            entity = entity[key]
        drives = entity["drive_pros"] = dict(entity.get("drive_pros") or {})
        names = {_pattern(name): value for name, value in armature.items()}
        drives["armature"] = {**(drives.get("armature") or {}), **names}
        listed = ", ".join(f"{name}: {value:.4g}" for name, value in armature.items())
        message = f"raised to {{{listed}}}, because limited drives would chatter at the time step"
        notes.append(LocatedProblem(f"task.{path}.drive_pros.armature", message))
    return changed, tuple(notes)


def _pattern(name: str) -> str:
    """A joint's name as a regex that matches it."""
    try:
        plain = re.fullmatch(name, name) is not None
    except re.error:
        plain = False
    return name if plain else re.escape(name)
