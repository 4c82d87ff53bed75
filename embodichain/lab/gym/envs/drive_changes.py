"""`drive_changes`: which drive gains and link masses the events of a task may draw.

A term class says so with a class attribute ``drive_ranges``: parameter -> quantity of
`DriveChange`. Functions of users' own are not seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from embodichain.lab.gym.envs.cfg import EventCfg
from embodichain.lab.gym.envs.managers.registry import TERMS
from embodichain.lab.sim.compiler.drives import DriveChange

__all__ = ["drive_changes"]

_PICKS = ("joint_names", "control_parts")


def drive_changes(events: Mapping[str, EventCfg]) -> dict[str, list[DriveChange]]:
    """Return what events may draw for each articulation, by uid; malformed parameters are left out.

    Args:
        events: The task's events.
    """
    found: dict[str, list[DriveChange]] = {}
    for event in events.values():
        known = TERMS["event"].get(event.func) if isinstance(event.func, str) else None
        func = known.func if known is not None else event.func
        ranges: Mapping[str, str] = getattr(func, "drive_ranges", {})
        params: Mapping[str, Any] = event.params
        if known is not None:
            params = {meant: params[name] for name, meant in known.written(params).items()}
        entities = params.get("entity_cfgs") or [params.get("entity_cfg")]
        for param, quantity in ranges.items():
            bounds = _bounds(params.get(param))
            for entity in [e for e in entities if e is not None and bounds is not None]:
                names = _names(entity, quantity, params)
                change = DriveChange(quantity, names, bounds, _operation(params, quantity))  # type: ignore[arg-type]
                found.setdefault(str(_get(entity, "uid")), []).append(change)
    return found


def _get(entity: Any, name: str) -> Any:
    return entity.get(name) if isinstance(entity, Mapping) else getattr(entity, name, None)


def _names(entity: Any, quantity: str, params: Mapping[str, Any]) -> tuple[str, ...] | None:
    if quantity == "mass":
        given = [params.get("link_names") or _get(entity, "link_names")]
    else:
        given = [_get(entity, name) for name in _PICKS]
    names = [n for value in given if value for n in ([value] if isinstance(value, str) else value)]
    return tuple(names) or None


def _operation(params: Mapping[str, Any], quantity: str) -> Any:
    if quantity == "strength":  # factors, whatever the operation of the other fields
        return "abs"
    default = "add" if quantity == "mass" and params.get("relative") else "abs"
    return params.get("operation") or default


def _bounds(given: Any) -> Any:
    """[low, high] as a pair, {regex: [low, high]} as a map of pairs; None for anything else."""
    if isinstance(given, Mapping):
        pairs = {str(key): _pair(value) for key, value in given.items()}
        return None if None in pairs.values() else pairs
    return _pair(given)


def _pair(given: Any) -> tuple[float, float] | None:
    numbers = isinstance(given, Sequence) and all(isinstance(x, (int, float)) for x in given)
    return (float(given[0]), float(given[1])) if numbers and len(given) == 2 else None
