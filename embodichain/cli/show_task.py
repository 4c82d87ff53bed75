"""What `show` says of a built environment: timing, model, spaces, terms, flat vectors."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

import numpy as np

from embodichain.cli.terms import SECTION_OF

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["for_people", "task_tables"]

Rows = list[dict[str, Any]]
_SECTIONS = tuple(SECTION_OF.values())
_DETAIL = "params"
_ALWAYS = ("term", "func", "shape", "weight", "kind", "reduce", "group", _DETAIL)


def task_tables(resolved: Resolved) -> dict[str, Any]:
    """Every table of a task's environment, by title; the environment is built and closed."""
    from embodichain.config.factory import make_env

    env = make_env(resolved.changed(num_envs=1))
    try:
        return {
            "timing": {**_timing(env), "environments": resolved.tree["num_envs"]},
            **_model_tables(env),
            "spaces": _spaces(env),
            "sensors": _sensors(env),
            **{section: _terms(env, section) for section in _SECTIONS},
            "action vector": _action_vector(env),
            "observation vector": _observation_vector(env),
        }
    finally:
        env.close()


def for_people(section: str, rows: Rows) -> Rows:
    """Rows without the columns of terms in which every value is the default.

    Args:
        section: The table's title.
        rows: What it holds.
    """
    if section not in _SECTIONS:
        return rows
    defaults = _defaults(section)
    names = list(dict.fromkeys(name for row in rows for name in row))
    shown = [
        name
        for name in names
        if name in _ALWAYS
        or (section, name) == ("events", "mode")
        or any(row.get(name) != defaults.get(name) for row in rows)
    ]
    rows = [{name: row.get(name) for name in shown if name != _DETAIL} | _last(row) for row in rows]
    for row in rows:
        if "interval_step" in row and row.get("mode") != "interval":
            row["interval_step"] = None
    return rows


def _last(row: dict[str, Any]) -> dict[str, Any]:
    return {_DETAIL: row[_DETAIL]} if _DETAIL in row else {}


def _defaults(section: str) -> dict[str, Any]:
    """Field -> default of what a section's terms are declared with."""
    from embodichain.lab.gym.envs.cfg import EnvCfg, TermCfg

    hints = get_type_hints(EnvCfg)
    term = get_args(hints[section])[1]
    return vars(term()) if issubclass(term, TermCfg) else {}


def _timing(env: BaseEnv) -> dict[str, Any]:
    limit = env.max_episode_steps
    endless = limit >= 2**31 - 1
    return {
        "physics step": f"{env.physics_dt:g} s",
        "control step": f"{env.step_dt:g} s ({env.sim_steps_per_control} physics steps)",
        "episode": "no limit" if endless else f"{limit} control steps = {limit * env.step_dt:g} s",
        "seed": env.seed_value,
    }


def _spaces(env: BaseEnv) -> Rows:
    rows: Rows = [{"space": "action", **_box(env.single_action_space)}]
    for path, space in _leaves(env.single_observation_space):
        rows.append({"space": f"observation/{path}", **_box(space)})
    return rows


def _box(space: Any) -> dict[str, Any]:
    low, high = getattr(space, "low", None), getattr(space, "high", None)
    return {
        "shape": str(tuple(space.shape or ())),
        "type": str(space.dtype),
        "low": _bound(low),
        "high": _bound(high),
    }


def _bound(values: Any) -> Any:
    """One number where all are the same, else all."""
    if values is None or not np.size(values):
        return None
    first = float(np.ravel(values)[0])
    if not math.isfinite(first):
        return str(first)
    return first if np.all(values == first) else [float(value) for value in np.ravel(values)]


def _leaves(space: Any, path: str = "") -> list[tuple[str, Any]]:
    if not hasattr(space, "spaces"):
        return [(path, space)]
    inner = ((f"{path}/{key}" if path else key, child) for key, child in space.spaces.items())
    return [leaf for where, child in inner for leaf in _leaves(child, where)]


def _sensors(env: BaseEnv) -> Rows:
    rows = []
    for uid, cfg in env.cfg.sensors.items():
        values = _set_fields(cfg)
        values.pop("uid", None)
        rows.append({"sensor": uid, "type": values.pop("sensor_type", ""), "params": _yaml(values)})
    return rows


