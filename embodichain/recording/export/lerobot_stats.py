"""Statistics of features as LeRobot keeps them: of each episode, and of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Stats", "merged", "of_levels", "of_values"]

Stats = dict[str, NDArray[Any]]
"""min, max, mean, std, count and five quantiles of a feature."""

_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}


def of_values(values: NDArray[Any]) -> Stats:
    """Statistics of (T, K) numbers, column by column."""
    numbers = values.astype(np.float64)
    stats: Stats = {
        "min": numbers.min(axis=0),
        "max": numbers.max(axis=0),
        "mean": numbers.mean(axis=0),
        "std": numbers.std(axis=0),
        "count": np.array([len(numbers)]),
    }
    quantiles = np.quantile(numbers, list(_QUANTILES.values()), axis=0)
    return stats | dict(zip(_QUANTILES, quantiles, strict=True))


def of_levels(counts: NDArray[np.int64], pictures: int) -> Stats:
    """Statistics of pictures, in 0 to 1 and by channel, from how often each level occurred.

    Args:
        counts: (3, 256).
        pictures: How many were counted.
    """
    levels = np.arange(256) / 255.0
    total = counts.sum(axis=1)
    mean = counts @ levels / total
    seen = counts > 0
    stats: Stats = {
        "min": levels[seen.argmax(axis=1)],
        "max": levels[255 - seen[:, ::-1].argmax(axis=1)],
        "mean": mean,
        "std": np.sqrt(np.maximum(counts @ levels**2 / total - mean**2, 0.0)),
    }
    shares = np.cumsum(counts, axis=1) / total[:, None]
    for name, share in _QUANTILES.items():
        stats[name] = levels[(shares >= share).argmax(axis=1)]
    shaped = {name: values[:, None, None] for name, values in stats.items()}
    return shaped | {"count": np.array([pictures])}


def merged(parts: Sequence[Stats]) -> Stats:
    """Statistics of all from those of parts; quantiles are the parts' weighted means."""
    counts = np.array([int(part["count"][0]) for part in parts], np.float64)
    weights = counts / counts.sum()

    def weighted(name: str) -> NDArray[Any]:
        total: NDArray[Any] = np.tensordot(weights, np.array([p[name] for p in parts]), axes=1)
        return total

    mean = weighted("mean")
    squares = np.array([part["std"] ** 2 + (part["mean"] - mean) ** 2 for part in parts])
    return {
        "min": np.min([part["min"] for part in parts], axis=0),
        "max": np.max([part["max"] for part in parts], axis=0),
        "mean": mean,
        "std": np.sqrt(np.tensordot(weights, squares, axes=1)),
        "count": np.array([int(counts.sum())]),
        **{name: weighted(name) for name in _QUANTILES},
    }
