"""Tables of `show` about a built environment: timing, model, spaces, terms, flat vectors."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

import numpy as np

from embodichain.cli.results.terms import SECTION_OF
from embodichain.lab.gym.envs.cfg import NO_LIMIT

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["printed_rows", "task_tables"]

Rows = list[dict[str, Any]]
_JUDGING = ("rewards", "terminations", "metrics")
_SECTIONS = (*_JUDGING, *(name for name in SECTION_OF.values() if name not in _JUDGING))
"""Sections of terms in the order of the tables: first what a learner is judged by."""
_ALWAYS = ("term", "func", "shape", "weight", "kind", "reduce", "group", "params")
"""Columns of terms that are shown even if every value is the default."""
_NO_LIMIT = 1e9
"""Limits of a drive from this value on are none, in any unit."""


def task_tables(resolved: Resolved) -> dict[str, Any]:
    """Compile a task's scene, build and close its environment; return title -> table.

    What people ask for is first: times, columns, rewards, terminations; then the scene.
    """
    from embodichain.config.environments.factory import make_env
    from embodichain.config.resolved import compile_scene_of

    compiled_scene = compile_scene_of(resolved)
    env = make_env(resolved.changed(num_envs=1), compiled_scene=compiled_scene)
    try:
        return {**_task_tables(env, resolved), **_scene_tables(env)}
    finally:
        env.close()


def _task_tables(env: BaseEnv, resolved: Resolved) -> dict[str, Any]:
    """What a learner meets: times, columns, what is rewarded and what ends an episode."""
    return {
        "timing": {**_timing(env), "environments": resolved.tree["num_envs"]},
        "spaces": _spaces(env),
        "action vector": _action_vector(env),
        "observation vector": _observation_vector(env),
        **{section: _terms(env, section) for section in _SECTIONS},
        "sensors": _sensors(env),
        "expert": _steps(env),
        "training": _training(resolved),
    }


def _scene_tables(env: BaseEnv) -> dict[str, Any]:
    """What is simulated."""
    model = env.sim.scene.model
    return {
        "bodies": _bodies(model),
        "joints": _joints(model),
        "actuators": _actuators(model),
        "drives": list(_drives(env)),
        "attached files": _attached(env),
        "names of links": _names_of_links(env),
        "grippers": _grippers(env),
        "self-collision": _self_collision(env),
        "surroundings": _surroundings(env),
        "lights": _lights(model),
        "cameras": _cameras(model, env.sim.sim_config.views),
        "notes on files": _notes(env),
        "initial poses": _poses(env),
        "initial qpos": _qpos(env),
    }


def _training(resolved: Resolved) -> dict[str, Any]:
    """The training that `train` starts without further keys: suggestions, and what follows.

    Empty for a task that suggests no training.
    """
    from embodichain.config.keys.algorithms import DEFAULT_ALGORITHM
    from embodichain.config.learning_scale import scale_learning

    suggested = resolved.tree["task"].get("suggested") or {}
    training = suggested.get("train")
    if not training:
        return {}
    algo = {"name": DEFAULT_ALGORITHM, **(training.get("algo") or {})}
    num_envs = training.get("num_envs") or 1
    total_timesteps = training.get("total_timesteps")
    scale = scale_learning(algo, num_envs, total_timesteps)
    facts = {"algo": algo["name"], "num_envs": num_envs, "total_timesteps": total_timesteps}
    for key, value in scale.chosen.items():
        facts[f"algo.{key}"] = value
    if scale.reason:
        facts["because"] = scale.reason
    return facts


def printed_rows(title: str, rows: Rows) -> Rows:
    """Return the rows of a table as they are printed; JSON has all of them.

    Of terms, columns in which every value is the default are left out. Columns of an observation
    that belong to the same link share a row.

    Args:
        title: The table's title.
        rows: Its rows.
    """
    if title == "observation vector":
        return _join_columns(rows)
    if title in _SECTIONS:
        return _without_defaults(title, rows)
    return rows


def _join_columns(rows: Rows) -> Rows:
    """One row for neighbouring columns that differ in their number alone."""
    joined: Rows = []
    alike = itertools.groupby(rows, key=lambda row: {**row, "columns": ""})
    for _, group in alike:
        columns = list(group)
        row = dict(columns[0])
        if len(columns) > 1:
            row["columns"] = f"{row['columns']} to {columns[-1]['columns']}"
        joined.append(row)
    return joined


def _without_defaults(section: str, rows: Rows) -> Rows:
    """Rows of terms without the columns in which every value is the default."""
    from embodichain.lab.gym.envs.cfg import EnvCfg, TermCfg

    cfg_class = get_args(get_type_hints(EnvCfg)[section])[1]
    defaults: dict[str, Any] = {}
    if issubclass(cfg_class, TermCfg):
        defaults = vars(cfg_class())
    columns: list[str] = []
    for name in dict.fromkeys(itertools.chain.from_iterable(rows)):
        is_always_shown = name in _ALWAYS or (section, name) == ("events", "mode")
        if is_always_shown or any(row.get(name) != defaults.get(name) for row in rows):
            columns.append(name)
    columns.sort(key=lambda name: name == "params")  # the longest last
    return [{name: row.get(name) for name in columns} for row in rows]


def _steps(env: BaseEnv) -> Rows:
    """The steps of the expert, and how many motions and other instructions each consists of."""
    from embodichain.lab.gym.expert.program import step_rows

    return step_rows(env.cfg.expert)


def _timing(env: BaseEnv) -> dict[str, Any]:
    limit = env.max_episode_steps
    episode = f"{limit} control steps = {limit * env.step_dt:g} s"
    if limit >= NO_LIMIT:  # only a termination ends an episode
        episode = "no limit"
    return {
        "physics step": f"{env.physics_dt:g} s",
        "control step": f"{env.step_dt:g} s ({env.sim_steps_per_control} physics steps)",
        "episode": episode,
        "seed": env.seed_value,
    }


# -- the model -------------------------------------------------------------------------------------


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
    """What moves a body relative to its parent."""
    if model.body_mocapid[body] >= 0:
        return "code (mocap)"
    names = [model.joint(i).name for i in np.flatnonzero(model.jnt_bodyid == body)]
    return ", ".join(names) or "its parent"


def _joints(model: Any) -> Rows:
    import mujoco

    return [
        {
            "joint": joint.name,
            "type": mujoco.mjtJoint(int(joint.type[0])).name.removeprefix("mjJNT_"),
            "range": joint.range.tolist() if joint.limited[0] else "no limit",
            "damping": float(joint.damping[0]),
            "armature": float(joint.armature[0]),
            "friction": float(joint.frictionloss[0]),
        }
        for joint in map(model.joint, range(model.njnt))
    ]


def _actuators(model: Any) -> Rows:
    from embodichain.lab.sim.compiler.robot.actuator_summary import describe_actuators

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
    """The lower and upper limit of a value."""
    if limits is None:
        return "no limit"
    return [float(limit) for limit in limits]


def _ranges(limits: Any) -> Any:
    """One range, or one for each input of an actuator that has several."""
    if len(limits) == 1 or not any(limits):
        return _range(limits[0])
    return [_range(input_limits) for input_limits in limits]


def _articulations(env: BaseEnv) -> dict[str, Any]:
    """Uid -> parsed file."""
    assets = {**env.sim.robots, **env.sim.articulations}
    return {uid: asset.parsed for uid, asset in assets.items()}


def _drives(env: BaseEnv) -> Iterator[dict[str, Any]]:
    """Gains and time constants of the drives; `max_velocity` bounds targets, not the joint."""
    from embodichain.lab.sim.compiler.robot.actuator_summary import (
        joint_inertia,
        time_constants,
        top_speeds,
    )

    for uid, parsed in _articulations(env).items():
        inertia = joint_inertia(parsed)
        speeds = top_speeds(parsed)
        times = time_constants(parsed)
        for i, name in enumerate(parsed.joint_names):
            if math.isnan(times[i]):  # a joint without a drive
                continue
            yield {
                "joint": f"{uid}/{name}",
                "stiffness": float(parsed.stiffness[i]),
                "damping": float(parsed.damping[i]),
                "max_effort": _limit(parsed.max_effort[i]),
                "inertia": _limit(float(f"{inertia[i]:.3g}")),
                "time constant s": _limit(float(f"{times[i]:.3g}")),
                "top speed by effort": _limit(float(f"{speeds[i]:.3g}")),
                "max_velocity of targets": _limit(parsed.max_velocity[i]),
            }


def _limit(value: float) -> float | str:
    if value < _NO_LIMIT:
        return float(value)
    return "no limit"


def _surroundings(env: BaseEnv) -> Rows:
    """Ground, sky, furniture and file of the section ``scene``."""
    cfg = env.sim.sim_config
    scene = cfg.scene
    ground: Any = "none"
    if cfg.has_ground:
        ground = scene.ground or {"type": "checker"}
    parts = {
        "fpath": scene.fpath,
        "sky": scene.sky,
        "pedestal": scene.pedestal,
        "table": scene.table,
        "terrain": scene.terrain,
        "ground": ground,
    }
    return [
        {"what": name, "params": _flow(value)} for name, value in parts.items() if value is not None
    ]


def _lights(model: Any) -> Rows:
    import mujoco

    return [
        {
            "light": light.name,
            "type": mujoco.mjtLightType(int(light.type[0])).name.removeprefix("mjLIGHT_").lower(),
            "position m": light.pos.tolist(),
            "direction": light.dir.tolist(),
            "colour": light.diffuse.tolist(),
            "shadow": bool(light.castshadow[0]),
        }
        for light in map(model.light, range(model.nlight))
    ]


def _cameras(model: Any, views: Mapping[str, Any]) -> Rows:
    """The cameras for pictures and videos; those of an entity are named ``uid/NAME``."""
    return [
        {
            "camera": camera.name,
            "on body": model.body(int(camera.bodyid[0])).name,
            "field of view deg": float(camera.fovy[0]),
            "view": _flow(views[camera.name]) if camera.name in views else "",
        }
        for camera in map(model.camera, range(model.ncam))
    ]


def _attached(env: BaseEnv) -> Rows:
    """Files fixed on links of robots, and the names of their joints."""
    rows = []
    for uid, parsed in _articulations(env).items():
        for name, cfg in getattr(parsed.cfg, "attach", {}).items():
            rows.append(
                {
                    "attached": f"{uid}/{name}",
                    "on": f"{uid}/{cfg.to}",
                    "file": cfg.fpath,
                    "joints": _names_under(name, parsed.joint_names),
                    "controls": _names_under(name, parsed.control_names),
                }
            )
    return rows


def _names_of_links(env: BaseEnv) -> Rows:
    """The further names that configs give links, sites and geoms."""
    return [
        {
            "name": f"{uid}/{name}",
            "kind": alias.kind,
            "stands for": ", ".join(alias.frames),
        }
        for uid, parsed in _articulations(env).items()
        for name, alias in parsed.aliases.items()
    ]


def _grippers(env: BaseEnv) -> Rows:
    """How the grippers that configs describe open and close."""
    return [
        {
            "gripper": f"{uid}/{part}",
            "open": _flow(gripper.open),
            "close": _flow(gripper.close),
            "force": gripper.force,
            "actuators": gripper.actuators,
        }
        for uid, parsed in _articulations(env).items()
        for part, gripper in getattr(parsed.cfg, "grippers", {}).items()
    ]


def _names_under(prefix: str, names: Iterable[str]) -> str:
    """The names that begin with a file's prefix, with commas."""
    return ", ".join(name for name in names if name.startswith(f"{prefix}/"))


