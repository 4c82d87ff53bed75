"""`summary.json` of a job: its results, or the error that ended it."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from embodichain.cli.jobs.job import Job
from embodichain.cli.terminal.output import to_json
from embodichain.config.run_folder import SUMMARY
from embodichain.utils.system.atomic import write_text

__all__ = ["failure_in_summary", "write_summary"]

_log = logging.getLogger(__name__)


def write_summary(job: Job, summary: Mapping[str, Any]) -> None:
    """Write `summary.json` into the folder of a job; values of variables are not in it."""
    text = to_json(job.resolved.record(summary), indent=2)
    write_text(job.folder / SUMMARY, text + "\n")


@contextmanager
def failure_in_summary(job: Job, facts: Mapping[str, Any]) -> Iterator[None]:
    """Write a `summary.json` about an exception that leaves the context, and raise it again.

    Args:
        job: The job.
        facts: What the summary says besides the error.
    """
    try:
        yield
    except Exception as error:
        try:
            write_summary(job, {**facts, "status": "failed", "error": repr(error)})
        except OSError as second:  # a full disk fails here too; the first error is reported
            _log.warning("%s could not be written: %s", SUMMARY, second)
        raise
