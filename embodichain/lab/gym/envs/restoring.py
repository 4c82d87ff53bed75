"""Putting a recorded moment into a live environment, so that it goes on from there.

What a log knows is a `Snapshot`. What terms remember besides (histories, delays, commands, timers)
and how far random streams have come is not in it: those begin as at a reset, and it is said.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.gym.envs.snapshot import Drawn, Snapshot, SnapshotSource
from embodichain.lab.sim.engine.layout import row_layout
from embodichain.lab.sim.engine.model_fields import DERIVED_FIELDS
from embodichain.lab.sim.objects._arrays import as_env_ids
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.envs.managers.base import Manager
    from embodichain.lab.sim.engine.base import EnvIndex
    from embodichain.lab.sim.types import EnvObs

__all__ = ["not_restored", "put", "restore", "snapshot_of"]

_ALWAYS = ("random streams", "sums of rewards and metrics over the episode")

_EXTRAS = {
    "memories": "noise, delay, history",
    "pipelines": "actions under way",
    "timers": "when it fires next",
    "left": "when it is drawn next",
}
"""Entries of managers' states beside those of their terms."""


def snapshot_of(
    log: SnapshotSource | Snapshot, env: int, episode: int | None, step: int | None
) -> Snapshot:
    """What `BaseEnv.restore` was given as a snapshot.

    Raises:
        TypeError: If it is neither a snapshot nor an open log.
        ConfigError: If there is no such moment.
    """
    if isinstance(log, Snapshot):
        return log
    if not hasattr(log, "snapshot"):
        raise TypeError(f"log must be an open log: embodichain.recording.open({str(log)!r})")
    return log.snapshot(env, episode, step)


def restore(env: BaseEnv, snapshot: Snapshot, env_ids: Any) -> tuple[EnvObs, dict[str, Any]]:
    """Put a snapshot into environments, tell observers, and observe; see `BaseEnv.restore`."""
    ids = as_env_ids(env_ids, env.num_envs)
    ids = np.arange(env.num_envs) if ids is None else ids
    put(env, snapshot, ids)
    for observer in env.observers:
        observer.on_reset(env, ids)
    obs = env._observe_reset(ids, {})
    info = dict(env.get_info().items())
    return obs, {**info, "not_restored": not_restored(env, snapshot)}


def put(env: BaseEnv, snapshot: Snapshot, ids: EnvIndex) -> None:
    """Give environments the state, the model and the counters of a snapshot; observes nothing.

    Args:
        env: The environment.
        snapshot: What to put in.
        ids: (n,) sorted unique environments.

    Raises:
        ConfigError: If it is of another scene or another action space.
    """
    _check(env, snapshot)
    where = None if len(ids) == env.num_envs else ids
    for manager in env._resetting:
        manager.reset(where)
    env.sim.reset_objects_state(where)
    for drawn in snapshot.drawn:
        _fire(env, drawn, where)
    _put_model(env, snapshot.fields, where)
    env.sim.engine.write("row", snapshot.row, where)
    handles = {**env.sim.robots, **env.sim.articulations}
    for handle in handles.values():
        handle.drives.take_over(where, snapshot.fields)
    for body in env.sim.rigid_objects.values():
        body.take_over(where, snapshot.fields)
    env.sim.engine.forward(where)
    env.command_manager.update(where)
    env._last_action = env._last_action.copy()  # observers may keep the one of the step
    env._last_action[ids] = snapshot.last_action
    env._elapsed[ids] = snapshot.elapsed
    env._episode_ids[ids] = snapshot.episode
    env._success[ids] = False
    if env._pending is not None:
        env._pending[ids] = False
    env._task_success = torch.from_numpy(env._success.copy())


def _fire(env: BaseEnv, drawn: Drawn, where: EnvIndex | None) -> None:
    """Let a term do again what it did, for what it keeps outside the simulation's state."""
    if drawn.mode == "command" and drawn.term in env.command_manager.terms:
        env.command_manager.replay(drawn.term, "command", where, drawn.values)
        return
    term = env.event_manager.terms.get(drawn.term)
    if term is not None and term.cfg.mode == drawn.mode and not term.cfg.is_global:
        env.event_manager.replay(drawn.term, drawn.mode, where, drawn.values)


