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
    found: dict[str, Any] = {
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
    sections = [section for section in SECTIONS if section not in _NO_MDP]
    found |= {section: _terms(section, getattr(cfg, section)) for section in sections}
    seen = {name: term for name, term in cfg.observations.items() if term.group == group}
    found["observations"] = _terms("observations", seen)
    plain: dict[str, Any] = _plain(found)
    return plain


def _terms(section: str, terms: Mapping[str, TermCfg]) -> dict[str, Any]:
    """Terms with their defaults filled in, and their order."""
    found: dict[str, Any] = {name: _term(section, term) for name, term in terms.items()}
    return {**found, "(order)": list(terms)} if len(terms) > 1 else found


def _term(section: str, cfg: TermCfg) -> dict[str, Any]:
    checked, _ = check_term(SECTIONS[section], cfg, section)
    params, takes = dict(cfg.params), dict.fromkeys(cfg.params, "given")
    if checked is not None:
        known = checked.spec.params.items()
        usual = {n: p.default for n, p in known if p.default is not p.empty}
        params = usual | checked.values
        takes = {n: _given(n, params, usual) for n in params}
    others = {f.name for f in dataclasses.fields(cfg)} - {"func", "params"}
    fields = {name: getattr(cfg, name) for name in sorted(others)}
    return {"func": cfg.func, **fields, "params": params, "takes": takes}


def _given(name: str, params: Mapping[str, Any], usual: Mapping[str, Any]) -> str:
    """Whether a parameter is ``default`` or ``given``."""
    same = name in usual and _plain(params[name]) == _plain(usual[name])
    return "default" if same else "given"


def _initial(env: BaseEnv) -> dict[str, Any]:
    """Initial joint positions, controls and poses of mocap bodies."""
    engine, row = env.sim.engine, env.sim.initial_row
    model = engine.model
    obj = mujoco.mjtObj
    found: dict[str, Any] = {}
    qpos, ctrl = row[engine.component("qpos")], row[engine.component("ctrl")]
    ends = [*model.jnt_qposadr[1:].tolist(), model.nq]
    for index, (start, end) in enumerate(zip(model.jnt_qposadr.tolist(), ends, strict=True)):
        name = mujoco.mj_id2name(model, obj.mjOBJ_JOINT, index) or f"#{index}"
        found[f"qpos of {name}"] = qpos[start:end]
    for index in range(model.nactuator):
        name = mujoco.mj_id2name(model, obj.mjOBJ_ACTUATOR, index) or f"#{index}"
        start = int(model.actuator_ctrladr[index])
        found[f"ctrl of {name}"] = ctrl[start : start + int(model.actuator_ctrlnum[index])]
    for index in np.flatnonzero(model.body_mocapid >= 0).tolist():
        at = int(model.body_mocapid[index])
        pos, quat = row[engine.component("mocap_pos")], row[engine.component("mocap_quat")]
        name = mujoco.mj_id2name(model, obj.mjOBJ_BODY, index) or f"#{index}"
        found[f"pose of {name}"] = [*pos[3 * at : 3 * at + 3], *quat[4 * at : 4 * at + 4]]
    return found


def _space(env: BaseEnv, group: str) -> dict[str, Any]:
    """The columns of actions and observations."""
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
    switched = env.cfg.enable_corruption
    noisy = any(t.noise is not None for t in env.cfg.observations.values() if t.group == group)
    return noisy and (switched if isinstance(switched, bool) else switched.get(group, True))


def _plain(value: Any) -> Any:
    """A value as mappings, lists, numbers and strings; empty values of mappings are left out."""
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
