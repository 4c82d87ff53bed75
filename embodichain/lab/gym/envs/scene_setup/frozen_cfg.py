"""`frozen_cfg`: an environment's copy of its config, with the values that follow from others."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from typing import Any

from embodichain.lab.gym.envs.cfg import NO_LIMIT, EnvCfg
from embodichain.lab.sim.cfg import SimulationManagerCfg
from embodichain.lab.sim.configs.config_types import check_config

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
    task: Any = EnvCfg() if cfg is None else copy.deepcopy(cfg)
    if not isinstance(task, EnvCfg):
        check_config(task, EnvCfg)  # raises
    task.complete()
    task.num_envs = task.num_envs if num_envs is None else num_envs
    task.sim_cfg = task.sim_cfg or SimulationManagerCfg(headless=True)  # EmbodiChain allows None
    is_from_file = task.key_sources is not None and num_envs is None
    if not is_from_file:  # that was checked when it was read
        check_config(task, EnvCfg)
    return _with_derived_values(task)


def _with_derived_values(cfg: EnvCfg) -> EnvCfg:
    """Return a checked config, changed in place: see `frozen_cfg`."""
    cfg.sim_cfg = physics_of(cfg)
    if cfg.decimation is not None:
        cfg.sim_steps_per_control = cfg.decimation
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
