"""Saving and restoring an environment, so that it continues to the bit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["load", "save"]


def save(env: BaseEnv) -> dict[str, Any]:
    """Return copies of everything that decides how an environment goes on.

    Subclasses that keep state of their own extend `BaseEnv.state_dict`.
    """
    return {
        "num_envs": env.num_envs,
        "sim": env.sim.state_dict(),
        "streams": env.streams.state_dict(),
        "np_random": env.np_random.bit_generator.state,
        "managers": {name: manager.state_dict() for name, manager in env.managers.items()},
        "control_step": env.control_step,
        "elapsed": env._elapsed.copy(),
        "episode_ids": env._episode_ids.copy(),
        "last_action": env._last_action.copy(),
        "success": env._success.copy(),
        "pending": None if env._pending is None else env._pending.copy(),
        "cut": None if env._cut is None else env._cut.copy(),
        "observation": env._memory.flat.copy(),
    }


def load(env: BaseEnv, saved: dict[str, Any]) -> None:
    """Put an environment where `save` was called.

    Raises:
        ValueError: If the number of environments differs.
    """
    if saved["num_envs"] != env.num_envs:
        raise ValueError(
            f"this state is of {saved['num_envs']} environments, the environment has {env.num_envs}"
        )
    env.sim.load_state_dict(saved["sim"])
    env.streams.load_state_dict(saved["streams"])
    env.np_random.bit_generator.state = saved["np_random"]
    for name, manager in env.managers.items():
        manager.load_state_dict(saved["managers"][name])
    env.control_step = saved["control_step"]
    env._elapsed = saved["elapsed"].copy()
    env._episode_ids = saved["episode_ids"].copy()
    env._begun = False  # unless those numbers say so
    env._last_action = saved["last_action"].copy()
    env._success = saved["success"].copy()
    env._pending = None if saved["pending"] is None else saved["pending"].copy()
    env._cut = None if saved["cut"] is None else saved["cut"].copy()
    env._memory.flat = saved["observation"].copy()
