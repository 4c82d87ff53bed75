"""The comparison at the end of a sweep: a table, the best point, and a page with curves.

`embodichain compare SWEEP` prints the same table, `embodichain report SWEEP` writes the same page.
"""

from __future__ import annotations

import dataclasses
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from embodichain.cli.results.comparison_tables import comparison_table, mean_of_seeds, too_few_seeds
from embodichain.cli.sweeps.sweep_jobs import is_finished
from embodichain.cli.terminal.output import number, print_table, result_number
from embodichain.config.composition.locate import display_path
from embodichain.utils.env_text import shown
from embodichain.utils.errors import ConfigError
from embodichain.utils.system.atomic import write_text

if TYPE_CHECKING:
    from embodichain.cli.pages.headline import Result
    from embodichain.learning.evaluation.comparison import Group

__all__ = ["has_finished_training", "page_of_sweep", "report_sweep"]

PAGE = "report.html"
_RESULTS = "optimization_results.yaml"
"""The result of a search, which Optuna's sweeper writes."""
_MOST_CURVES = 10
"""Groups in the picture of the page: those with the largest objective."""


def report_sweep(folder: Path, *, quiet: bool) -> None:
    """Write the page into the sweep's folder; print the table and the best point.

    Args:
        folder: The sweep's folder.
        quiet: Whether to print nothing.

    Raises:
        ConfigError: The page cannot be written, or a job's file is damaged.
    """
    groups, notes = _groups(folder)
    if not groups:
        return
    page = folder / PAGE
    try:
        write_text(page, _page(folder, groups, notes))
    except OSError as error:
        raise ConfigError(f"cannot write {page}: {error}") from error
    if quiet:
        return
    print_table(*comparison_table(groups))
    sys.stdout.flush()
    lines = [*too_few_seeds(groups), *notes, *_best_point(folder, groups), str(page)]
    sys.stderr.write("".join(f"{line}\n" for line in lines))


def page_of_sweep(folder: Path) -> str:
    """Return the comparison of a sweep's trainings as HTML.

    Args:
        folder: The sweep's folder.

    Raises:
        ConfigError: It has no finished training, or a file in it is damaged.
    """
    groups, notes = _groups(folder)
    if not groups:
        raise ConfigError(f"{folder} has no finished training")
    return _page(folder, groups, notes)


def has_finished_training(folder: Path) -> bool:
    """Whether a folder contains the finished training of a sweep's job.

    Args:
        folder: The sweep's folder.
    """
    from embodichain.learning.evaluation.comparison import trainings_in

    return any(is_finished(path, "train") for path in trainings_in(folder))


def _groups(folder: Path) -> tuple[list[Group], list[str]]:
    """The finished trainings, and notes about those that are left out."""
    from embodichain.learning.evaluation.comparison import group_runs, read_run, trainings_in

    runs = []
    notes = []
    seen = set()
    for path in trainings_in(folder):
        run = read_run(path)
        if not is_finished(path, "train"):
            notes.append(f"left out: {path} is not finished")
        elif (run.label, run.seed) in seen:  # a search may try a point twice
            notes.append(f"left out: {path} repeats an earlier job")
        else:
            seen.add((run.label, run.seed))
            runs.append(run)
    return group_runs(runs), notes


def _search_result(folder: Path) -> dict[str, Any]:
    """The result of a search; empty for other sweeps."""
    path = folder / _RESULTS
    if not path.is_file():
        return {}
    try:
        result = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError) as error:
        raise ConfigError(f"cannot read {path}: {error}") from error
    if not isinstance(result, dict):
        return {}
    return result


def _best_point(folder: Path, groups: Sequence[Group]) -> list[str]:
    """The best point with its objective, if there are several; of a search, also its file."""
    result = _search_result(folder)
    best_value = result.get("best_value")
    if best_value is None:
        return _best_group(groups)
    params = shown(result.get("best_params", {}))
    point = " ".join(f"{key.lstrip('+')}={value}" for key, value in params.items())
    return [f"best objective {result_number(best_value)}: {point}", str(folder / _RESULTS)]


