"""What one job of `run` or `train` starts with: its checked config, its folder, its log file.

A job is called once, or by Hydra once for each point of a sweep, perhaps in another process.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.cli.labels import told_apart
from embodichain.cli.logs import log_to
from embodichain.cli.stopping import StopFlag
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved, Verb
    from embodichain.config.schema import RootCfg

__all__ = ["COMMAND_VARIABLE", "LOG_FILE", "Job", "execute", "given"]

LOG_FILE = "run.log"
COMMAND_VARIABLE = "EMBODICHAIN_COMMAND"
"""Environment variable with the command line as typed, for the workers of a sweep."""

_given: ContextVar[Resolved | None] = ContextVar("given", default=None)


@dataclass(frozen=True, slots=True)
class Job:
    """One run.

    Attributes:
        resolved: Its config, as written to files.
        root: The same as data classes.
        folder: Its own folder.
    """

    resolved: Resolved
    root: RootCfg
    folder: Path


@contextmanager
def given(resolved: Resolved) -> Iterator[None]:
    """Let a job that is called here, without Hydra, have this config."""
    token = _given.set(resolved)
    try:
        yield
    finally:
        _given.reset(token)


def execute(verb: Verb, body: Callable[[Job, StopFlag], float | None]) -> float | None:
    """Do what a job is for: give it its config and its folder, and log what happens.

    Args:
        verb: Whose job it is.
        body: Gets the job and a flag that says when to stop; returns what a sweeper may optimise.

    Raises:
        ConfigError: The config is wrong, or no folder can be made.
        Exception: Whatever `body` raises.
    """
    from embodichain.config.run_folder import write_record

    resolved, folder = _claim(verb)
    command = os.environ.get(COMMAND_VARIABLE, f"embodichain {verb}")
    write_record(folder, resolved, shlex.split(command))
    with (
        told_apart(json=resolved.tree["json"]),
        log_to(folder / LOG_FILE) as log,
        StopFlag() as stop,
    ):
        log.info("command: %s", command)
        for note in resolved.notes:
            log.warning("%s", note)
        with resolved.locating():
            value = body(Job(resolved, resolved.root, folder), stop)
        log.info("done")
        return value


def _claim(verb: Verb) -> tuple[Resolved, Path]:
    """The job's config, and the folder that is its own: a sweep's jobs have fixed ones."""
    from embodichain.config.run_folder import adopt, claim

    resolved = _given.get()
    if resolved is None:
        from hydra.core.hydra_config import HydraConfig
        from hydra.types import RunMode

        from embodichain.config.composed import from_hydra
        from embodichain.config.resolved import resolve

        resolved = resolve(from_hydra(), verb)
        if HydraConfig.get().mode == RunMode.MULTIRUN:
            return _pinned(resolved), adopt(HydraConfig.get().runtime.output_dir)
    resolved = _pinned(resolved)
    return resolved, claim(resolved.tree["output_dir"], resolved.task_name)


def _pinned(resolved: Resolved) -> Resolved:
    """Replace `last` and links by the folder they mean now: the next run changes that."""
    from embodichain.config.frozen import freeze
    from embodichain.config.newest import CHECKPOINT, named_checkpoint, newest_run

    policy = resolved.tree["policy"]
    last = policy == "last"
    if not isinstance(policy, str) or not (last or named_checkpoint(policy).exists()):
        return resolved
    path = newest_run(resolved.tree["output_dir"], CHECKPOINT) if last else named_checkpoint(policy)
    if path is None:
        raise ConfigError("policy: the training that 'last' meant is gone")
    return replace(resolved, tree=freeze({**resolved.tree, "policy": str(path.resolve())}))