def _terms(env: BaseEnv, section: str) -> Rows:
    """The declared terms of one manager, in their order, with what they were given."""
    cfgs = getattr(env.cfg, section)
    shapes = _shapes(env, section)
    rows = []
    for name, cfg in cfgs.items():
        values = {f.name: getattr(cfg, f.name) for f in dataclasses.fields(cfg)}
        func, params = values.pop("func"), values.pop("params")
        shape = {"shape": shapes[name]} if name in shapes else {}
        rest = {key: _plain(value) for key, value in values.items() if value is not None}
        if section == "commands":
            rest["columns"] = list(env.command_manager.names(name))
        rows.append({"term": name, "func": _name(func), **shape, **rest, "params": _yaml(params)})
    return rows


def _plain(value: Any) -> Any:
    return _flow(value) if dataclasses.is_dataclass(value) else value


def _name(func: Any) -> str:
    return func if isinstance(func, str) else f"{func.__module__}:{func.__qualname__}"


def _shapes(env: BaseEnv, section: str) -> dict[str, str]:
    """What one environment has of each term: the shape of its entry, the width of its slice."""
    if section == "actions":
        slices = env.action_manager.slices
        return {name: f"({columns.stop - columns.start},)" for name, columns in slices.items()}
    if section == "observations":
        shapes = {path: str(space.shape) for path, space in _leaves(env.single_observation_space)}
        terms = env.cfg.observations.items()
        return {name: shapes[cfg.name or name] for name, cfg in terms}
    if section == "commands" and env.cfg.commands:
        return {name: f"({len(env.command_manager.names(name))},)" for name in env.cfg.commands}
    return {}


def _set_fields(cfg: Any) -> dict[str, Any]:
    """A config as the fields of it that were set."""
    if isinstance(cfg, dict):
        return dict(cfg)
    values = {f.name: getattr(cfg, f.name) for f in dataclasses.fields(cfg)}
    return {key: item for key, item in values.items() if item not in (None, False, "")}


def _yaml(value: Any) -> str:
    """Parameters as YAML would write them, on one line; nothing for none."""
    if isinstance(value, dict) and not value:
        return ""
    return _flow(value)


def _flow(value: Any) -> str:
    if dataclasses.is_dataclass(value):
        return _flow(_set_fields(value))
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_flow, value)) + "]"
    return value if isinstance(value, str) else json.dumps(value, default=str)


def _action_vector(env: BaseEnv) -> Rows:
    """What each column of the action moves."""
    manager = env.action_manager
    columns = zip(manager.names, manager.low, manager.high, strict=True)
    return [
        {"column": index, "moves": name, "low": float(low), "high": float(high)}
        for index, (name, low, high) in enumerate(columns)
    ]


def _observation_vector(env: BaseEnv) -> Rows:
    """Which columns of a group's flattened vector hold which entry."""
    widths = {path: math.prod(s.shape) for path, s in _leaves(env.single_observation_space)}
    rows: Rows = []
    for group in env.observation_manager.groups:
        start = 0
        for entry in env.observation_manager.group_terms(group):
            stop = start + widths[entry]
            rows.append({"group": group, "columns": f"{start}:{stop}", "entry": entry})
            start = stop
    return rows


def _model_tables(env: BaseEnv) -> dict[str, Rows]:
    """Tables by title."""
    model = env.sim.scene.model
    return {
        "bodies": _bodies(model),
        "joints": _joints(model),
        "actuators": _actuators(model),
        "drives": _drives(env),
        "cameras": _cameras(model),
        "notes on files": _notes(env),
        "initial poses": _poses(env),
        "initial qpos": _qpos(env),
    }


def _bodies(model: Any) -> Rows:
    return [
        {
            "body": body.name,
            "parent": model.body(int(model.body_parentid[body.id])).name,
            "mass kg": float(model.body_mass[body.id]),
            "geoms": int(model.body_geomnum[body.id]),
            "moved by": _mover(model, body.id),
        }
        for body in map(model.body, range(1, model.nbody))
    ]


def _mover(model: Any, body: int) -> str:
    if model.body_mocapid[body] >= 0:
        return "code (mocap)"
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    names = (model.joint(first + i).name for i in range(count))
    return ", ".join(names) or "its parent"