def _best_group(groups: Sequence[Group]) -> list[str]:
    """The group with the largest objective, if there are several."""
    from embodichain.learning.evaluation.comparison import best_group, short_labels

    best = best_group(groups)
    if best is None or len(groups) < 2:
        return []
    objective = best.number("objective")
    mean = "-" if objective is None else mean_of_seeds(objective)
    _, labels = short_labels(groups)
    label = labels[list(groups).index(best)]
    seeds = "1 seed" if len(best.runs) == 1 else f"{len(best.runs)} seeds"
    return [f"best objective {mean}: {label} ({seeds})"]


def _largest_objectives(groups: Sequence[Group]) -> list[int]:
    """The numbers, in order, of the groups whose curves are drawn."""
    means = {}
    for i, group in enumerate(groups):
        objective = group.number("objective")
        if objective is not None:
            means[i] = objective.mean
    largest = sorted(means, key=lambda i: -means[i])[:_MOST_CURVES]
    return sorted(largest)


def _page(folder: Path, groups: Sequence[Group], notes: Sequence[str]) -> str:
    from embodichain.cli.pages.curves import group_charts
    from embodichain.cli.pages.episodes import episodes_of
    from embodichain.cli.pages.galleries import Gallery, draw_episode
    from embodichain.cli.pages.page import render_page
    from embodichain.cli.pages.run_record import read_record
    from embodichain.learning.evaluation.comparison import best_group, short_labels

    title, rows = comparison_table(groups)
    _, labels = short_labels(groups)
    drawn = _largest_objectives(groups)
    page_notes = list(notes)
    best = best_group(groups)
    strip = Gallery()
    if best is not None:
        record = read_record(best.runs[0].folder)
        strip = draw_episode(record, episodes_of(record))
    if len(groups) > len(drawn):
        page_notes.append(f"curves of the {len(drawn)} groups with the largest objective")
    try:
        charts = group_charts([groups[i] for i in drawn], [labels[i] for i in drawn])
    except ValueError as error:  # curves of a group do not fit together
        charts = []
        page_notes.append(f"no curves: {error}")
    jobs = []
    for group, label in zip(groups, labels, strict=True):
        for run in group.runs:
            jobs.append(
                {
                    "job": run.folder.name,
                    "runs": label,
                    "seed": run.seed,
                    "objective": number(run.numbers.get("objective")),
                }
            )
    context = {
        "title": f"sweep {folder.name}",
        "heading": title,
        "folder": display_path(folder),
        "notes": page_notes,
        "results": _results(groups, labels, best),
        "strip": strip,
        "hints": too_few_seeds(groups),
        "best": _best_point(folder, groups) if _search_result(folder) else [],
        "rows": [{name: number(cell) for name, cell in row.items()} for row in rows],
        "charts": charts,
        "jobs": jobs,
        "command": f"embodichain compare {shlex.quote(display_path(folder))}",
    }
    return render_page("sweep.html.tmpl", context)


def _results(groups: Sequence[Group], labels: Sequence[str], best: Group | None) -> list[Result]:
    """What was found: the best point with its objective, and how much was tried."""
    from embodichain.cli.pages.headline import Result, seeds_result

    results = []
    objective = None if best is None else best.number("objective")
    if best is not None and objective is not None:
        is_share = any("objective" in run.trials for run in best.runs)
        result = seeds_result("best objective", objective, is_share=is_share)
        label = labels[list(groups).index(best)]
        results.append(dataclasses.replace(result, about=(label, *result.about)))
    num_runs = sum(len(group.runs) for group in groups)
    about = ("1 training",) if num_runs == 1 else (f"{num_runs} trainings",)
    results.append(Result("points", str(len(groups)), about=about))
    return results
