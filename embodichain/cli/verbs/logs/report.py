"""`embodichain report`: one HTML page about a run or a folder of runs, with all pictures inside."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import click

from embodichain.cli.terminal.last import announce_last
from embodichain.cli.terminal.output import print_json
from embodichain.cli.verb import complete_last, verb
from embodichain.utils.errors import ConfigError

__all__ = ["command"]

_PAGE = "report.html"
_INDEX = "index.html"


@dataclass(frozen=True)
class ReportOptions:
    """What was typed after `report`.

    Attributes:
        run: The folder of a run, a sweep or a study, a folder with runs below it, or ``last``.
        output: Path of a new page; None replaces that of the folder.
        film: Whether the page of a policy has a film, which takes seconds to draw.
        quiet: Print no progress and no report.
        json: Print the result as one JSON object.
    """

    run: str
    output: str | None
    film: bool
    quiet: bool
    json: bool


@verb(
    "report",
    ("report last", "of the newest run, into its folder"),
    ("report outputs", "an index of all runs: sort, search, compare two"),
    ("report outputs/studies/reach_light", "of a study, from what is done of it"),
    ("report outputs/latest -o reach.html", "into a file to send around"),
    options=ReportOptions,
    quiet=True,
)
@click.argument("run", metavar="RUN", shell_complete=complete_last)
@click.option("--output", "-o", metavar="OUT", help="A new file. Default: RUN/report.html.")
@click.option(
    "--film/--no-film",
    default=True,
    help="Film an episode of a training or an evaluation that has no film. Default: --film.",
)
def command(options: ReportOptions) -> None:
    """Write a page about a run or a training, an evaluation, a sweep or a study: RUN is its folder.

    The word `last` is the newest.

    Of a folder with runs below it, such as `outputs`, it is an index of these, `index.html`.
    The page in the folder is replaced, a file named by --output is not.

    Raises:
        ConfigError: If there is no such run, a file of it is damaged, or the page cannot be
            written.
    """
    from embodichain.utils.system.atomic import write_text

    folder = _find_folder(options.run)
    kind = _kind_of_page(folder)
    is_new_file = options.output is not None
    if options.output is not None:
        out = Path(options.output)
    else:
        out = folder / (_INDEX if kind == "index" else _PAGE)
    if is_new_file and os.path.lexists(out):
        raise ConfigError(f"{out} exists; it is never replaced")

    def say(line: str) -> None:
        if not options.quiet:
            sys.stderr.write(f"{line}\n")

    text = _page(folder, kind, out, say, draws_film=options.film)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_text(out, text, new=is_new_file)
    except OSError as error:
        raise ConfigError(f"cannot write {out}: {error}") from error
    num_bytes = len(text.encode())
    if options.json:
        print_json({"file": str(out), "bytes": num_bytes})
    elif not options.quiet:
        sys.stdout.write(f"{out}: {num_bytes / 1e6:.2f} MB\n")


def _kind_of_page(folder: Path) -> str:
    """What the page of a folder is of: a ``run``, ``study``, ``sweep``, or an ``index`` of runs.

    A sweep without a finished training has nothing to compare: its page is the index of its jobs.
    """
    from embodichain.cli.sweeps.sweep_report import has_finished_training
    from embodichain.config.run_folder import CONFIG, STUDY, SWEEP

    if (folder / CONFIG).is_file():
        return "run"
    if (folder / STUDY).is_file():
        return "study"
    if (folder / SWEEP).is_file() and has_finished_training(folder):
        return "sweep"
    return "index"


def _page(
    folder: Path, kind: str, out: Path, say: Callable[[str], None], *, draws_film: bool
) -> str:
    if kind == "run":
        from embodichain.cli.pages.run_page import page_of_run

        return page_of_run(folder, draws_film=draws_film, say=say)
    if kind == "study":
        from embodichain.cli.studies.results import read_results
        from embodichain.cli.studies.study_job import StudyFolder
        from embodichain.cli.studies.study_page import page_of_study

        place = StudyFolder(folder)
        study = place.read()
        return page_of_study(study, place, read_results(study, place), out, say)
    if kind == "sweep":
        from embodichain.cli.sweeps.sweep_report import page_of_sweep

        return page_of_sweep(folder)
    from embodichain.cli.pages.runs_index import page_of_runs

    return page_of_runs(folder, out, say)


def _find_folder(name: str) -> Path:
    """The folder of a run, a sweep or a study; of the word ``last``, the newest.

    Raises:
        ConfigError: There is no such run.
    """
    from embodichain.cli.sweeps.sweep_report import has_finished_training
    from embodichain.config.run_folder import CONFIG, STUDY, find_run, newest_run, whole_run

    newest = newest_run("outputs", CONFIG) if name == "last" else None
    if newest is None:
        return find_run(name)  # its error says that there is no run yet
    whole = whole_run(newest)
    # The page of a sweep compares trainings: without one, the page is of the run.
    if (whole / STUDY).is_file() or has_finished_training(whole):
        return announce_last(whole)
    return announce_last(newest)
