"""`embodichain collect`: record episodes of a policy until enough of them succeeded.

``resume=FOLDER`` adds to a collection in its own folder, with its own config.
"""

from __future__ import annotations

import sys

from embodichain.cli.jobs.job import execute, start
from embodichain.cli.jobs.resuming import resolve_resumed_collection, resuming_overrides
from embodichain.cli.jobs.work.collect_job import collect_job
from embodichain.cli.sweeps.sweep_jobs import read_summary
from embodichain.cli.terminal.output import print_json
from embodichain.cli.verb import JobOptions, command_line, job_arguments, verb

__all__ = ["command"]


@verb(
    "collect",
    ("collect task=pick_place episodes=1000", "1000 successes of the task's expert"),
    ("collect task=reach policy=last episodes=50", "those of a trained policy; any policy works"),
    ("collect resume=last", "continue after an interruption"),
    ("collect resume=FOLDER episodes=2000", "more, into the same folder"),
    ("collect task=pick_place num_envs=64 sim.num_threads=2", "64 environments at once"),
    options=JobOptions,
    keys=True,
    config_dir=True,
    quiet=True,
)
@job_arguments("collect")
def command(options: JobOptions) -> None:
    """Collect once, or once for each point of a sweep, or continue."""
    lines = resuming_overrides(options)
    if lines is None:
        start("collect", collect_job, options)
        return
    collection = resolve_resumed_collection(lines)
    folder = collection.folder
    root = collection.resolved.root
    has_summary = read_summary(folder).get("status") == "finished"
    if has_summary and collection.num_successes >= (root.episodes or 0):
        # No error: a shell's loop that resumes until it succeeds ends here.
        sys.stderr.write(
            f"finished already: {folder} has {collection.num_successes} successful episodes: "
            "episodes=N collects more\n"
        )
        if root.json:
            print_json(read_summary(folder))
        return
    execute(
        collection.resolved,
        collect_job,
        command_line(),
        folder=folder,
        verb="collect",
        is_continued=True,
    )
