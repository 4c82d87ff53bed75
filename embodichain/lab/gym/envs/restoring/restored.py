"""Restoring a recorded moment: the state, the model and the draws of a `Snapshot`.

A snapshot has no states of terms (histories, delays, commands, timers) and of random streams: they
begin as at a reset, and `not_restored` names them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.restoring.snapshot import Drawn, Snapshot, SnapshotSource
from embodichain.lab.sim.engine.fields import DERIVED_FIELDS, compiled_field, row_layout
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.manager import Manager
    from embodichain.lab.gym.envs.step.episodes import Episodes
    from embodichain.lab.sim.engine.api import Engine
    from embodichain.lab.sim.sim_manager import SimulationManager
    from embodichain.utils.array_types import EnvIds

__all__ = ["not_restored", "put", "snapshot_of"]

_ALWAYS = ("random streams", "sums of rewards and metrics over the episode")

_EXTRAS = {
    "memories": "noise, delay, history",
    "pipelines": "actions under way",
    "timers": "when it fires next",
    "left": "when it is drawn next",
}
"""Entries of a manager's state besides those of its terms."""


def snapshot_of(
    log: SnapshotSource | Snapshot, env: int, episode: int | None, step: int | None
) -> Snapshot:
    """Return the snapshot that the arguments of `BaseEnv.restore` refer to.

    Raises:
        TypeError: If it is neither a snapshot nor an open log.
        ConfigError: If there is no such moment.
    """
    if isinstance(log, Snapshot):
        return log
    if not hasattr(log, "snapshot"):
        raise TypeError(f"log must be an open log: embodichain.recording.open({str(log)!r})")
    return log.snapshot(env, episode, step)


def put(
    snapshot: Snapshot,
    sim: SimulationManager,
    managers: Mapping[str, Manager[Any]],
    episodes: Episodes,
    ids: EnvIds,
) -> None:
    """Set the state, model fields, draws and counters of environments from a snapshot.

    Args:
        snapshot: The snapshot.
        sim: The simulation.
        managers: All managers by section.
        episodes: The counters.
        ids: (n,) environments, on the host.

    Raises:
        ConfigError: If it is of another scene or another action space.
    """
    _require_same_scene(snapshot, sim.engine.model)
    _require_same_actions(snapshot, episodes.last_action.shape[1])
    where = None if len(ids) == sim.num_envs else ids
    for manager in managers.values():
        manager.reset(where)
    sim.reset_objects_state(where)
    for drawn in snapshot.drawn:
        _call_with_draws(managers, drawn, where)
    _put_model(sim.engine, snapshot.fields, where)
    sim.engine.write("row", snapshot.row, where)
    for handle in {**sim.robots, **sim.articulations}.values():
        handle.drives.load_fields(where, snapshot.fields)
    for body in sim.rigid_objects.values():
        body.load_fields(where, snapshot.fields)
    sim.engine.forward(where)
    commands: Any = managers["commands"]
    commands.update(where)
    episodes.restore(ids, snapshot.elapsed, snapshot.episode)
    episodes.set_last_action(ids, snapshot.last_action)


def _call_with_draws(
    managers: Mapping[str, Manager[Any]], drawn: Drawn, where: EnvIds | None
) -> None:
    """Call a term with its recorded draws, to set what it stores outside the simulation state."""
    manager: Any = managers[_section_of(drawn)]
    term = manager.terms.get(drawn.term)
    if term is None:
        return
    if drawn.mode == "command" or (term.cfg.mode == drawn.mode and not term.cfg.is_global):
        manager.call_with_draws(drawn.term, drawn.mode, where, drawn.values)


def _put_model(engine: Engine, fields: Mapping[str, NDArray[Any]], where: EnvIds | None) -> None:
    """Set the fields that differ between environments; reset all others to the compiled model."""
    engine.forward(where)  # pending derivations must not overwrite the fields set below
    engine.reset(where)
    for name, values in engine.state_dict()["model"].items():
        if name not in fields:
            width = values[0].size  # of bounding volumes, a batch has only those of bodies
            compiled = compiled_field(engine.model, name).reshape(-1)[:width]
            engine.write_model(name, compiled, where)
    for again in range(2 if DERIVED_FIELDS & fields.keys() else 1):
        if again:
            engine.set_const(where)  # for derived quantities that are not fields
        for name, values in fields.items():
            engine.write_model(name, values, where)


