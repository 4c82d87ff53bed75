"""What one job of `run` or `train` starts with: its checked config, its folder, its log file.

A job is what Hydra calls: once, or once for each point of a sweep, perhaps in another process.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.cli.logs import log_to
from embodichain.cli.stopping import StopFlag

if TYPE_CHECKING:
    from embodichain.config.resolve import Resolved, Verb
    from embodichain.config.schema import RootCfg

__all__ = ["COMMAND_VARIABLE", "LOG_FILE", "Job", "check", "execute", "failure"]

LOG_FILE = "run.log"
COMMAND_VARIABLE = "EMBODICHAIN_COMMAND"
"""Environment variable with the command line as typed, for the workers of a sweep."""

# Configs that were checked before Hydra started, by their overrides as Hydra gives them to a job.
_checked: dict[tuple[str, ...], Resolved] = {}
_failures: list[Exception] = []


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


def check(
    verb: Verb, overrides: Sequence[str], relaxed: Sequence[str], config_dir: str | None
) -> None:
    """Check a config as a whole before anything starts.

    Args:
        verb: Whose suggested values count.
        overrides: As typed.
        relaxed: As Hydra gets them.
        config_dir: Searched first.

    Raises:
        ConfigError: Every mistake in it.
    """
    from embodichain.config.resolve import resolve

    key = tuple(o for o in relaxed if not _is_hydras(o))
    _checked[key] = resolve(overrides, verb, config_dir=config_dir)


def execute(verb: Verb, body: Callable[[Job, StopFlag], float | None]) -> float | None:
    """Do what a job is for; this is what Hydra calls, by way of the verb's decorated function.

    Args:
        verb: Whose job it is.
        body: Gets the job and a flag that says when to stop; returns what a sweeper may optimise.

    Raises:
        Exception: Whatever `body` raises, in a sweep. Of a single run it is kept for `failure`:
            Hydra would print about it.
    """
    try:
        with _started(verb) as job, StopFlag() as stop:
            return body(job, stop)
    except Exception as error:
        if _is_sweep():
            raise
        _failures.append(error)
        return None


def failure() -> Exception | None:
    """Return what ended the single run of this process, once."""
    return _failures.pop() if _failures else None


@contextmanager
def _started(verb: Verb) -> Iterator[Job]:
    """Give a job its config and its folder, and log what happens within."""
    from hydra.core.hydra_config import HydraConfig

    from embodichain.config.run_folder import adopt, claim, write_record

    hydra = HydraConfig.get()
    resolved = _pinned(_resolved(verb, hydra.overrides.task))
    root = resolved.root
    if _is_sweep():
        folder = adopt(hydra.runtime.output_dir)
    else:
        folder = claim(root.output_dir, resolved.task_name)
    command = os.environ.get(COMMAND_VARIABLE, f"embodichain {verb}")
    write_record(folder, resolved, shlex.split(command))
    with log_to(folder / LOG_FILE) as log:
        log.info("command: %s", command)
        yield Job(resolved, root, folder)
        log.info("done")


def _is_sweep() -> bool:
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode

    return HydraConfig.get().mode == RunMode.MULTIRUN


def _resolved(verb: Verb, overrides: Sequence[str]) -> Resolved:
    """The config that was checked before, else (in a worker of a sweep) checked here."""
    from embodichain.config.compose import from_hydra
    from embodichain.config.resolve import resolve

    known = _checked.pop(tuple(overrides), None)
    return known if known is not None else resolve(from_hydra(), verb)


def _pinned(resolved: Resolved) -> Resolved:
    """Replace `last` and links by the folder they mean now: this run's own is the newest next."""
    from embodichain.config.freeze import freeze
    from embodichain.config.run_folder import find_run

    policy = resolved.tree["policy"]
    if not isinstance(policy, str) or not (policy == "last" or Path(policy).exists()):
        return resolved
    path = find_run(policy, resolved.tree["output_dir"]) if policy == "last" else Path(policy)
    return replace(resolved, tree=freeze({**resolved.tree, "policy": str(path.resolve())}))


def _is_hydras(override: str) -> bool:
    return override.lstrip("+~").startswith(("hydra.", "hydra/"))
