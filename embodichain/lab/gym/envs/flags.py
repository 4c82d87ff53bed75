"""Masks over environments: `Flags` of one step, and what users give as masks or indices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.objects._arrays import as_env_ids

__all__ = ["Flags", "mask_of", "nobody", "reset_ids"]

Mask = NDArray[np.bool_]
_ID_KEYS = ("reset_ids", "env_ids", "reset_mask")


@dataclass(slots=True)
class Flags:
    """Why episodes end in a step; each is (N,) bool."""

    success: Mask
    fail: Mask
    time_out: Mask | None
    judged: bool = True
    """Whether anything of the task may say who succeeds or fails; else nobody does."""
    diverged: Mask | None = None


def nobody(mask: Mask) -> bool:
    """Whether no environment is in a mask that numpy computed."""
    return b"\1" not in mask.tobytes()  # half the cost of a reduction, which is slow to start


def mask_of(value: Any, num_envs: int, what: str) -> Mask:
    """Return a mask (N,) of its own; None is nobody.

    Raises:
        ValueError: If it is not (N,); (N, 1) is refused too, it would broadcast.
    """
    if value is None:
        return np.zeros(num_envs, np.bool_)
    array = value.detach().cpu().numpy() if isinstance(value, torch.Tensor) else np.asarray(value)
    if array.shape != (num_envs,):
        raise ValueError(f"{what} must have shape ({num_envs},), got {array.shape}")
    return array.astype(np.bool_)


def reset_ids(options: dict[str, Any], num_envs: int) -> NDArray[np.int64]:
    """Take the environments to reset out of `reset`'s options.

    Args:
        options: Loses ``reset_ids``, ``env_ids`` and ``reset_mask``.
        num_envs: N.

    Returns:
        (n,) sorted unique int64; all of them if none is named.

    Raises:
        ValueError: If they are named twice or wrongly.
    """
    given = {key: options.pop(key) for key in _ID_KEYS if key in options}
    if len(given) > 1:
        raise ValueError(f"give one of {', '.join(given)}, not several")
    ids = None
    for key, value in given.items():
        try:
            ids = as_env_ids(value, num_envs)
        except ValueError as error:
            raise ValueError(f"options[{key!r}]: {error}") from error
    return np.arange(num_envs) if ids is None else ids
