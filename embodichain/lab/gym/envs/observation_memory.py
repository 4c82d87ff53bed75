"""`ObservationMemory`: a private copy of the last observation, flat, and whether it is finite.

What an observation contains is decided in `BaseEnv.get_obs`. Only floating point entries are
remembered: others cannot be non-finite and are taken as they are.
"""

from __future__ import annotations

import logging
import operator
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

from embodichain.lab.gym.utils.tensordicts import branches_copied, entries, replace
from embodichain.lab.sim.objects._arrays import all_finite

__all__ = ["Known", "ObservationMemory", "as_float32", "leaves_of"]

logger = logging.getLogger(__name__)

F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
Known = tuple[tuple[torch.Tensor, ...], F32]
"""First entries of an observation, and one array of their numbers, one after the other."""


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


def _branches(paths: Sequence[tuple[str, ...]]) -> list[tuple[tuple[str, ...], list[str]]]:
    """Paths as branches and the names of their entries, in the same order."""
    found: list[tuple[tuple[str, ...], list[str]]] = []
    for *branch, name in paths:
        if not found or found[-1][0] != tuple(branch):
            found.append((tuple(branch), []))
        found[-1][1].append(name)
    return found


class ObservationMemory:
    """Knows the structure of an environment's observations.

    Everything is numpy here: between physics steps the caches are cold, and every part of torch
    that a step does not touch is a part that need not be fetched.

    Args:
        obs: The first observation; later ones have its entries (others are ignored).
        num_envs: N.

    Attributes:
        paths: The floating point entries, in order.
        flat: (N W,) float32, a copy of all of them as last observed, one entry after the other.
    """

    def __init__(self, obs: TensorDict, num_envs: int) -> None:
        self._num_envs = num_envs
        leaves = {path: leaf for path, leaf in leaves_of(obs).items() if leaf.is_floating_point()}
        self.paths = list(leaves)
        self._branches = _branches(self.paths)
        self._shapes = [tuple(leaf.shape) for leaf in leaves.values()]
        ends = np.cumsum([leaf.numel() for leaf in leaves.values()]).tolist()
        self._places = [slice(a, b) for a, b in zip([0, *ends], ends, strict=False)]
        self.flat: F32 = self.flatten(obs)

    def flatten(self, obs: TensorDict, known: Known | None = None) -> F32:
        """Return a copy (N W,) of all floating point entries, one after the other.

        Args:
            obs: The observation.
            known: Arrays that are known to hold its first entries.

        Raises:
            KeyError: If an entry of the first observation is missing.
        """
        leaves: list[torch.Tensor] = []
        root = entries(obs)
        for branch, names in self._branches:
            own = root
            for key in branch:
                own = entries(own[key])
            for name in names:
                leaves.append(own[name])
        parts: list[F32] = []
        if known is not None:
            count = len(known[0])
            if len(leaves) >= count and all(map(operator.is_, leaves, known[0])):
                parts.append(known[1])
                del leaves[:count]
        for leaf in leaves:
            parts.append(leaf.numpy())
        return np.concatenate(parts, axis=None) if parts else np.zeros(0, np.float32)

    def bad_rows(self, flat: F32) -> Mask | None:
        """Return which rows (N,) hold a number that is not finite; None if all are finite.

        Args:
            flat: (N W,) from `flatten`.
        """
        if all_finite(flat):
            return None
        bad = np.zeros(self._num_envs, np.bool_)
        for place in self._places:
            bad |= ~np.isfinite(flat[place].reshape(self._num_envs, -1)).all(axis=1)
        return bad

    def made_finite(self, obs: TensorDict, known: Known | None = None) -> TensorDict:
        """Remember an observation right after a reset; zero its rows that are not finite, and log.

        There is no earlier observation of that episode to fall back on. The environment is found
        diverged in its next step.

        Args:
            obs: The observation.
            known: As for `flatten`.
        """
        self.flat = self.flatten(obs, known)
        bad = self.bad_rows(self.flat)
        if bad is None:
            return obs
        logger.error("not finite after a reset: environments %s", np.flatnonzero(bad)[:8].tolist())
        obs = self.with_rows(obs, np.zeros_like(self.flat), bad)
        self.flat = self.flatten(obs)
        return obs

    def with_rows(self, obs: TensorDict, flat: F32, rows: Mask) -> TensorDict:
        """Return an observation some of whose rows are taken from a flat copy.

        Args:
            obs: The observation; neither it nor its tensors change.
            flat: (N W,) from `flatten`.
            rows: (N,) bool, the rows to take from ``flat``.
        """
        merged = branches_copied(obs)
        for path, shape, place in zip(self.paths, self._shapes, self._places, strict=True):
            leaf: Any = obs
            for key in path:
                leaf = entries(leaf)[key]
            mask = rows.reshape(-1, *[1] * (len(shape) - 1))
            chosen = np.where(mask, flat[place].reshape(shape), leaf.numpy())
            replace(merged, path, torch.from_numpy(chosen))
        return merged
