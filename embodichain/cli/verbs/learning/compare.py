"""`embodichain compare`: a table and learning curves of several trainings."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from embodichain.cli.results.comparison_tables import (
    comparison_table,
    rate_episodes,
    seed_estimates,
    too_few_seeds,
)
from embodichain.cli.terminal.last import announce_last
from embodichain.cli.terminal.output import print_json, print_table
from embodichain.cli.verb import complete_last, verb
from embodichain.config.run_folder import CHECKPOINT, newest_run, whole_run, why_no_run
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.learning.evaluation.comparison import Group

__all__ = ["command"]


@dataclass(frozen=True)
class CompareOptions:
    """What was typed after `compare`.

    Attributes:
        runs: Folders of trainings and of sweeps, or ``last``.
        output: Path of a new picture of the learning curves.
        json: Print the result as one JSON object.
    """

    runs: tuple[str, ...]
    output: str | None
    json: bool


@verb(
    "compare",
    ("compare outputs/2026-11-21/*_reach", "runs that differ by their seed are one line"),
    ("compare last outputs/older -o curves.png", "with learning curves"),
    options=CompareOptions,
)
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", shell_complete=complete_last)
@click.option("--output", "-o", metavar="OUT", help="A new picture: .png, .svg, .pdf.")
def command(options: CompareOptions) -> None:
    """Print a table of trainings, one line for runs that differ only in the seed; draw curves.

    RUN is a folder of a training or of a sweep, or `last`.
    """
    from embodichain.learning.evaluation.comparison import group_runs, read_run

    groups = group_runs(map(read_run, _find_trainings(options.runs)))
    if options.output is not None:
        from embodichain.learning.evaluation.plots import plot_curves

        plot_curves(groups, Path(options.output))
    if options.json:
        data = [_as_dict(group) for group in groups]
        print_json({"groups": data, "picture": options.output})
        return
    print_table(*comparison_table(groups))
    for note in too_few_seeds(groups):
        sys.stdout.write(f"{note}\n")
    if options.output is not None:
        sys.stdout.write(f"{options.output}\n")


def _as_dict(group: Group) -> dict[str, Any]:
    """A group of trainings as `--json` prints it; what none of them has is left out."""
    estimates = {
        name: asdict(estimate)
        for name, estimate in seed_estimates(group).items()
        if estimate is not None
    }
    return {
        "label": group.label,
        "seeds": [run.seed for run in group.runs],
        "folders": [str(run.folder) for run in group.runs],
        "numbers": estimates,
        "episodes": rate_episodes(group),
    }


def _find_trainings(names: Sequence[str]) -> list[Path]:
    """Find the folders of the named trainings and of the trainings in a sweep's folder.

    Evaluations and files, which a shell pattern may match, are left out with a note.
    """
    from embodichain.learning.evaluation.comparison import trainings_in

    trainings: list[Path] = []
    others: list[Path] = []
    for path in dict.fromkeys(_find_paths(names)):
        trainings_of_path = trainings_in(path) if path.is_dir() else []
        trainings += trainings_of_path
        if not trainings_of_path:
            others.append(path)
    if not trainings:
        return others  # reading them reports the mistake
    for path in others:
        sys.stderr.write(f"left out: {path} is not a training\n")
    return list(dict.fromkeys(trainings))


def _find_paths(names: Sequence[str]) -> list[Path]:
    """Find files and folders; of the word ``last``, the newest training or its sweep.

    Raises:
        ConfigError: Lists every name that nothing has.
    """
    paths: list[Path] = []
    newest: Path | None = None
    problems: list[Problem] = []
    for name in names:
        if name == "last":
            newest = newest_run("outputs", CHECKPOINT)
            if newest is None:
                message = "no training in outputs yet: embodichain train task=NAME"
                problems.append(Problem("", message))
            else:
                newest = whole_run(newest)
                paths.append(newest.resolve())
        elif Path(name).exists():
            paths.append(Path(name).resolve())
        elif "=" in name:
            problems.append(Problem("", f"{name}: `compare` reads no KEY=VALUE"))
        else:
            problems.append(Problem("", f"there is no run {name!r}{why_no_run(name)}"))
    if problems:
        raise ConfigError(problems)
    if newest is not None:
        announce_last(newest)
    return paths
