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

__all__ = ["ObservationMemory", "as_float32", "leaves_of"]

logger = logging.getLogger(__name__)


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
    for key, value in obs.items():
        if isinstance(value, TensorDict):
            as_float32(value)
        elif value.dtype is not torch.float32 and value.is_floating_point():
            obs[key] = value.to(torch.float32)
    return obs


class ObservationMemory:
    """Knows the structure of an environment's observations.

    Args:
        obs: The first observation; later ones have its entries (others are ignored).
        num_envs: N.
    """

    def __init__(self, obs: TensorDict, num_envs: int) -> None:
        self._num_envs = num_envs
        leaves = {path: leaf for path, leaf in leaves_of(obs).items() if leaf.is_floating_point()}
        self.paths = list(leaves)
        self._matrix = [leaf.ndim == 2 for leaf in leaves.values()]
        widths = [leaf.numel() // num_envs for leaf in leaves.values()]
        self._ends = np.cumsum(widths).tolist()
        self.flat = self.flatten(obs)
        """(N, W) float32 copy of the last observation: `remember` and `merge` set it."""

    def flatten(self, obs: TensorDict) -> torch.Tensor:
        """Return (N, W) copies of all floating point entries, side by side.

        Raises:
            KeyError: If an entry of the first observation is missing.
        """
        parts: list[torch.Tensor] = []
        for path, matrix in zip(self.paths, self._matrix, strict=True):
            leaf: Any = obs
            for key in path:
                leaf = leaf[key]
            parts.append(leaf if matrix else leaf.reshape(self._num_envs, -1))
        return torch.cat(parts, dim=1) if parts else torch.zeros(self._num_envs, 0)

    @staticmethod
    def bad_rows(flat: torch.Tensor) -> NDArray[np.bool_] | None:
        """Return which rows hold a number that is not finite, or None if all are finite."""
        # The sum is the cheap question; it may overflow, so the exact one follows.
        if math.isfinite(flat.sum().item()):
            return None
        bad: NDArray[np.bool_] = ~torch.isfinite(flat).all(dim=1).numpy()
        return bad if bad.any() else None

    def made_finite(self, flat: torch.Tensor, obs: TensorDict) -> tuple[torch.Tensor, TensorDict]:
        """Zero rows that are not finite right after a reset, and log them.

        There is no earlier observation of that episode to fall back on. The environment is found
        diverged in its next step.
        """
        bad = self.bad_rows(flat)
        if bad is None:
            return flat, obs
        logger.error("not finite after a reset: environments %s", np.flatnonzero(bad)[:8].tolist())
        rows = torch.from_numpy(bad)
        flat = torch.where(rows[:, None], torch.zeros(()), flat)
        return flat, self.with_rows(obs, flat, rows)

    def with_rows(self, obs: TensorDict, flat: torch.Tensor, rows: torch.Tensor) -> TensorDict:
        """Return an observation some of whose rows are taken from a flat copy.

        Args:
            obs: The observation; neither it nor its tensors change.
            flat: (N, W) from `flatten`.
            rows: (N,) bool, the rows to take from ``flat``.
        """
        merged = obs.clone(recurse=False)
        start = 0
        for path, end in zip(self.paths, self._ends, strict=True):
            leaf = obs.get(path)
            kept = flat[:, start:end].reshape(leaf.shape)
            mask = rows.reshape(-1, *[1] * (leaf.ndim - 1))
            merged.set(path, torch.where(mask, kept, leaf))
            start = end
        return merged
