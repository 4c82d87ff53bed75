"""Gymnasium spaces of observations and joints, and observations as numpy arrays or one vector."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from tensordict import TensorDict

from embodichain.lab.gym.utils.bounds import joint_bounds

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.objects.articulation import Articulation

__all__ = [
    "flat_space",
    "joint_space",
    "numpy_obs",
    "observation_space",
    "vector_obs",
    "vector_paths",
    "vector_space",
]

Path = tuple[str, ...]


def joint_space(articulation: Articulation, joint_ids: Sequence[int]) -> spaces.Box:
    """Return the Box of absolute joint positions, finite for joints without limits too.

    Args:
        articulation: The robot.
        joint_ids: Its A joints, in the order of the action.
    """
    low, high = joint_bounds(articulation.parsed.qpos_limits, joint_ids)
    return spaces.Box(low, high, dtype=np.float32)


def observation_space(obs: TensorDict) -> spaces.Dict:
    """Return the space of one environment's observation.

    Floating point entries are unbounded, integers bounded by their type, booleans by 0 and 1.

    Args:
        obs: An observation of N environments.
    """
    return spaces.Dict(
        {
            key: observation_space(value) if isinstance(value, TensorDict) else _leaf_space(value)
            for key, value in obs.items()
        }
    )


def _leaf_space(value: Any) -> spaces.Box:
    shape = tuple(value.shape[1:])
    dtype = value.cpu().numpy().dtype
    if np.issubdtype(dtype, np.floating):
        return spaces.Box(-np.inf, np.inf, shape, np.float32)
    if dtype == np.bool_:
        return spaces.Box(0, 1, shape, np.bool_)  # type: ignore[arg-type]
    info = np.iinfo(dtype)
    return spaces.Box(info.min, info.max, shape, dtype.type)


def flat_space(space: gym.Space[Any], num_envs: int) -> spaces.Box:
    """Return the (N, W) Box of a batched observation space, each row one vector."""
    width = spaces.utils.flatdim(space) // num_envs
    return spaces.Box(-np.inf, np.inf, (num_envs, width), np.float32)


def vector_space(space: gym.Space[Any], paths: Sequence[Path]) -> spaces.Box:
    """Return the Box (W,) of one environment's vector.

    Args:
        space: The space of one environment's observation.
        paths: The entries, in order.
    """
    width = 0
    for path in paths:
        leaf: Any = space
        for key in path:
            leaf = leaf[key]
        width += int(np.prod(leaf.shape, dtype=np.int64))
    return spaces.Box(-np.inf, np.inf, (width,), np.float32)


def numpy_obs(obs: TensorDict) -> dict[str, Any]:
    """Return an observation as nested dicts of numpy arrays (N, ...) over the same memory."""
    return {
        key: numpy_obs(value) if isinstance(value, TensorDict) else value.cpu().numpy()
        for key, value in obs.items()
    }


def vector_paths(env: BaseEnv) -> list[Path]:
    """Return the entries of an observation's vector, in order.

    The declared observations of the group ``policy`` in declared order; without declared
    observations, every floating point entry.
    """
    manager = env.observation_manager
    if "policy" in manager.groups:
        return [tuple(name.split("/")) for name in manager.group_terms("policy")]
    return list(env.observation_paths)


def vector_obs(obs: TensorDict, paths: Sequence[Path]) -> NDArray[np.float32]:
    """Return entries of an observation side by side, (N, W) float32.

    Args:
        obs: The observation of N environments.
        paths: The entries, in order.
    """
    parts = []
    for path in paths:
        leaf: Any = obs
        for key in path:
            leaf = leaf[key]
        parts.append(leaf.reshape(leaf.shape[0], -1).to(torch.float32))
    flat = torch.cat(parts, dim=1) if parts else torch.zeros(obs.batch_size[0], 0)
    result: NDArray[np.float32] = flat.cpu().numpy()
    return result