def _joints(model: Any) -> Rows:
    import mujoco

    rows = []
    for index in range(model.njnt):
        dof = int(model.jnt_dofadr[index])
        limited = bool(model.jnt_limited[index])
        rows.append(
            {
                "joint": model.joint(index).name,
                "type": mujoco.mjtJoint(int(model.jnt_type[index])).name.removeprefix("mjJNT_"),
                "range": _floats(model.jnt_range[index]) if limited else "no limit",
                "damping": float(model.dof_damping[dof]),
                "armature": float(model.dof_armature[dof]),
                "friction": float(model.dof_frictionloss[dof]),
            }
        )
    return rows


def _actuators(model: Any) -> Rows:
    from embodichain.lab.sim.compiler.actuator_summary import describe_actuators

    return [
        {
            "actuator": actuator.name,
            "kind": actuator.kind,
            "on": actuator.target,
            "gear": actuator.gear,
            "gain": actuator.gain,
            "stiffness": actuator.stiffness,
            "damping": actuator.damping,
            "ctrl range": _ranges(actuator.ctrlrange),
            "force range": _range(actuator.forcerange),
        }
        for actuator in describe_actuators(model)
    ]


def _range(limits: Any) -> Any:
    return "no limit" if limits is None else _floats(limits)


def _ranges(limits: Any) -> Any:
    """One range, or one for each input of an actuator that has several."""
    if len(limits) == 1 or not any(limits):
        return _range(limits[0])
    return [_range(one) for one in limits]


def _notes(env: BaseEnv) -> Rows:
    """What the compiler changed or left out of robots' files."""
    articulations = {**env.sim.robots, **env.sim.articulations}
    return [
        {"entity": uid, "note": note}
        for uid, asset in articulations.items()
        for note in asset.parsed.notes
    ]


def _drives(env: BaseEnv) -> Rows:
    """Gains of the drives, and how fast they are; `max_velocity` bounds targets, not the joint."""
    from embodichain.lab.sim.compiler.actuator_summary import (
        joint_inertia,
        time_constants,
        top_speeds,
    )

    rows = []
    for uid, asset in {**env.sim.robots, **env.sim.articulations}.items():
        parsed = asset.parsed
        inertia, speeds, times = (
            joint_inertia(parsed),
            top_speeds(parsed),
            time_constants(parsed),
        )
        for i, name in enumerate(parsed.joint_names):
            if not math.isnan(times[i]):
                rows.append(
                    {
                        "joint": f"{uid}/{name}",
                        "stiffness": float(parsed.stiffness[i]),
                        "damping": float(parsed.damping[i]),
                        "max_effort": _limit(parsed.max_effort[i]),
                        "inertia": _short(inertia[i]),
                        "time constant s": _short(times[i]),
                        "top speed by effort": _short(speeds[i]),
                        "max_velocity of targets": _limit(parsed.max_velocity[i]),
                    }
                )
    return rows


def _limit(value: float) -> float | str:
    return float(value) if value < 1e9 else "no limit"


def _short(value: float) -> float | str:
    return float(f"{value:.3g}") if math.isfinite(value) else "no limit"


def _cameras(model: Any) -> Rows:
    """What pictures and films can be taken with; an entity's are called ``uid/NAME``."""
    return [
        {
            "camera": camera.name,
            "on body": model.body(int(model.cam_bodyid[camera.id])).name,
            "field of view deg": float(model.cam_fovy[camera.id]),
        }
        for camera in map(model.camera, range(model.ncam))
    ]


def _poses(env: BaseEnv) -> Rows:
    """Where each entity's root is put at a reset, before reset events."""
    return [
        {"entity": uid, "position m": _floats(index.pos0), "quaternion wxyz": _floats(index.quat0)}
        for uid, index in env.sim.scene.entities.items()
    ]


def _qpos(env: BaseEnv) -> Rows:
    """Where each joint is put at a reset, before reset events."""
    articulations = {**env.sim.robots, **env.sim.articulations}
    return [
        {
            "entity": uid,
            "joint": name,
            "qpos": float(qpos),
            "lower": float(low),
            "upper": float(high),
        }
        for uid, asset in articulations.items()
        for name, qpos, (low, high) in zip(
            asset.parsed.joint_names, asset.parsed.init_qpos, asset.parsed.qpos_limits, strict=True
        )
    ]


def _floats(values: Any) -> list[float]:
    return [float(value) for value in values]
