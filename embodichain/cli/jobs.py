"""A job: one run or training with its checked config, its folder and its log file."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from embodichain.cli.logs import label_lines, log_to
from embodichain.cli.process import StopFlag
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.config.composed import Composed
    from embodichain.config.resolved import Resolved
    from embodichain.config.schema import RootCfg

__all__ = ["FRESH", "LOG_FILE", "Body", "Job", "Verb", "execute", "resolved_job"]

LOG_FILE = "run.log"
FRESH: dict[str, Any] = {
    **{"quiet": False, "json": False, "traceback": False, "resume": None, "allow_changed": False},
    **{"max_steps": None, "video": None, "total_timesteps": None, "algo": None},
    **{"output_dir": "outputs"},
}
"""Root keys of a run's config that do not carry over to another run of it."""
Verb = Literal["run", "train"]


@dataclass(frozen=True, slots=True)
class Job:
    """One run.

    Attributes:
        resolved: Its config.
        folder: Its own folder.
    """

    resolved: Resolved
    folder: Path

    @property
    def root(self) -> RootCfg:
        """The config as data classes."""
        return self.resolved.root

    @property
    def quiet(self) -> bool:
        """Whether nothing is shown besides the result."""
        return self.root.quiet or self.root.json


Body = Callable[[Job, StopFlag], float | None]
"""What a job does; returns what a sweeper may optimise."""


def resolved_job(composed: Composed, verb: Verb) -> Resolved:
    """Check a job's config as a whole; for a training, the arguments of its algorithm too.

    Raises:
        ConfigError: Every mistake, with its place.
    """
    from embodichain.config.resolved import resolve

    resolved = resolve(composed, verb)
    if verb == "train":
        from embodichain.learning.train import check_training

        with resolved.locating():
            check_training(resolved)
    return resolved


def execute(
    resolved: Resolved,
    body: Body,
    command: Sequence[str],
    folder: Path | None = None,
    label: str | None = None,
) -> float | None:
    """Do a job: give it its folder, and log what happens.

    Args:
        resolved: Its config.
        body: What it does.
        command: The command line, as typed.
        folder: Its folder; None claims a new one.
        label: Begins the lines that it prints, where other jobs print at the same time.

    Raises:
        ConfigError: No folder can be made.
        Exception: Whatever `body` raises.
    """
    from embodichain.config.resolved import write_record
    from embodichain.config.run_folder import claim

    resolved = _pinned(resolved)
    if folder is None:
        folder = claim(resolved.root.output_dir, resolved.task_name)
    write_record(folder, resolved, command)
    labelled = nullcontext() if label is None else label_lines(label, json=resolved.root.json)
    with labelled, log_to(folder / LOG_FILE) as log, StopFlag() as stop:
        log.info("command: %s", shlex.join(command))
        for note in resolved.notes:
            log.warning("%s", note)
        with resolved.locating():
            value = body(Job(resolved, folder), stop)
        log.info("done")
        return value


def _pinned(resolved: Resolved) -> Resolved:
    """Replace `last` and links by the folder that they mean now: the next run changes that."""
    from embodichain.config.run_folder import CHECKPOINT, named_checkpoint, newest_run

    policy = resolved.tree["policy"]
    last = policy == "last"
    if not isinstance(policy, str) or not (last or named_checkpoint(policy).exists()):
        return resolved
    path = newest_run(resolved.tree["output_dir"], CHECKPOINT) if last else named_checkpoint(policy)
    if path is None:
        raise ConfigError("policy: the training that 'last' meant is gone")
    return resolved.changed(policy=str(path.resolve()))
