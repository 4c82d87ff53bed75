"""Tables of trainings beside each other, with the spread over seeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from embodichain.cli.terminal.output import number

if TYPE_CHECKING:
    from embodichain.learning.evaluation.comparison import Group
    from embodichain.learning.evaluation.statistics import SeedEstimate

__all__ = ["comparison_table", "mean_of_seeds", "seed_estimates", "too_few_seeds"]

_COLUMNS = {
    "success": "success_rate",
    "return": "mean_return",
    "eval success": "eval_success",
    "eval return": "eval_return",
    "steps/s": "env_steps_per_second",
    "seconds": "train_seconds",
    "env steps": "env_steps",
}
_COSTS = ("steps/s", "seconds", "env steps")
"""Columns that are no results: without an interval, the mean alone is shown."""


def comparison_table(groups: Sequence[Group]) -> tuple[str, list[dict[str, Any]]]:
    """Return the title and the rows of a table of trainings, a row for each group."""
    from embodichain.learning.evaluation.comparison import short_labels

    common, labels = short_labels(groups)
    numbers = [seed_estimates(group) for group in groups]
    rows = [
        {
            **{"runs": label, "seeds": len(group.runs)},
            **{
                title: _cell(title, found[name])
                for title, name in _COLUMNS.items()
                if any(other[name] for other in numbers)
            },
        }
        for group, label, found in zip(groups, labels, numbers, strict=True)
    ]
    return f"trainings{common and f' of {common}'}: mean over seeds [95 % interval]", rows


def too_few_seeds(groups: Sequence[Group]) -> list[str]:
    """Return a sentence if groups have too few seeds for an interval, so that points are shown."""
    from embodichain.learning.evaluation.statistics import LEAST_SEEDS

    few = sorted({len(group.runs) for group in groups if len(group.runs) < LEAST_SEEDS})
    if not few:
        return []
    seeds = "1 seed" if few == [1] else f"{' or '.join(map(str, few))} seeds"
    points = "" if few == [1] else ": in parentheses is the value of each"
    return [f"no interval from {seeds}, it needs at least {LEAST_SEEDS}{points}"]


def seed_estimates(group: Group) -> dict[str, SeedEstimate | None]:
    """Each column of `comparison_table` for a group: its mean, with an interval over seeds."""
    return {name: group.number(name) for name in _COLUMNS.values()}


def _cell(title: str, found: SeedEstimate | None) -> str | None:
    if found is None:
        return None
    if found.mean_interval is None and title in _COSTS:
        return number(found.mean)
    return mean_of_seeds(found, share="success" in title)


def mean_of_seeds(found: SeedEstimate, *, share: bool = False) -> str:
    """Return a mean with its interval, or with the value of each of too few seeds."""
    form: Callable[[float], str] = "{:.1%}".format if share else number
    ends, values = found.mean_interval, found.values
    if ends is not None:
        return f"{form(found.mean)} [{form(ends[0])}, {form(ends[1])}]"
    points = ", ".join(form(value).rstrip("%") for value in values)
    return form(found.mean) + (f" ({points})" if len(values) > 1 else "")