def _self_collision(env: BaseEnv) -> Rows:
    """Which links of each robot and articulation collide with each other."""
    rows = []
    for uid, parsed in _articulations(env).items():
        collision = parsed.self_collision
        rows.append(
            {
                "entity": uid,
                "links collide": collision.rule,
                "overlap at the start": _pairs([*collision.overlapping, *collision.siblings]),
                "excluded": _pairs(collision.excluded),
                "included": _pairs(collision.included),
            }
        )
    return rows


def _pairs(pairs: Iterable[tuple[str, str]]) -> str:
    return ", ".join(f"{a} - {b}" for a, b in pairs)


def _notes(env: BaseEnv) -> Rows:
    """Changes to robots' files in compilation, and parts of them that were left out."""
    articulations = _articulations(env)
    rows = []
    for uid, parsed in articulations.items():
        rows += [{"entity": uid, "note": note} for note in parsed.all_notes]
    for uid, parsed in articulations.items():
        rows += [{"entity": uid, "note": hull.text} for hull in parsed.hulls]
    rows += [{"entity": "", "note": note} for note in env.sim.scene.notes]
    return rows


def _poses(env: BaseEnv) -> Rows:
    """The pose of each entity's root at a reset, before reset events, and its number in masks."""
    return [
        {
            "entity": uid,
            "number in masks": index.root_body_id,
            "position m": index.pos0.tolist(),
            "quaternion wxyz": index.quat0.tolist(),
        }
        for uid, index in env.sim.scene.entities.items()
    ]


