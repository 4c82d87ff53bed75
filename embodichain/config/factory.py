"""`embodichain.make("reach", num_envs=64)`: builds the environment of `run task=reach`.

Torch is imported when an environment is built, not before.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.config.gymnasium_ids import task_of_id
from embodichain.config.resolved import Resolved, resolve, thaw
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["make", "make_env", "with_warp_sizes"]


_KWARGS = ("autoreset_mode", "render_mode", "run_dir")
"""Arguments of `BaseEnv` besides its config; it passes others on to methods of subclasses."""


def make(
    task: str,
    num_envs: int | None = None,
    overrides: Sequence[str] = (),
    *,
    seed: int | None = None,
    config_dir: str | Path | None = None,
    **kwargs: Any,
) -> BaseEnv:
    """Make the environment of a YAML task.

    Args:
        task: An option of the group `task`: ``reach``.
        num_envs: N; None is the task's suggestion, else 1.
        overrides: As on the command line: ``["seed=1", "task.rewards.near.weight=2"]``.
        seed: The seed of every random stream; None draws one.
        config_dir: A folder with the user's groups, searched first.
        **kwargs: For `BaseEnv`: ``render_mode``, ``autoreset_mode`` (SAME_STEP unless given),
            ``run_dir``; also the arguments of the class that the task names.

    Returns:
        The batched torch environment. `gymnasium.make` makes one environment with numpy
        observations of the same task, `gymnasium.make_vec` a batch of them.

    Raises:
        ConfigError: Lists every mistake in the config.
        TypeError: If `overrides` is one string instead of several, or an argument is unknown.
    """
    if isinstance(overrides, str):
        raise TypeError(f"overrides: a list of strings, such as [{overrides!r}], not a string")
    lines = [f"task={task}", *overrides]
    for key, value in (("num_envs", num_envs), ("seed", seed)):
        if value is not None:
            _check_once(key, value, overrides)
            lines.append(f"{key}={value}")
    try:
        resolved = resolve(lines, "run", config_dir)
    except ConfigError:
        _check_name(task, config_dir)
        raise
    return make_env(resolved, **kwargs)


def make_env(resolved: Resolved, **kwargs: Any) -> BaseEnv:
    """Build the environment of a config, as an instance of the class that the config names.

    Args:
        resolved: A checked config.
        **kwargs: For `BaseEnv`, or for the class.

    Raises:
        ConfigError: A mistake that is only found by building, with its place.
        TypeError: If an argument is unknown.
    """
    if resolved.tree["sim"]["engine"] == "warp":
        resolved = with_warp_sizes(resolved)
    cfg = resolved.env_cfg
    if cfg.id is not None:
        from embodichain.lab.gym.utils import registration

        with resolved.locating("task"):
            return registration.make(cfg.id.rpartition(":")[2], cfg=cfg, **kwargs)
    for key in kwargs:
        if key not in _KWARGS:
            names = [name for name in inspect.signature(make).parameters if name != "kwargs"]
            known = [*names, *_KWARGS]
            hint = did_you_mean(key, known)
            raise TypeError(f"unknown argument {key!r}; there are: {', '.join(known)}.{hint}")
    from embodichain.lab.gym.envs.base_env import BaseEnv

    with resolved.locating("task"):
        return BaseEnv(cfg, **kwargs)


_PROBE_ENVS, _PROBE_STEPS, _PROBE_EVERY = 8, 64, 4
"""Environments, control steps, and steps between two measured states of `with_warp_sizes`."""


def with_warp_sizes(resolved: Resolved) -> Resolved:
    """Return the config with the memory that MuJoCo Warp needs, where it is not given.

    A few environments of the task run on the CPU with random actions; MuJoCo Warp counts contacts
    and constraints in their states. Twice the largest numbers are filled in.

    Args:
        resolved: A checked config; it is returned as it is unless it runs on Warp.

    Raises:
        ConfigError: As `make_env` does.
    """
    sim = thaw(resolved.tree["sim"])
    sizes = sim["warp"]
    if sim["engine"] != "warp" or None not in sizes.values():
        return resolved
    import numpy as np

    from embodichain.lab.gym.policies import resolve_policy
    from embodichain.lab.sim.engine.warp_worlds import measured_sizes
    from embodichain.lab.sim.prepared_scene import PreparedScene

    probe = {**sim, "engine": "mujoco", "warp": {"nconmax": None, "njmax": None}}
    unseen = {**resolved.tree["viewer"], "name": "none"}
    on_cpu = resolved.changed(num_envs=_PROBE_ENVS, device="cpu", sim=probe, viewer=unseen)
    env = make_env(dataclasses.replace(on_cpu, prepared=PreparedScene()))
    try:
        policy = resolve_policy("random")
        obs, _ = env.reset()
        states = [env.sim.engine.rows.copy()]
        for step in range(1, _PROBE_STEPS + 1):
            obs, *_ = env.step(policy(obs, env))
            if not step % _PROBE_EVERY:
                states.append(env.sim.engine.rows.copy())
        found = measured_sizes(env.sim.engine.model, np.concatenate(states))
    finally:
        env.close()
    filled = {key: found[key] if given is None else given for key, given in sizes.items()}
    return resolved.changed(sim={**sim, "warp": filled})


def _check_once(key: str, value: int, overrides: Sequence[str]) -> None:
    """Refuse a value given both as an argument and in an override, since one would be ignored."""
    for line in overrides:
        if line.partition("=")[0].lstrip("+") == key:
            raise ConfigError(f"{key} is given twice: {value} as argument, and {line} in overrides")


def _check_name(task: str, config_dir: str | Path | None) -> None:
    """For a name that is a Gymnasium id and not a task, report the function to call instead."""
    name = task_of_id(task)
    if name is not None:
        raise ConfigError(
            f"{task!r} is an id for gymnasium.make and gymnasium.make_vec; "
            f"here it is the task's name: embodichain.make({name!r})"
        )
    from embodichain.config.composed import list_options
    from embodichain.lab.gym.utils.registration import REGISTERED_ENVS

    if task in REGISTERED_ENVS and task not in list_options("task", config_dir):
        raise ConfigError(
            f"{task!r} is a registered class, not a YAML task: gymnasium.make({task!r}, num_envs=N)"
        )
