"""Tables of trainings beside each other, with the spread over seeds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

from embodichain.cli.terminal.output import result_number

if TYPE_CHECKING:
    from embodichain.learning.evaluation.comparison import Group
    from embodichain.learning.evaluation.statistics import SeedEstimate

__all__ = [
    "comparison_table",
    "describe_means",
    "mean_of_seeds",
    "rate_episodes",
    "seed_estimates",
    "too_few_seeds",
]

_COLUMNS = {
    "success": "success_rate",
    "return": "mean_return",
    "eval success": "eval_success",
    "eval return": "eval_return",
    "steps/s": "env_steps_per_second",
    "seconds": "train_seconds",
    "env steps": "env_steps",
}
_EPISODES = {"success": "episodes", "eval success": "eval episodes"}
"""Column of a rate -> the column behind it, how many episodes of each run it is from."""
_RATES = [_COLUMNS[title] for title in _EPISODES]
_COSTS = ("steps/s", "seconds", "env steps")
"""Columns that are not results: without an interval, the mean alone is shown."""


def comparison_table(groups: Sequence[Group]) -> tuple[str, list[dict[str, Any]]]:
    """Return the title and the rows of a table of trainings, a row for each group."""
    from embodichain.learning.evaluation.comparison import short_labels

    common, labels = short_labels(groups)
    estimates = [seed_estimates(group) for group in groups]
    columns = {
        title: name
        for title, name in _COLUMNS.items()
        if any(group_estimates[name] for group_estimates in estimates)
    }
    counted = {name for group in groups for name in rate_episodes(group)}
    rows = []
    for group, label, group_estimates in zip(groups, labels, estimates, strict=True):
        row: dict[str, Any] = {"runs": label, "seeds": len(group.runs)}
        for title, name in columns.items():
            row[title] = _cell(title, group_estimates[name])
            if name in counted:
                row[_EPISODES[title]] = _range_text(rate_episodes(group).get(name, []))
        rows.append(row)
    results = []
    for title, name in columns.items():
        if title not in _COSTS:
            results += [group_estimates[name] for group_estimates in estimates]
    trainings = f"trainings of {common}" if common else "trainings"
    return f"{trainings}: {describe_means(results)}", rows


def describe_means(estimates: Iterable[SeedEstimate | None]) -> str:
    """Return what the cells of `mean_of_seeds` are, for the title of their table.

    Args:
        estimates: The means in the table; None for an empty cell.
    """
    from embodichain.learning.evaluation.statistics import LEAST_SEEDS

    counts = sorted({len(estimate.values) for estimate in estimates if estimate is not None})
    needed = f"an interval needs {LEAST_SEEDS} seeds"
    if not counts or counts[0] >= LEAST_SEEDS:
        return "mean over seeds [95 % interval]"
    if counts == [1]:
        return f"one seed; {needed}"
    if counts[-1] >= LEAST_SEEDS:
        return f"mean over seeds [95 % interval], or (the value of each seed); {needed}"
    number_of_seeds = " or ".join(map(str, counts))
    return f"mean over {number_of_seeds} seeds (the value of each); {needed}"


def too_few_seeds(groups: Sequence[Group]) -> list[str]:
    """Return a sentence if groups have too few seeds for an interval, so that points are shown."""
    from embodichain.learning.evaluation.statistics import LEAST_SEEDS

    counts = sorted({len(group.runs) for group in groups if len(group.runs) < LEAST_SEEDS})
    if not counts:
        return []
    if counts == [1]:
        return [f"no interval from 1 seed, it needs at least {LEAST_SEEDS}"]
    seeds = f"{' or '.join(map(str, counts))} seeds"
    needed = f"it needs at least {LEAST_SEEDS}"
    return [f"no interval from {seeds}, {needed}: in parentheses is the value of each"]


def seed_estimates(group: Group) -> dict[str, SeedEstimate | None]:
    """Each column of `comparison_table` for a group: its mean, with an interval over seeds."""
    return {name: group.number(name) for name in _COLUMNS.values()}


def rate_episodes(group: Group) -> dict[str, list[int]]:
    """Return the number of episodes of each run behind each rate of `seed_estimates`.

    Runs of which that is not known are left out.
    """
    episodes: dict[str, list[int]] = {}
    for run in group.runs:
        for name, trials in run.trials.items():
            if trials and name in _RATES:
                episodes.setdefault(name, []).append(trials)
    return episodes


def _range_text(counts: Sequence[int]) -> str | None:
    """``100``, or ``64 to 100`` where runs differ."""
    if not counts:
        return None
    low = min(counts)
    high = max(counts)
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"


def _cell(title: str, estimate: SeedEstimate | None) -> str | None:
    if estimate is None:
        return None
    if estimate.mean_interval is None and title in _COSTS:
        return result_number(estimate.mean)
    return mean_of_seeds(estimate, share="success" in title)


def mean_of_seeds(estimate: SeedEstimate, *, share: bool = False) -> str:
    """Return a mean with its interval, or with the value of each of too few seeds.

    Args:
        estimate: The mean over seeds.
        share: Whether it is a share, which is written in percent.
    """
    text: Callable[[float], str] = "{:.1%}".format if share else result_number
    mean = text(estimate.mean)
    if estimate.mean_interval is not None:
        low, high = estimate.mean_interval
        return f"{mean} [{text(low)}, {text(high)}]"
    if len(estimate.values) == 1:
        return mean
    values = ", ".join(text(value).rstrip("%") for value in estimate.values)
    return f"{mean} (seeds {values})"