def _qpos(env: BaseEnv) -> Rows:
    """The position of each joint at a reset, before reset events."""
    rows = []
    for uid, parsed in _articulations(env).items():
        for i, name in enumerate(parsed.joint_names):
            lower, upper = parsed.qpos_limits[i]
            rows.append(
                {
                    "entity": uid,
                    "joint": name,
                    "qpos": float(parsed.init_qpos[i]),
                    "lower": float(lower),
                    "upper": float(upper),
                }
            )
    return rows


# -- spaces and terms ------------------------------------------------------------------------------


def _spaces(env: BaseEnv) -> Rows:
    observations = _leaves(env.single_observation_space)
    spaces = [("action", env.single_action_space)]
    spaces += [(f"observation/{path}", space) for path, space in observations.items()]
    return [
        {
            "space": name,
            "shape": str(tuple(space.shape or ())),
            "type": str(space.dtype),
            "low": _bound(getattr(space, "low", None)),
            "high": _bound(getattr(space, "high", None)),
        }
        for name, space in spaces
    ]


def _bound(values: Any) -> Any:
    """One number if all are the same, else all."""
    if values is None or not np.size(values):
        return None
    first = float(np.ravel(values)[0])
    if not math.isfinite(first):
        return str(first)
    if np.all(values == first):
        return first
    return [float(value) for value in np.ravel(values)]


