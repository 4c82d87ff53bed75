"""`mdp_values`: the values that determine the MDP of an environment, besides the model.

Plain data for finding the differences of two environments. They do not depend on the number of
environments, the seed, or changes by a curriculum.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from embodichain.lab.gym.envs.cfg import TermCfg
from embodichain.lab.gym.envs.managers.terms.check import check_term
from embodichain.lab.gym.envs.managers.terms.registry import SECTIONS

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["mdp_values"]

_NO_MDP = ("metrics", "observations")
"""Sections that are left out, or reduced to one group."""


def mdp_values(env: BaseEnv, group: str = "policy") -> dict[str, Any]:
    """Return the values in the config that determine the MDP of an environment.

    The code of environment classes and terms is not part of it. Values that are zero, false or
    None are left out; `takes` of a term has all its parameters, each ``default`` or ``given``.

    Args:
        env: The environment.
        group: The observation group of the policy; others are left out.

    Returns:
        Section -> name -> values: ``timing``, ``initial`` (of joints, actuators and mocap bodies),
        ``space``, ``actions``, ``observations``, ``corruption``, ``commands``, ``events``,
        ``rewards``, ``terminations``, ``curriculum``, ``episode``, ``extensions``, ``id``.

    Raises:
        ValueError: If the group has no observation.
    """
    cfg = env.cfg
    values: dict[str, Any] = {
        "timing": {"sim_steps_per_control": env.sim_steps_per_control},
        "initial": _initial(env),
        "space": _space(env, group),
        "corruption": _corruption(env, group),
        "episode": {
            "max_episode_steps": cfg.max_episode_steps,
            "ignore_terminations": cfg.ignore_terminations,
        },
        "extensions": cfg.extensions,
        "id": cfg.id,
    }
    for section in SECTIONS:
        if section not in _NO_MDP:
            values[section] = _terms(section, getattr(cfg, section))
    for name, term in env.action_manager.terms.items():
        _fill_in(values["actions"][name], getattr(term.instance, "filled_in", {}))
    for name, event in env.event_manager.terms.items():
        _fit(values["events"][name], getattr(event.instance, "fitted", {}))
    observations = {name: term for name, term in cfg.observations.items() if term.group == group}
    values["observations"] = _terms("observations", observations)
    return _plain(values)


def _terms(section: str, terms: Mapping[str, TermCfg]) -> dict[str, Any]:
    """Return terms with their defaults filled in, and their order."""
    values: dict[str, Any] = {name: _term(section, term) for name, term in terms.items()}
    if len(terms) > 1:
        values["(order)"] = list(terms)
    return values


def _term(section: str, cfg: TermCfg) -> dict[str, Any]:
    names = {field.name for field in dataclasses.fields(cfg)} - {"func", "params"}
    other_fields = {name: getattr(cfg, name) for name in sorted(names)}
    checked, _ = check_term(SECTIONS[section], cfg, section)
    if checked is None:
        params = dict(cfg.params)
        takes = dict.fromkeys(params, "given")
    else:
        defaults = {
            name: param.default
            for name, param in checked.spec.params.items()
            if param.default is not param.empty
        }
        params = defaults | checked.values
        takes = {}
        for name, value in params.items():
            is_default = name in defaults and _plain(value) == _plain(defaults[name])
            takes[name] = "default" if is_default else "given"
    return {"func": cfg.func, **other_fields, "params": params, "takes": takes}


def _fill_in(term: dict[str, Any], params: Mapping[str, Any]) -> None:
    """Add parameters that an action has taken from its robot's config."""
    term["params"] = {**term["params"], **params}
    term["takes"] = {**term["takes"], **dict.fromkeys(params, "given")}


def _fit(term: dict[str, Any], params: Mapping[str, Any]) -> None:
    """Replace parameters of an event by what they have changed, if anything."""
    changed = {key: value for key, value in params.items() if value is not None}
    for part in ("params", "takes"):
        others = {key: value for key, value in term[part].items() if key not in params}
        term[part] = others | (changed if part == "params" else dict.fromkeys(changed, "given"))


def _initial(env: BaseEnv) -> dict[str, Any]:
    """Return initial joint positions, controls and poses of mocap bodies."""
    engine = env.sim.engine
    row = env.sim.initial_row
    qpos = row[engine.component("qpos")]
    ctrl = row[engine.component("ctrl")]
    mocap_pos = row[engine.component("mocap_pos")].reshape(-1, 3)
    mocap_quat = row[engine.component("mocap_quat")].reshape(-1, 4)

    model = engine.model
    values: dict[str, Any] = {}
    starts = model.jnt_qposadr.tolist()
    ends = [*starts[1:], model.nq]
    for joint, (start, end) in enumerate(zip(starts, ends, strict=True)):
        values[f"qpos of {_name(model, mujoco.mjtObj.mjOBJ_JOINT, joint)}"] = qpos[start:end]
    for actuator in range(model.nactuator):
        start = int(model.actuator_ctrladr[actuator])
        end = start + int(model.actuator_ctrlnum[actuator])
        values[f"ctrl of {_name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, actuator)}"] = ctrl[start:end]
    for body in np.flatnonzero(model.body_mocapid >= 0).tolist():
        mocap = int(model.body_mocapid[body])
        pose = [*mocap_pos[mocap], *mocap_quat[mocap]]
        values[f"pose of {_name(model, mujoco.mjtObj.mjOBJ_BODY, body)}"] = pose
    return values


def _name(model: mujoco.MjModel, obj_type: mujoco.mjtObj, index: int) -> str:
    """Return the name of an element, or its number if it has none."""
    return mujoco.mj_id2name(model, obj_type, index) or f"#{index}"


def _space(env: BaseEnv, group: str) -> dict[str, Any]:
    """Return the columns of actions and observations."""
    space: Any = env.single_action_space
    columns = env.observation_manager.columns(group)
    return {
        "actions": list(env.action_manager.names),
        "low actions": getattr(space, "low", None),
        "high actions": getattr(space, "high", None),
        "observations": [f"{name} ({width})" for name, width in columns.items()],
    }


def _corruption(env: BaseEnv, group: str) -> bool:
    """Whether the noise of the group's observations is on, if they have any."""
    terms = env.cfg.observations.values()
    if not any(term.noise is not None for term in terms if term.group == group):
        return False
    enabled = env.cfg.enable_corruption
    if isinstance(enabled, bool):
        return enabled
    return enabled.get(group, True)


def _plain(value: Any) -> Any:
    """Return mappings, lists, numbers and strings; empty values of mappings are left out."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        plain = {str(key): _plain(item) for key, item in value.items()}
        return {key: item for key, item in plain.items() if item or item == []}
    if hasattr(value, "tolist"):  # numpy, torch
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if callable(value):
        return f"{getattr(value, '__module__', '?')}:{getattr(value, '__qualname__', '?')}"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # JSON has no such number
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    return type(value).__name__
