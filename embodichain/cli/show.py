"""`embodichain show`: a task as it would be run: config, scene, spaces, terms, observation vector.

It builds the environment once and prints what was built, so that nothing can differ.
"""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.cli import exits
from embodichain.cli.arguments import VerbParser, add_common, print_json, split_overrides
from embodichain.cli.tables import print_facts, print_table
from embodichain.cli.verbs import VERBS

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["main"]

Rows = list[dict[str, Any]]
_MANAGERS = ("actions", "events", "observations", "rewards", "terminations", "metrics")


def main(arguments: list[str]) -> int:
    """Print everything, or only the resolved config."""
    parser = VerbParser(VERBS["show"])
    parser.add_argument("overrides", nargs="*", metavar="key=value")
    parser.add_argument("--config", action="store_true", help="only the resolved config, as YAML")
    add_common(parser, config_dir=True)
    options = parser.parse(arguments)
    from embodichain.config.frozen import dump_yaml, thaw
    from embodichain.config.resolved import resolve

    resolved = resolve(split_overrides(options.overrides), "run", config_dir=options.config_dir)
    text = dump_yaml(resolved.tree)
    if options.config:
        if options.json:
            print_json({"config": thaw(resolved.tree)})
        else:
            sys.stdout.write(text)
        return exits.OK
    facts = _build(resolved)
    if options.json:
        print_json({"task": resolved.task_name, "config": thaw(resolved.tree), **facts})
        return exits.OK
    sys.stdout.write(f"# {resolved.task_name}, resolved\n{text}\n")
    for title, rows in facts.items():
        if isinstance(rows, dict):
            print_facts(title, rows.items())
        else:
            print_table(title, rows)
    return exits.OK


def _build(resolved: Resolved) -> dict[str, Any]:
    """Every table of one environment."""
    import dataclasses

    from embodichain.config.factory import make_env
    from embodichain.config.frozen import freeze

    one = dataclasses.replace(resolved, tree=freeze({**resolved.tree, "num_envs": 1}))
    env = make_env(one)
    try:
        model = env.sim.scene.model
        return {
            "timing": {**_timing(env), "environments": resolved.tree["num_envs"]},
            "bodies": _bodies(model),
            "joints": _joints(model),
            "actuators": _actuators(model),
            "spaces": _spaces(env),
            **{name: _terms(env, name) for name in _MANAGERS},
            "observation vector": _vector(env),
        }
    finally:
        env.close()


def _timing(env: BaseEnv) -> dict[str, Any]:
    limit = env.max_episode_steps
    endless = limit >= 2**31 - 1
    return {
        "physics step": f"{env.physics_dt:g} s",
        "control step": f"{env.step_dt:g} s ({env.sim_steps_per_control} physics steps)",
        "episode": "no limit" if endless else f"{limit} control steps = {limit * env.step_dt:g} s",
        "seed": env.seed_value,
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
    rows = []
    for index in range(model.nu):
        limited = bool(model.actuator_forcelimited[index])
        rows.append(
            {
                "actuator": model.actuator(index).name,
                "joint": model.joint(int(model.actuator_trnid[index, 0])).name,
                "stiffness": float(model.actuator_gainprm[index, 0]),
                "effort": _floats(model.actuator_forcerange[index]) if limited else "no limit",
            }
        )
    return rows


def _floats(values: Any) -> list[float]:
    return [float(value) for value in values]


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
    return first if np.all(values == first) else _floats(np.ravel(values))


def _leaves(space: Any, path: str = "") -> list[tuple[str, Any]]:
    if not hasattr(space, "spaces"):
        return [(path, space)]
    inner = ((f"{path}/{key}" if path else key, child) for key, child in space.spaces.items())
    return [leaf for where, child in inner for leaf in _leaves(child, where)]


def _terms(env: BaseEnv, section: str) -> Rows:
    """The declared terms of one manager, in their order, with what they were given."""
    import dataclasses

    rows = []
    for name, cfg in getattr(env.cfg, section).items():
        values = {f.name: getattr(cfg, f.name) for f in dataclasses.fields(cfg)}
        func, params = values.pop("func"), values.pop("params")
        rest = {key: value for key, value in values.items() if value is not None}
        rows.append({"term": name, "func": func, **rest, "params": _params(params)})
    return rows


def _params(params: dict[str, Any]) -> str:
    import json

    return json.dumps(params, default=_short) if params else ""


def _short(value: Any) -> Any:
    """A config as the fields of it that were set."""
    import dataclasses

    if not dataclasses.is_dataclass(value):
        return str(value)
    set_values = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    return {key: item for key, item in set_values.items() if item not in (None, False, "")}


def _vector(env: BaseEnv) -> Rows:
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