def _require_same_scene(snapshot: Snapshot, model: mujoco.MjModel) -> None:
    """Refuse a snapshot of a scene with other names, or with other components of a row."""
    for kind, names in _names(model).items():
        recorded = _names(snapshot.model)[kind]
        if names != recorded:
            missing = [name for name in recorded if name not in names] or recorded
            raise ConfigError(
                f"{snapshot.origin}: it is from another scene: {kind} here are "
                f"{', '.join(names) or 'none'}; recorded were {', '.join(missing)}"
            )
    layout = {name: (part.start, part.stop) for name, part in row_layout(model).items()}
    if layout != dict(snapshot.layout):
        raise ConfigError(f"{snapshot.origin}: its rows have other components than this scene's")


def _require_same_actions(snapshot: Snapshot, width: int) -> None:
    """Refuse a snapshot whose actions have another number of columns."""
    if snapshot.last_action.shape != (width,):
        raise ConfigError(
            f"{snapshot.origin}: its actions have {len(snapshot.last_action)} columns, here {width}"
        )


def _names(model: mujoco.MjModel) -> dict[str, list[str]]:
    """Return the names of bodies, joints and actuators, in order."""
    return {
        "bodies": [model.body(i).name for i in range(model.nbody)],
        "joints": [model.joint(i).name for i in range(model.njnt)],
        "actuators": [model.actuator(i).name for i in range(model.nactuator)],
    }


def not_restored(
    snapshot: Snapshot, sim: SimulationManager, managers: Mapping[str, Manager[Any]]
) -> list[str]:
    """Return what differs from the recorded moment, one line each."""
    missing = [*snapshot.notes, *_ALWAYS]
    for uid, sensor in sim.sensors.items():
        if sensor.cfg.rate is not None:
            missing.append(f"sensors.{uid}: readings between measurements")
    redrawn = {(_section_of(drawn), drawn.term) for drawn in snapshot.drawn}
    for section, manager in managers.items():
        for name, part in _states(manager):
            if part or (section, name) not in redrawn:
                missing.append(f"{section}.{name}{part}")
    other_fields = _differing(sim.engine.model, snapshot.model)
    if other_fields:
        missing.insert(0, f"the scene is another one: its {', '.join(other_fields)} differ")
    return missing


def _section_of(drawn: Drawn) -> str:
    """Return the section of the term that drew."""
    return "commands" if drawn.mode == "command" else "events"


def _states(manager: Manager[Any]) -> Iterator[tuple[str, str]]:
    """Yield names of terms with a state, and which part of it where it is not the term's own."""
    if not len(manager):
        return
    state = manager.state_dict()
    for name in manager.terms:
        if _has_values(state["terms"].get(name)):
            yield name, ""
        fires_in_every_step = getattr(manager.terms[name].cfg, "interval_step", None) == 1
        for key, description in _EXTRAS.items():
            if key == "timers" and fires_in_every_step:
                continue
            if _has_values(state.get(key, {}).get(name)):
                yield name, f": {description}"


def _has_values(state: Any) -> bool:
    if hasattr(state, "__len__"):
        return len(state) > 0
    return state is not None


def _differing(here: mujoco.MjModel, there: mujoco.MjModel) -> list[str]:
    """Return arrays of the model, and numbers of its options, that are not the same."""
    return [
        *_differing_attributes(here, there),
        *(f"opt.{name}" for name in _differing_attributes(here.opt, there.opt)),
    ]


def _differing_attributes(here: Any, there: Any) -> list[str]:
    """Return the names of arrays and numbers that two objects do not have in common."""
    differing: list[str] = []
    for name in dir(here):
        # The signature differs for each compilation.
        if name.startswith("_") or name == "signature":
            continue
        value = getattr(here, name)
        if not isinstance(value, (np.ndarray, int, float)):
            continue
        may_be_nan = np.asarray(value).dtype.kind == "f"
        if not np.array_equal(value, getattr(there, name), equal_nan=may_be_nan):
            differing.append(name)
    return differing
