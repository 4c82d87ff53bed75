"""Numbers over tasks and seeds at once: interquartile mean, probability of improvement.

Both are those of Agarwal et al., "Deep reinforcement learning at the edge of the statistical
precipice" (2021): few seeds on several tasks are summarized together, and what is drawn anew for an
interval is the seeds of each task, never the tasks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from embodichain.learning.evaluation.statistics import CONFIDENCE, LEAST_SEEDS, RESAMPLES, iqm

__all__ = ["TaskSummary", "improvement", "interquartile_mean"]

F64 = NDArray[np.float64]

_SEED = 0  # of a separate generator: the same scores give the same interval


@dataclass(frozen=True, slots=True)
class TaskSummary:
    """A number over the seeds of several tasks.

    Attributes:
        value: The number.
        interval: 95 % interval from a bootstrap over the seeds of each task, (low, high); None
            below `LEAST_SEEDS` seeds in any task.
        seeds: The smallest number of seeds of a task.
        tasks: Number of tasks.
        note: Why there is no interval; None if there is one.
    """

    value: float
    interval: tuple[float, float] | None
    seeds: int
    tasks: int
    note: str | None


def interquartile_mean(scores: Sequence[ArrayLike]) -> TaskSummary:
    """Mean of the scores of all seeds and tasks without the lowest and the highest quarter.

    Args:
        scores: For each task, (S,) the score of each seed; tasks may have different numbers of
            seeds. Scores of different tasks should have one scale, such as rates of success.

    Raises:
        ValueError: There is no task, or one without scores.
    """
    samples = _samples(scores)
    rng = np.random.default_rng(_SEED)
    return _summarize(
        float(iqm(np.concatenate(samples))),
        seeds=min(map(len, samples)),
        tasks=len(samples),
        resample=lambda: iqm(np.concatenate([_drawn(sample, rng) for sample in samples], axis=1)),
    )


def improvement(scores: Sequence[ArrayLike], others: Sequence[ArrayLike]) -> TaskSummary:
    """Probability that one arm scores higher than another, on a task drawn from the list.

    It is the mean over tasks of the share of pairs of seeds in which the first arm's score is the
    higher one; a draw counts one half (Mann and Whitney's U over the number of pairs).

    Args:
        scores: For each task, (S,) the score of each seed.
        others: The other arm's, for the same tasks; the number of seeds may be another one.

    Raises:
        ValueError: The tasks differ in number, there is none, or one without scores.
    """
    samples = _samples(scores)
    other_samples = _samples(others)
    if len(samples) != len(other_samples):
        raise ValueError(f"arms need the same tasks, got {len(samples)} and {len(other_samples)}")
    rng = np.random.default_rng(_SEED)
    pairs = list(zip(samples, other_samples, strict=True))

    def resample() -> F64:
        shares = [_share_won(_drawn(one, rng), _drawn(other, rng)) for one, other in pairs]
        mean: F64 = np.mean(shares, axis=0)
        return mean

    return _summarize(
        float(np.mean([_share_won(one[None], other[None])[0] for one, other in pairs])),
        seeds=min(map(len, [*samples, *other_samples])),
        tasks=len(samples),
        resample=resample,
    )


def _samples(scores: Sequence[ArrayLike]) -> list[F64]:
    samples = [np.asarray(sample, np.float64) for sample in scores]
    if not samples or any(sample.ndim != 1 or not sample.size for sample in samples):
        raise ValueError("each task needs at least one score, as a list of numbers")
    return samples


def _drawn(sample: F64, rng: np.random.Generator) -> F64:
    """Return (R, S) scores drawn with replacement."""
    return sample[rng.integers(0, sample.size, size=(RESAMPLES, sample.size))]


def _share_won(scores: F64, others: F64) -> F64:
    """Return (R,) the share of pairs with the higher score, of (R, S) and (R, T) scores."""
    difference = scores[:, :, None] - others[:, None, :]
    won: F64 = np.mean((np.sign(difference) + 1) / 2, axis=(1, 2))
    return won


def _summarize(value: float, *, seeds: int, tasks: int, resample: Callable[[], F64]) -> TaskSummary:
    """Return the number, with the percentile interval of its resamples where seeds suffice."""
    if seeds < LEAST_SEEDS:
        noun = "1 seed" if seeds == 1 else f"{seeds} seeds"
        note = f"{noun}: an interval over seeds needs at least {LEAST_SEEDS}"
        return TaskSummary(value, None, seeds, tasks, note)
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(resample(), [tail, 1 - tail])
    return TaskSummary(value, (float(low), float(high)), seeds, tasks, None)