def _put_model(env: BaseEnv, fields: Mapping[str, NDArray[Any]], where: EnvIndex | None) -> None:
    """Set what may differ between environments; the rest becomes what was compiled."""
    engine = env.sim.engine
    engine.forward(where)  # nothing that is still to be derived may undo what follows
    engine.reset(where)  # and its counters are those of a new beginning
    for name, values in engine.state_dict()["model"].items():
        if name not in fields:
            width = values[0].size  # of bounding volumes a batch keeps only the bodies'
            engine.write_model(name, _compiled(engine.model, name)[:width], where)
    for again in range(2 if DERIVED_FIELDS & fields.keys() else 1):
        if again:
            engine.set_const(where)  # for what follows from fields and is none itself
        for name, values in fields.items():
            engine.write_model(name, values, where)


def _compiled(model: mujoco.MjModel, name: str) -> NDArray[Any]:
    owner: Any = model
    *path, last = name.split(".")
    for part in path:
        owner = getattr(owner, part)
    return np.asarray(getattr(owner, last)).reshape(-1)


def _check(env: BaseEnv, snapshot: Snapshot) -> None:
    model = env.sim.engine.model
    for what, here, there in zip(
        ("bodies", "joints", "actuators"), _names(model), _names(snapshot.model), strict=True
    ):
        if here != there:
            missing = [name for name in there if name not in here] or list(there)
            raise ConfigError(
                f"{snapshot.origin}: it is of another scene: {what} here are "
                f"{', '.join(here) or 'none'}; recorded were {', '.join(missing)}"
            )
    layout = {name: (s.start, s.stop) for name, s in row_layout(model).items()}
    if layout != dict(snapshot.layout):
        raise ConfigError(f"{snapshot.origin}: its rows hold other components than here")
    width = env._last_action.shape[1]
    if snapshot.last_action.shape != (width,):
        raise ConfigError(
            f"{snapshot.origin}: its actions have {len(snapshot.last_action)} columns, here {width}"
        )


def _names(model: mujoco.MjModel) -> tuple[list[str], ...]:
    kinds = (model.nbody, model.body), (model.njnt, model.joint), (model.nactuator, model.actuator)
    return tuple([named(i).name for i in range(count)] for count, named in kinds)


def not_restored(env: BaseEnv, snapshot: Snapshot) -> list[str]:
    """What is not as it was when the snapshot's moment was recorded, one line each."""
    found = [*snapshot.notes, *_ALWAYS]
    again = {("commands" if d.mode == "command" else "events", d.term) for d in snapshot.drawn}
    for section, manager in env.managers.items():
        for name, why in _kept(manager):
            if why or (section, name) not in again:
                found.append(f"{section}.{name}{why}")
    other = _differing(env.sim.engine.model, snapshot.model)
    if other:
        found.insert(0, f"the scene is another one: its {', '.join(other)} differ")
    return found


def _kept(manager: Manager[Any]) -> Iterator[tuple[str, str]]:
    """Terms that keep something between steps, and what, where it is not the term's own."""
    if not len(manager):
        return
    state = manager.state_dict()
    for name in manager.terms:
        if _any(state["terms"].get(name)):
            yield name, ""
        always = getattr(manager.terms[name].cfg, "interval_step", None) == 1
        for key, what in _EXTRAS.items():
            if _any(state.get(key, {}).get(name)) and not (always and key == "timers"):
                yield name, f": {what}"


def _any(value: Any) -> bool:
    return bool(len(value)) if hasattr(value, "__len__") else value is not None


def _differing(here: mujoco.MjModel, there: mujoco.MjModel) -> list[str]:
    """Arrays of the model, and numbers of its options, that are not the same."""
    found = []
    for a, b, prefix in ((here, there, ""), (here.opt, there.opt, "opt.")):
        for name in dir(a):
            own = name.startswith("_") or name == "signature"  # one of each compilation
            value = None if own else getattr(a, name)
            if isinstance(value, (np.ndarray, int, float)) and not _same(value, getattr(b, name)):
                found.append(prefix + name)
    return found


def _same(a: Any, b: Any) -> bool:
    return np.array_equal(a, b, equal_nan=np.asarray(a).dtype.kind == "f")