def _leaves(space: Any, path: str = "") -> dict[str, Any]:
    """Path -> space of the leaves of a dictionary of spaces."""
    if not hasattr(space, "spaces"):
        return {path: space}
    leaves: dict[str, Any] = {}
    for key, child in space.spaces.items():
        leaves |= _leaves(child, f"{path}/{key}" if path else key)
    return leaves


def _sensors(env: BaseEnv) -> Rows:
    rows = []
    for uid, cfg in env.cfg.sensors.items():
        values = _set_fields(cfg)
        values.pop("uid", None)
        sensor_type = values.pop("sensor_type", "")
        rows.append(
            {
                "sensor": uid,
                "type": sensor_type,
                "reads": ", ".join(cfg.readings()),
                "params": _flow(values),
            }
        )
    return rows


def _terms(env: BaseEnv, section: str) -> Rows:
    """The declared terms of one manager in order, with the fields that are set."""
    shapes = _shapes(env, section)
    rows = []
    for name, cfg in getattr(env.cfg, section).items():
        values = {field.name: getattr(cfg, field.name) for field in dataclasses.fields(cfg)}
        if section == "terminations":
            values["kind"] = cfg.ends_by
        func = values.pop("func")
        params = values.pop("params")
        row = {"term": name}
        row["func"] = func if isinstance(func, str) else f"{func.__module__}:{func.__qualname__}"
        if name in shapes:
            row["shape"] = shapes[name]
        for key, value in values.items():
            if value is not None:
                row[key] = _flow(value) if dataclasses.is_dataclass(value) else value
        if row.get("mode", "interval") != "interval":
            row.pop("interval_step", None)
        if section == "commands":
            row["columns"] = list(env.command_manager.names(name))
        row["params"] = _flow(params) if params else ""
        rows.append(row)
    return rows


def _shapes(env: BaseEnv, section: str) -> dict[str, str]:
    """The shape of each term's entry in one environment, or of its slice."""
    if section == "actions":
        slices = env.action_manager.slices
        return {name: f"({columns.stop - columns.start},)" for name, columns in slices.items()}
    if section == "observations":
        spaces = _leaves(env.single_observation_space)
        terms = env.cfg.observations.items()
        return {name: str(spaces[cfg.name or name].shape) for name, cfg in terms}
    if section == "commands" and env.cfg.commands:
        return {name: f"({len(env.command_manager.names(name))},)" for name in env.cfg.commands}
    return {}


def _set_fields(cfg: Any) -> dict[str, Any]:
    """The fields of a config that were set."""
    if isinstance(cfg, dict):
        return dict(cfg)
    values = {field.name: getattr(cfg, field.name) for field in dataclasses.fields(cfg)}
    return {key: value for key, value in values.items() if value not in (None, False, "")}


def _flow(value: Any) -> str:
    """A value as YAML on one line."""
    if dataclasses.is_dataclass(value):
        return _flow(_set_fields(value))
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if isinstance(value, str):
        return value
    return json.dumps(value, default=str)


def _action_vector(env: BaseEnv) -> Rows:
    """Each column of the action: what it moves, and the line from action to value."""
    from embodichain.lab.gym.envs.action_columns import action_columns

    return [
        {
            "column": index,
            "joint": column.name,
            "centre": column.about,
            "scale": column.scale,
            "clip": [column.low, column.high],
        }
        for index, column in enumerate(action_columns(env))
    ]


_MOST_COLUMNS = 64
"""Columns of an entry that are listed one by one; more of the same kind are one row."""


def _observation_vector(env: BaseEnv) -> Rows:
    """Each column of a group's flattened vector: its entry, what it belongs to, and its factor."""
    spaces = _leaves(env.single_observation_space)
    manager = env.observation_manager
    rows: Rows = []
    for group in manager.groups:
        start = 0
        for entry in manager.group_terms(group):
            count = math.prod(spaces[entry].shape)
            columns = manager.column_table(entry, count)
            stop = start + count
            places = [str(column) for column in range(start, stop)]
            if count > _MOST_COLUMNS and len(set(columns)) == 1:
                columns = columns[:1]
                places = [f"{start}:{stop}"]
            for place, (label, scale) in zip(places, columns, strict=True):
                rows.append(
                    {
                        "group": group,
                        "columns": place,
                        "term": entry,
                        "link or joint": label,
                        "scale": scale,
                    }
                )
            start = stop
    return rows
