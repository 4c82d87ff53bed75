"""How a batch is split into shards."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["numbers_in_shard", "split_batch"]


def split_batch(num_envs: int, shards: int) -> list[int]:
    """Environments of each shard: as equal as possible, the first ones have one more."""
    base, more = divmod(num_envs, shards)
    return [base + (k < more) for k in range(shards)]


def numbers_in_shard(envs: Sequence[int], first: int, count: int) -> list[int]:
    """Those of some environments of the batch that a shard has, by their numbers in it."""
    return [i - first for i in envs if first <= i < first + count]
