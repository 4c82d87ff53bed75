"""`embodichain compare`: trainings side by side, as a table and as curves."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from embodichain.cli.app import common, complete_last, verb
from embodichain.cli.output import number, print_json, print_table
from embodichain.config.run_folder import CHECKPOINT, newest_run
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.learning.comparison import Group

__all__ = ["command"]

_COLUMNS = {
    "success": "success_rate",
    "return": "mean_return",
    "eval success": "eval_success",
    "eval return": "eval_return",
    "steps/s": "env_steps_per_second",
    "seconds": "train_seconds",
    "env steps": "env_steps",
}
_SHARES = ("success", "eval success")


@verb(
    "compare",
    ("compare outputs/2026-11-21/*_reach", "runs that differ by their seed are one line"),
    ("compare last outputs/older -o curves.png", "with learning curves"),
)
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", shell_complete=complete_last)
@click.option("--output", "-o", metavar="OUT", help="A new picture: .png, .svg, .pdf.")
@common()
def command(runs: tuple[str, ...], output: str | None, json: bool, traceback: bool) -> None:
    """Print a table of trainings, runs that differ by their seed in one line; draw their curves.

    RUN is a folder of a training or of a sweep, or `last`.
    """
    from embodichain.learning.comparison import group_runs, read_run

    groups = group_runs(map(read_run, _trainings(runs)))
    if output is not None:
        from embodichain.learning.plots import plot_curves

        plot_curves(groups, Path(output))
    if json:
        print_json({"groups": [_data(group) for group in groups], "picture": output})
        return
    known = [title for title, name in _COLUMNS.items() if any(g.number(name) for g in groups)]
    rows = [_row(group, known) for group in groups]
    print_table("trainings: mean over seeds [95 % interval]", rows)
    if output is not None:
        sys.stdout.write(f"{output}\n")


def _trainings(names: Sequence[str]) -> list[Path]:
    """The folders of what was named; the trainings of a sweep's folder.

    A pattern finds evaluations, and files, too: these are left out, and said.
    """
    from embodichain.learning.comparison import trainings_in

    found: list[Path] = []
    others: list[Path] = []
    for path in dict.fromkeys(map(_path, names)):
        inside = trainings_in(path) if path.is_dir() else []
        found += inside
        others += [] if inside else [path]
    if not found:
        return others  # reading one of them says what is wrong with it
    for path in others:
        sys.stderr.write(f"left out: {path} is no training\n")
    return list(dict.fromkeys(found))


def _path(name: str) -> Path:
    path = newest_run("outputs", CHECKPOINT) if name == "last" else Path(name)
    if path is None:
        raise ConfigError("no training in outputs yet: embodichain train task=NAME")
    if not path.exists():
        raise ConfigError(f"there is no run {name!r}")
    return path.resolve()


def _row(group: Group, titles: list[str]) -> dict[str, Any]:
    row: dict[str, Any] = {"runs": group.label, "seeds": len(group.runs)}
    for title in titles:
        found = group.number(_COLUMNS[title])
        if found is None:
            continue
        form: Callable[[float], str] = (lambda v: f"{v:.1%}") if title in _SHARES else number
        ends = found.mean_interval
        row[title] = form(found.mean)
        row[title] += f" [{form(ends[0])}, {form(ends[1])}]" if ends is not None else ""
    return row


def _data(group: Group) -> dict[str, Any]:
    numbers = {name: group.number(name) for name in _COLUMNS.values()}
    return {
        "label": group.label,
        "seeds": [run.seed for run in group.runs],
        "folders": [str(run.folder) for run in group.runs],
        "numbers": {n: asdict(found) for n, found in numbers.items() if found is not None},
    }
