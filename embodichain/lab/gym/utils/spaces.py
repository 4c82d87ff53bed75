"""Gymnasium spaces of observations, and observations as numpy arrays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

if TYPE_CHECKING:
    pass

__all__ = [
    "entry_spaces",
    "flat_space",
    "named_obs",
    "numpy_obs",
    "observation_space",
]


def observation_space(obs: Mapping[str, Any]) -> spaces.Dict:
    """Return the space of one environment's observation.

    Floating point entries are unbounded, integers bounded by their type, booleans by 0 and 1.

    Args:
        obs: An observation of N environments.
    """
    return spaces.Dict(
        {
            key: observation_space(value) if isinstance(value, Mapping) else _leaf_space(value)
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
    """Return the (N, W) Box of a batched observation space, one vector per row."""
    width = spaces.utils.flatdim(space) // num_envs
    return spaces.Box(-np.inf, np.inf, (num_envs, width), np.float32)


def entry_spaces(space: gym.Space[Any], names: Iterable[str]) -> spaces.Dict:
    """Return the spaces of some entries of one environment's observation, by name, in order.

    Args:
        space: The space of one environment's observation.
        names: The entries; "/" nests.
    """
    found: dict[str, Any] = {}
    for name in names:
        leaf: Any = space
        for key in name.split("/"):
            leaf = leaf[key]
        found[name] = leaf
    return spaces.Dict(found)


def named_obs(obs: Any, space: spaces.Dict) -> dict[str, NDArray[Any]]:
    """Return an observation's entries (N, ...) by name, as new arrays.

    Args:
        obs: An observation of N environments.
        space: The result of `entry_spaces`.
    """
    parts = {name: obs[tuple(name.split("/"))].numpy(force=True) for name in space}
    return {name: np.array(part, space[name].dtype) for name, part in parts.items()}


def numpy_obs(obs: Mapping[str, Any]) -> dict[str, Any]:
    """Return an observation as nested dicts of numpy arrays (N, ...) that share its memory."""
    return {
        key: numpy_obs(value) if isinstance(value, Mapping) else value.cpu().numpy()
        for key, value in obs.items()
    }
