"""`drive_changes`: which drive gains and link masses the events of a task may draw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from embodichain.lab.gym.envs.cfg import EventCfg
from embodichain.lab.gym.envs.managers.terms.physics_draws import PhysicsDraw, physics_draws
from embodichain.lab.sim.compiler.robot.drives.drive_changes import DriveChange

__all__ = ["drive_changes"]


def drive_changes(
    events: Mapping[str, EventCfg], *, allow_import: bool = True
) -> dict[str, list[DriveChange]]:
    """Return what events declare to draw for drives and links, by articulation uid.

    Args:
        events: The task's events.
        allow_import: Whether events named ``package.module:function`` are imported.
    """
    changes: dict[str, list[DriveChange]] = {}
    for draw in physics_draws(events, allow_import=allow_import):
        change = DriveChange(
            quantity=draw.quantity,
            names=_name_patterns(draw),
            ranges=_as_floats(draw.range),
            # A strength is a factor of the gains, and no compiled value to replace or to add to.
            operation="abs" if draw.quantity == "strength" else draw.operation,
        )
        changes.setdefault(draw.entity.uid, []).append(change)
    return changes


def _name_patterns(draw: PhysicsDraw) -> tuple[str, ...] | None:
    """Return the patterns of the picked links or joints; None is all."""
    entity = draw.entity
    if draw.quantity in ("mass", "com"):
        patterns = _as_list(entity.link_names or entity.link)
    else:
        patterns = _as_list(entity.joint_names) + _as_list(entity.control_parts)
    return tuple(patterns) or None


def _as_list(names: str | Sequence[str] | None) -> list[str]:
    if isinstance(names, str):
        return [names]
    return list(names or [])


def _as_floats(
    limits: Sequence[float] | Mapping[str, Sequence[float]],
) -> tuple[float, float] | dict[str, tuple[float, float]]:
    if isinstance(limits, Mapping):
        return {name: (float(low), float(high)) for name, (low, high) in limits.items()}
    low, high = limits
    return float(low), float(high)
