"""`ObservationMemory`: a private copy of the last observation, flat, and whether it is finite.

What an observation contains is decided in `BaseEnv.get_obs`. Only floating point entries are
remembered: others cannot be non-finite and are taken as they are.
"""

from __future__ import annotations

import logging
import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

from embodichain.lab.gym.utils.tensordicts import branches_copied, entries, replace

__all__ = ["ObservationMemory", "as_float32", "leaves_of"]

logger = logging.getLogger(__name__)

F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]


def leaves_of(obs: TensorDict) -> dict[tuple[str, ...], torch.Tensor]:
    """Return the tensors of a nested observation by path, in its own order."""
    found: dict[tuple[str, ...], torch.Tensor] = {}
    for key, value in obs.items():
        if isinstance(value, TensorDict):
            found |= {(key, *path): leaf for path, leaf in leaves_of(value).items()}
        elif isinstance(value, torch.Tensor):
            found[(key,)] = value
    return found


def as_float32(obs: TensorDict) -> TensorDict:
    """Give every floating point entry of a nested observation the type float32, in place."""
    for path, leaf in leaves_of(obs).items():
        if leaf.is_floating_point() and leaf.dtype is not torch.float32:
            obs.set(path, leaf.to(torch.float32))
    return obs


class ObservationMemory:
    """Knows the structure of an environment's observations.

    Everything is numpy here: between physics steps the caches are cold, and every part of torch
    that a step does not touch is a part that need not be fetched.

    Args:
        obs: The first observation; later ones have its entries (others are ignored).
        num_envs: N.

    Attributes:
        paths: The floating point entries, in order.
        flat: (N, W) float32, all of them side by side as last observed.
    """

    def __init__(self, obs: TensorDict, num_envs: int) -> None:
        self._num_envs = num_envs
        leaves = {path: leaf for path, leaf in leaves_of(obs).items() if leaf.is_floating_point()}
        self.paths = list(leaves)
        self._places = [(path, leaf.ndim == 2) for path, leaf in leaves.items()]
        self._ends = np.cumsum([leaf.numel() // num_envs for leaf in leaves.values()]).tolist()
        self.flat: F32 = self.flatten(obs)

    def flatten(self, obs: TensorDict) -> F32:
        """Return (N, W) copies of all floating point entries, side by side.

        Raises:
            KeyError: If an entry of the first observation is missing.
        """
        parts: list[torch.Tensor] = []
        for path, matrix in self._places:
            leaf: Any = obs
            for key in path:
                leaf = entries(leaf)[key]
            parts.append(leaf if matrix else leaf.reshape(self._num_envs, -1))
        if not parts:
            return np.zeros((self._num_envs, 0), np.float32)
        return torch.cat(parts, dim=1).numpy()

    @staticmethod
    def bad_rows(flat: F32) -> Mask | None:
        """Return which rows of (N, W) hold a number that is not finite; None if all are finite."""
        # The sum is the cheap question; it may overflow, so the exact one follows.
        if math.isfinite(np.add.reduce(flat, None)):
            return None
        bad: Mask = ~np.asarray(np.isfinite(flat).all(axis=1))
        return bad if bad.any() else None

    def made_finite(self, flat: F32, obs: TensorDict) -> tuple[F32, TensorDict]:
        """Zero rows that are not finite right after a reset, and log them.

        There is no earlier observation of that episode to fall back on. The environment is found
        diverged in its next step.
        """
        bad = self.bad_rows(flat)
        if bad is None:
            return flat, obs
        logger.error("not finite after a reset: environments %s", np.flatnonzero(bad)[:8].tolist())
        flat = np.where(bad[:, None], np.float32(0), flat)
        return flat, self.with_rows(obs, flat, bad)

    def with_rows(self, obs: TensorDict, flat: F32, rows: Mask) -> TensorDict:
        """Return an observation some of whose rows are taken from a flat copy.

        Args:
            obs: The observation; neither it nor its tensors change.
            flat: (N, W) from `flatten`.
            rows: (N,) bool, the rows to take from ``flat``.
        """
        merged = branches_copied(obs)
        wide = rows[:, None]
        start = 0
        for (path, matrix), end in zip(self._places, self._ends, strict=True):
            leaf: Any = obs
            for key in path:
                leaf = entries(leaf)[key]
            kept = flat[:, start:end]
            if matrix:
                chosen = np.where(wide, kept, leaf.numpy())
            else:
                mask = rows.reshape(-1, *[1] * (leaf.ndim - 1))
                chosen = np.where(mask, kept.reshape(tuple(leaf.shape)), leaf.numpy())
            replace(merged, path, torch.from_numpy(chosen))
            start = end
        return merged
