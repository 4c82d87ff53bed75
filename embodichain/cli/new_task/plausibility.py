"""`warn_of_size`: a robot that is too large to be meant so, before anything is guessed of it."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation

__all__ = ["size_notes", "warn_of_size"]


def size_notes(parsed: ParsedArticulation) -> list[str]:
    """A message about a robot that is tens of metres high, as with meshes in millimetres."""
    from embodichain.lab.sim.compiler.robot.robot_notes import implausible_size

    return implausible_size(parsed.path, parsed.model, parsed.init_qpos)


def warn_of_size(parsed: ParsedArticulation) -> None:
    """Print that message on stderr."""
    for note in size_notes(parsed):
        sys.stderr.write(f"warning: {note}\n")
