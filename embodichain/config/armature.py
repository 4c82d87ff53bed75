"""Armature that limited drives need at the task's time step, written into the config.

`lab.sim.compiler.chatter` computes it while the scene is checked; here it becomes part of the
frozen tree, so that a run says which model it had and another run of it has the same.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

from embodichain.config.problems import LocatedProblem
from embodichain.lab.sim.compiler.names import exact_pattern
from embodichain.lab.sim.prepared_scene import PreparedScene

__all__ = ["with_armature"]


def with_armature(
    tree: Mapping[str, Any], prepared: PreparedScene
) -> tuple[dict[str, Any], tuple[LocatedProblem, ...]]:
    """Return a copy of a checked, settled tree with the armature that its joints lack.

    Only joints whose armature the task does not give are changed.

    Args:
        tree: A settled tree without mistakes.
        prepared: Its scene, as checked; its articulations' configs are changed likewise.

    Returns:
        The tree, and a note for every articulation that was changed.
    """
    changed, notes = copy.deepcopy(dict(tree)), []
    for path, raised in prepared.settle_armature().items():
        entity = changed["task"]
        for key in path.split("."):
            entity = entity[key]
        drives = entity["drive_pros"] = dict(entity.get("drive_pros") or {})
        names = {exact_pattern(name): value for name, value in raised.items()}
        drives["armature"] = {**(drives.get("armature") or {}), **names}
        listed = ", ".join(f"{name}: {value:.4g}" for name, value in raised.items())
        message = f"raised to {{{listed}}}, because limited drives would chatter at the time step"
        notes.append(LocatedProblem(f"task.{path}.drive_pros.armature", message))
    return changed, tuple(notes)
