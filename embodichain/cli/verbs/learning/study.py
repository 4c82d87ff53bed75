"""`embodichain study`: train, evaluate and compare what one YAML file declares; resumable."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import click

from embodichain.cli.terminal.output import print_json, print_table
from embodichain.cli.terminal.process import FAILED
from embodichain.cli.verb import verb

__all__ = ["command"]


@dataclass(frozen=True)
class StudyOptions:
    """What was typed after `study`.

    Attributes:
        name: The study, a file of the group `study`.
        words: Overrides of its keys and of Hydra's.
        dry_run: Print the jobs instead of running them.
        quiet: Print no progress and no tables.
        json: Print the result as one JSON object.
    """

    name: str
    words: tuple[str, ...]
    dry_run: bool
    quiet: bool
    json: bool


@verb(
    "study",
    ("study reach_light", "train, evaluate and compare; again: go on where it stopped"),
    ("study reach_light 'seeds=[0,1]' '~arms.expert'", "fewer seeds, one arm less"),
    ("study reach_light --dry-run", "the jobs, and what is left of each"),
    ("study reach_light hydra/launcher=slurm", "jobs on a cluster"),
    options=StudyOptions,
    config_dir=True,
    quiet=True,
)
@click.argument("name", metavar="NAME")
@click.argument("words", nargs=-1, metavar="[KEY=VALUE]...")
@click.option("--dry-run", is_flag=True, help="Print the jobs instead of running them.")
def command(options: StudyOptions) -> int | None:
    """Run what is left of a study, and write its results."""
    from embodichain.cli.studies.dry_run import job_table
    from embodichain.cli.studies.results import write_results
    from embodichain.cli.studies.run_study import folder_of, run_jobs, run_searches
    from embodichain.cli.studies.start_checks import check_policies, check_searches
    from embodichain.cli.studies.study_page import write_page
    from embodichain.cli.sweeps.sweep_run import SweepError
    from embodichain.config.study import check_jobs, resolve_study

    quiet = options.quiet or options.json
    hydra_lines = [word for word in options.words if _is_hydras(word)]
    lines = [word for word in options.words if not _is_hydras(word)]
    study = resolve_study(options.name, lines)
    check_jobs(study)
    check_searches(study)
    place = folder_of(study)
    check_policies(study, place)

    def say(line: str) -> None:
        if not quiet:
            sys.stderr.write(f"{line}\n")

    if options.dry_run:
        title, rows = job_table(study, place, say)
        if options.json:
            print_json({"jobs": rows})
        else:
            print_table(title, rows)
        return None
    with place.exclusive():
        place.write(study)
        run_searches(study, place, hydra_lines)
        killed: SweepError | None = None
        try:
            run_jobs(study, place, hydra_lines, quiet=quiet)
        except SweepError as error:  # what the other jobs have done is not lost
            killed = error
        unfinished = [job for job in study.jobs() if not place.is_finished(job)]
        if place.has_results(study):
            results = write_results(study, place)
            page = write_page(study, place, results, say)
            if options.json:
                print_json(results.as_dict())
            elif not options.quiet:
                for title, rows in results.tables():
                    print_table(title, rows)
                sys.stdout.write("".join(f"{note}\n" for note in results.notes))
                sys.stdout.write(f"{page}\n")
    for job in unfinished:
        _say_failure(job.name, place.failure(job))
    if killed is not None:
        raise killed
    if unfinished:
        sys.stderr.write(f"{len(unfinished)} of {len(study.jobs())} jobs failed; the same command ")
        sys.stderr.write("runs them again\n")
        return FAILED
    return None


def _say_failure(name: str, failure: Mapping[str, Any] | None) -> None:
    """Say what ended a job, with the last lines of its log."""
    if failure is None:  # its process was killed
        sys.stderr.write(f"{name}: not finished\n")
        return
    sys.stderr.write(f"{name}: {failure['stage']} failed: {failure['error']}\n")
    sys.stderr.write("".join(f"  {line}\n" for line in failure["last_lines"]))


def _is_hydras(word: str) -> bool:
    return word.lstrip("+~").startswith(("hydra.", "hydra/"))
