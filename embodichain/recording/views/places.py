"""Positions of viewed environments beside each other, for viewers only."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.sim.engine.base import F64

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv

__all__ = ["pitch_of", "places"]

_EXTENTS = 2.5


def pitch_of(env: ObservedEnv) -> float:
    """Metres between environments that are viewed: the scene's size, at most `arena_space`."""
    pitch = _EXTENTS * float(env.sim.engine.model.stat.extent)
    if env.num_envs > 1:
        pitch = min(pitch, float(env.sim.arena_offsets[1, 0]))
    return pitch


def places(env: ObservedEnv, env_ids: Sequence[int]) -> F64:
    """(n, 3) position of each of these environments in ``world``, in a square, metres."""
    side = math.ceil(math.sqrt(len(env_ids)))
    index = np.arange(len(env_ids))
    grid = np.stack([index % max(side, 1), index // max(side, 1), 0 * index], axis=1)
    found: F64 = np.asarray(grid * pitch_of(env), np.float64)
    return found
