"""`StartupChanges`: what startup events have changed, so that they can run again from the start."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.sim.engine.fields import DERIVED_FIELDS, compiled_field

if TYPE_CHECKING:
    from embodichain.lab.sim.sim_manager import SimulationManager

__all__ = ["StartupChanges"]

_PARTS = ("drives", "objects", "lights")
"""Entities with values that no model field contains."""
State = Mapping[str, Any]


class StartupChanges:
    """The model fields and properties that startup events change, as they were before.

    Made before the events run; `note` is called after them, and `undo` before they run again. What
    other code has written since, to fields that no startup event writes, stays.

    Args:
        sim: The simulation, compiled.
    """

    def __init__(self, sim: SimulationManager) -> None:
        self._sim = sim
        self._fields: dict[str, Any] = {}
        self._properties: dict[str, dict[str, dict[str, Any]]] = {part: {} for part in _PARTS}
        self._before: State | None = self._state()

    def _state(self) -> State:
        state = self._sim.state_dict()
        parts = {name: state[name] for name in _PARTS}
        return self._sim.arrays.saved({"model": state["engine"]["model"], **parts})

    def note(self) -> None:
        """Store the earlier values of everything that has changed since."""
        before = self._before
        if before is None:
            return
        after = self._state()
        for name, values in after["model"].items():
            if name not in before["model"]:
                self._fields[name] = None  # as compiled
            elif not _same(before["model"][name], values):
                self._fields[name] = before["model"][name]
        for part in _PARTS:
            for uid, values in after[part].items():
                changed = {
                    key: value
                    for key, value in before[part][uid].items()
                    if not _same(value, values[key])
                }
                if changed:
                    self._properties[part][uid] = changed
        self._before = None

    def undo(self) -> None:
        """Write all of it back, through the engine, so that logs have it."""
        sim = self._sim
        engine = sim.engine
        fields = sim.arrays.loaded(self._fields)
        for again in range(2 if DERIVED_FIELDS & fields.keys() else 1):
            if again:
                engine.set_const()  # for derived quantities that are not fields
            for name, values in fields.items():
                if values is None:
                    width = engine.model_field(name).shape[1]
                    engine.write_model(name, compiled_field(engine.model, name).ravel()[:width])
                else:
                    engine.write_model(name, values.reshape(sim.num_envs, -1))
        articulations = {**sim.robots, **sim.articulations}
        owners: dict[str, Mapping[str, Any]] = {
            "drives": {uid: handle.drives for uid, handle in articulations.items()},
            "objects": sim.rigid_objects,
            "lights": sim.lights,
        }
        for part, entities in sim.arrays.loaded(self._properties).items():
            for uid, changed in entities.items():
                owner: Any = owners[part][uid]
                owner.load_state_dict({**owner.state_dict(), **changed})


def _same(a: Any, b: Any) -> bool:
    """Whether two parts of a state are equal to the bit; those of a device are maps of arrays."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(_same(a[key], b[key]) for key in a)
    first = np.asarray(a)
    second = np.asarray(b)
    return first.shape == second.shape and first.tobytes() == second.tobytes()
