"""`embodichain compare`: a table and learning curves of several trainings."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from embodichain.cli.app import complete_last, verb
from embodichain.cli.last import take_last
from embodichain.cli.output import number, print_json, print_table
from embodichain.config.run_folder import CHECKPOINT, newest_run, perhaps_last, whole_run
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.learning.comparison import Group
    from embodichain.learning.statistics import SeedEstimate

__all__ = ["command", "comparison_table", "mean_of_seeds", "too_few_seeds"]

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


@verb(
    "compare",
    ("compare outputs/2026-11-21/*_reach", "runs that differ by their seed are one line"),
    ("compare last outputs/older -o curves.png", "with learning curves"),
)
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", shell_complete=complete_last)
@click.option("--output", "-o", metavar="OUT", help="A new picture: .png, .svg, .pdf.")
def command(runs: tuple[str, ...], output: str | None, json: bool) -> None:
    """Print a table of trainings, one line for runs that differ only in the seed; draw curves.

    RUN is a folder of a training or of a sweep, or `last`.
    """
    from embodichain.learning.comparison import group_runs, read_run

    groups = group_runs(map(read_run, _trainings(runs)))
    if output is not None:
        from embodichain.learning.plots import plot_curves

        plot_curves(groups, Path(output))
    numbers = [_numbers(group) for group in groups]
    if json:
        data = [
            {
                "label": group.label,
                "seeds": [run.seed for run in group.runs],
                "folders": [str(run.folder) for run in group.runs],
                "numbers": {name: asdict(x) for name, x in found.items() if x is not None},
            }
            for group, found in zip(groups, numbers, strict=True)
        ]
        print_json({"groups": data, "picture": output})
        return
    print_table(*comparison_table(groups))
    for note in too_few_seeds(groups):
        sys.stdout.write(f"{note}\n")
    if output is not None:
        sys.stdout.write(f"{output}\n")


def comparison_table(groups: Sequence[Group]) -> tuple[str, list[dict[str, Any]]]:
    """Return the title and the rows of a table of trainings, a row for each group."""
    from embodichain.learning.comparison import short_labels

    common, labels = short_labels(groups)
    numbers = [_numbers(group) for group in groups]
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
    from embodichain.learning.statistics import LEAST_SEEDS

    few = sorted({len(group.runs) for group in groups if len(group.runs) < LEAST_SEEDS})
    if not few:
        return []
    seeds = "1 seed" if few == [1] else f"{' or '.join(map(str, few))} seeds"
    points = "" if few == [1] else ": in parentheses is the value of each"
    return [f"no interval from {seeds}, it needs at least {LEAST_SEEDS}{points}"]


def _numbers(group: Group) -> dict[str, SeedEstimate | None]:
    return {name: group.number(name) for name in _COLUMNS.values()}


def _trainings(names: Sequence[str]) -> list[Path]:
    """The folders of the named trainings and of the trainings in a sweep's folder.

    Evaluations and files, which a shell pattern may match, are left out with a note.
    """
    from embodichain.learning.comparison import trainings_in

    paths = dict.fromkeys(map(_path, names))
    inside = {path: trainings_in(path) if path.is_dir() else [] for path in paths}
    if not any(inside.values()):
        return list(paths)  # reading them reports the mistake
    for path in paths:
        if not inside[path]:
            sys.stderr.write(f"left out: {path} is no training\n")
    return list(dict.fromkeys(training for found in inside.values() for training in found))


def _path(name: str) -> Path:
    path = newest_run("outputs", CHECKPOINT) if name == "last" else Path(name)
    if path is not None and name == "last":
        path = take_last(whole_run(path))
    if path is None:
        raise ConfigError("no training in outputs yet: embodichain train task=NAME")
    if not path.exists() and "=" in name:
        raise ConfigError(f"{name}: `compare` reads no KEY=VALUE")
    if not path.exists():
        raise ConfigError(f"there is no run {name!r}{perhaps_last(name)}")
    return path.resolve()


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
