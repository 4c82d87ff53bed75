"""`frozen_cfg`: an environment's copy of its config, with the values that follow from others."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from typing import Any

from embodichain.lab.gym.envs.cfg import NO_LIMIT, EnvCfg
from embodichain.lab.sim.cfg import SimulationManagerCfg
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["frozen_cfg", "physics_of"]


def frozen_cfg(cfg: EnvCfg | None, num_envs: int | None = None) -> EnvCfg:
    """Return a deep copy of a config with derived fields filled in.

    The ``physics`` section goes into ``sim_cfg``, ``decimation`` into ``sim_steps_per_control``,
    ``episode_length_s`` into ``max_episode_steps`` (rounded up to whole control steps), and the
    number of environments into ``sim_cfg``.

    Args:
        cfg: The user's config, not changed; None is the default one.
        num_envs: Overrides the config's.

    Raises:
        ConfigError: If a value is invalid; names its key path.
    """
    cfg = EnvCfg() if cfg is None else copy.deepcopy(cfg)
    cfg.complete()
    if num_envs is not None:
        cfg.num_envs = num_envs
    cfg.sim_cfg = physics_of(cfg)
    if cfg.decimation is not None:
        cfg.sim_steps_per_control = cfg.decimation
    _check_numbers(cfg)
    cfg.sim_cfg.num_envs = cfg.num_envs
    if cfg.episode_length_s is not None:
        step_dt = cfg.sim_cfg.physics_dt * cfg.sim_steps_per_control
        # A length of whole steps must not become one more by the rounding of the division.
        cfg.max_episode_steps = max(1, math.ceil(cfg.episode_length_s / step_dt - 1e-9))
    cfg.max_episode_steps = int(cfg.max_episode_steps)
    if cfg.max_episode_steps == -1:
        cfg.max_episode_steps = NO_LIMIT
    return cfg


def physics_of(cfg: EnvCfg) -> SimulationManagerCfg:
    """Return a task's simulation config, with the values of its sections about physics.

    The sections ``physics``, ``scene`` and ``views`` go before ``sim_cfg``, which is not changed.
    """
    sim_cfg: SimulationManagerCfg | None = cfg.sim_cfg  # EmbodiChain allows None
    sim = SimulationManagerCfg(headless=True) if sim_cfg is None else replace(sim_cfg)
    section = {} if cfg.physics is None else vars(cfg.physics)
    values = {name: value for name, value in section.items() if value is not None}
    sim.physics_dt = values.pop("physics_dt", sim.physics_dt)
    sim.physics_config = replace(sim.physics_config, **values)
    sim.scene = cfg.scene or sim.scene
    sim.views = cfg.views or sim.views
    return sim


def _check_numbers(cfg: EnvCfg) -> None:
    """Check the numbers of a task made in Python; pydantic checks those of a task in YAML."""
    problems: list[Problem] = []
    for name in ("num_envs", "sim_steps_per_control"):
        value: Any = getattr(cfg, name)
        if not _is_integer(value) or value < 1:
            problems.append(Problem(name, f"must be an integer of at least 1, got {value!r}"))
    limit: Any = cfg.max_episode_steps
    if not isinstance(limit, int) or (limit < 1 and limit != -1):
        message = f"must be at least 1, or -1 for no limit, got {limit!r}"
        problems.append(Problem("max_episode_steps", message))
    if cfg.seed is not None and not _is_integer(cfg.seed):
        problems.append(Problem("seed", f"must be an integer or None, got {cfg.seed!r}"))
    physics_dt = cfg.sim_cfg.physics_dt
    if not physics_dt > 0:  # NaN is not positive either
        problems.append(Problem("physics.physics_dt", f"must be positive, got {physics_dt!r}"))
    if problems:
        raise ConfigError(problems)


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)
