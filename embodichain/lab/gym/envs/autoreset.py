"""Autoreset modes, and what `info` keeps of an episode that a reset replaced.

When environments are reset in place is decided in `BaseEnv.step`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from embodichain.utils.suggest import did_you_mean

__all__ = ["AutoresetMode", "add_finals", "blanked", "instance_metadata", "parse_mode"]

FINAL_KEYS = ("final_obs", "final_info", "_final_obs", "_final_info", "final_observation")


def parse_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Return Gymnasium's mode for a mode, its name or its value.

    Raises:
        ValueError: If there is no such mode; lists them.
    """
    if isinstance(mode, AutoresetMode):
        return mode
    names = {m.name: m for m in AutoresetMode} | {m.value: m for m in AutoresetMode}
    found = names.get(mode) or names.get(str(mode).upper())
    if found is None:
        allowed = ", ".join(m.name for m in AutoresetMode)
        raise ValueError(
            f"unknown autoreset_mode {mode!r}; one of: {allowed}.{did_you_mean(str(mode), names)}"
        )
    return found


def instance_metadata(env: gym.Env[Any, Any], mode: AutoresetMode) -> dict[str, Any]:
    """Return a copy of the class's metadata for one instance, with its own mode."""
    return {**type(env).metadata, "autoreset_mode": mode}


def add_finals(info: dict[str, Any], obs: Any, done: NDArray[np.bool_]) -> None:
    """Put the final observation and info of environments that are done into ``info``.

    ``final_obs`` (``final_observation`` is the same object) and ``final_info`` have a row for
    every environment; only rows where ``_final_obs`` is True are final.
    """
    mask = torch.from_numpy(done)
    info["final_info"] = {key: value for key, value in info.items() if key not in FINAL_KEYS}
    info["final_obs"] = info["final_observation"] = obs
    info["_final_obs"] = info["_final_info"] = mask


def blanked(info: Mapping[str, Any], rows: torch.Tensor) -> dict[str, Any]:
    """Return a copy of ``info`` with some rows of every (N, ...) tensor zeroed, nested ones too.

    Args:
        info: Left as it is, its tensors too.
        rows: (N,) bool.
    """
    copy = dict(info)
    for key, value in info.items():
        if isinstance(value, Mapping):
            copy[key] = blanked(value, rows)
        elif isinstance(value, torch.Tensor) and value.shape[:1] == rows.shape:
            copy[key] = value.clone()
            copy[key][rows] = 0
    return copy
