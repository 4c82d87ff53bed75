"""Converts a gym config to an `EnvCfg`, for scripts that use the Python API."""

from __future__ import annotations

import importlib
import inspect
import logging
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any

from embodichain.compat.gym_config.conversion import Conversion, convert
from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.gym.envs.managers.terms.registry import SECTIONS, TERMS, Kind
from embodichain.lab.gym.utils.registration import REGISTERED_ENVS
from embodichain.lab.sim.cfg import RenderCfg, SimulationManagerCfg
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.fields.type_errors import from_dict

__all__ = ["FUNCTORS", "checked_cfg", "config_to_cfg"]

_log = logging.getLogger(__name__)
_SIM_KEYS = ("headless", "gpu_id", "arena_space")
_OURS = (*_SIM_KEYS, "device", "renderer", "render_cfg")
"""Keys of a `SimulationManagerCfg` that have no equivalent in YAML."""
FUNCTORS: Mapping[str, Kind] = {
    section: SECTIONS[section] for section in ("events", "observations", "rewards", "actions")
}
"""Section of `env` -> kind of its terms."""


def config_to_cfg(
    config: Mapping[str, Any], manager_modules: Sequence[str | ModuleType] | None = None
) -> EnvCfg:
    """Convert a gym config to the config of an environment; log what is left out.

    Args:
        config: Its content; not changed.
        manager_modules: Modules, or their names, in which functors are looked up by name.

    Returns:
        The config; its terms and scene are checked when an environment is built.

    Raises:
        ConfigError: Lists every unknown key and wrong type, with its path in the gym config.
    """
    modules: list[ModuleType] = []
    for module in manager_modules or ():
        if isinstance(module, str):
            module = importlib.import_module(module)
        modules.append(module)
    conversion = convert(_with_modules(config, modules), tuple(REGISTERED_ENVS))
    cfg = checked_cfg(conversion)
    run = cfg.suggested.run
    cfg.num_envs = run.get("num_envs", 1)
    cfg.seed = run.get("seed")
    cfg.sim_cfg = _sim_cfg(config)
    for note in conversion.notes:
        if note.path not in _OURS:
            _log.warning("%s", note)
    return cfg


def checked_cfg(conversion: Conversion) -> EnvCfg:
    """Return the config that a converted task declares.

    Raises:
        ConfigError: The conversion or the task has mistakes; paths are the gym config's.
    """
    if conversion.problems:
        raise ConfigError(conversion.problems)
    try:
        return from_dict(EnvCfg, conversion.task)
    except ConfigError as error:
        problems: list[Problem] = []
        for problem in error.problems:
            origin = conversion.origin(tuple(problem.path.split(".")))
            problems.append(Problem(".".join(origin), problem.message, problem.hint))
        raise ConfigError(problems) from error


def _sim_cfg(config: Mapping[str, Any]) -> SimulationManagerCfg:
    """The config of the simulation, from the keys that have no equivalent in YAML."""
    values = {key: config[key] for key in _SIM_KEYS if config.get(key) is not None}
    if config.get("device") is not None:
        values["sim_device"] = config["device"]
    render = dict(config.get("render_cfg") or {})
    renderer = config.get("renderer", render.get("renderer"))
    if renderer is not None:
        values["render_cfg"] = RenderCfg(renderer=renderer)
    return SimulationManagerCfg(**values)


def _with_modules(config: Mapping[str, Any], modules: Sequence[ModuleType]) -> dict[str, Any]:
    """A copy with ``module:function`` for functors that are only in these modules."""
    env = config.get("env")
    if not modules or not isinstance(env, Mapping):
        return dict(config)
    sections: dict[str, Any] = {}
    for section, kind in FUNCTORS.items():
        functors = env.get(section)
        if isinstance(functors, Mapping):
            sections[section] = {
                name: _with_module(functor, kind, modules) for name, functor in functors.items()
            }
    return {**config, "env": {**env, **sections}}


def _with_module(functor: Any, kind: Kind, modules: Sequence[ModuleType]) -> Any:
    """A functor whose function is named with its module, unless it is a registered term."""
    if not isinstance(functor, Mapping):
        return functor
    func = functor.get("func")
    if not isinstance(func, str) or func in TERMS[kind]:
        return functor
    for module in modules:
        if callable(inspect.getattr_static(module, func, None)):
            return {**functor, "func": f"{module.__name__}:{func}"}
    return functor
