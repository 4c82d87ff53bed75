"""Seeds of an environment, and rewinding its random streams."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray

if TYPE_CHECKING:
    from embodichain.utils.random import RandomStreams

__all__ = ["first_seed", "reseed", "rewind", "seed_globals"]


def first_seed(seed: int | None) -> int:
    """Return the seed an environment starts with: None is 0, -1 draws one."""
    if seed is None:
        return 0
    if seed == -1:
        return int(np.random.SeedSequence().generate_state(1, np.uint32)[0])
    return int(seed)


def seed_globals(env: gym.Env[Any, Any], seed: int) -> None:
    """Seed what code outside this package may draw from: `np_random` and torch's generator.

    Nothing in this package draws from torch's generator; tutorial-like classes do.
    """
    seed = seed if seed >= 0 else seed % 2**64
    gym.Env.reset(env, seed=seed)
    torch.manual_seed(seed % 2**64)


def reseed(streams: RandomStreams, seed: Any) -> int:
    """Start every random stream of an environment anew; returns the seed in use.

    Raises:
        ValueError: If the seed is not an integer.
    """
    if not isinstance(seed, (int, np.integer)) or isinstance(seed, bool):
        raise ValueError(
            f"seed must be one integer (each environment has its own stream): {seed!r}"
        )
    value = first_seed(int(seed))
    streams.load_state_dict({"seed": value, "counters": {}})
    return value


def rewind(streams: RandomStreams, saved: dict[str, Any], rows: NDArray[np.bool_]) -> None:
    """Put some environments' streams back to where they were when ``saved`` was taken.

    Args:
        streams: The streams.
        saved: An earlier `RandomStreams.state_dict` with the same seed.
        rows: (N,) bool, which environments.
    """
    now = streams.state_dict()
    before, after = saved["counters"], now["counters"]
    changed = False
    for name, counters in after.items():
        old = before.get(name)
        if old is None:
            counters[rows] = 0
            changed = True
        elif not np.array_equal(old, counters):
            counters[rows] = old[rows]
            changed = True
    if changed:
        streams.load_state_dict(now)
