"""The jobs of a sweep by their folders: finished ones are skipped, interrupted ones are resumed.

A sweep that is started again with the same `hydra.sweep.dir`, and a job that a cluster starts again
after a preemption or the death of a node, find the job's folder. Its files alone say what is left:

* finished: nothing; the objective is in `summary.json`;
* a training with a checkpoint to resume from: it continues in the same folder;
* a training that has learned, but was not evaluated to the end: the evaluation, again;
* anything else: all of it; the folder is kept under another name.
"""

from __future__ import annotations

import json
import logging
import os
import platform
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TextIO

import yaml

from embodichain.config.keys.schema import JobVerb
from embodichain.config.rerun import read_config
from embodichain.config.resolved import Resolved, dump_yaml
from embodichain.config.run_folder import CONFIG, SUMMARY, adopt
from embodichain.utils.errors import ConfigError, EmbodichainError, Problem
from embodichain.utils.system import platforms

__all__ = [
    "STUDY_JOB",
    "Entered",
    "JobStoppedError",
    "differences",
    "enter",
    "exclusive",
    "has_ended",
    "is_finished",
    "objective_in",
    "process_log",
    "read_summary",
    "state_in",
    "stop_mark",
]

STUDY_JOB = "study_job"
"""The root config of the jobs of studies, in the place of a verb."""
State = Literal["new", "finished", "resumable", "learned", "stopped"]
_MAY_DIFFER = (
    "quiet",
    "json",
    "traceback",
    "output_dir",
    "resume",
    "sim",
    "viewer",
    "wandb",
    "trust",
)
"""Keys that may differ when a job is started again: they change no result."""
_MOST_NAMED = 4
"""Differing keys that an error names."""
_LOGS = ".logs"
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Entered:
    """A job in its folder.

    Attributes:
        resolved: Its config, changed so that it continues.
        is_continued: Whether the folder has the job's config already.
        objective: The objective of a finished job; None for others.
        finished: Whether nothing is left to do.
    """

    resolved: Resolved
    is_continued: bool = False
    finished: bool = False
    objective: float | None = None


class JobStoppedError(EmbodichainError):
    """A signal ended a sweep before this job was finished.

    Unlike `Interrupted` it ends no other jobs.
    """


class JobRunsError(EmbodichainError):
    """Another process runs the job, or the study."""


@contextmanager
def enter(
    folder: Path,
    resolved: Resolved,
    verb: JobVerb,
    *,
    seed_is_drawn: bool = False,
    is_outdated: Callable[[], bool] = lambda: False,
) -> Iterator[Entered]:
    """Enter the folder of a job, which no other process can enter until the context is left.

    Args:
        folder: The folder, which may exist.
        resolved: The job's config.
        verb: The verb of the job.
        seed_is_drawn: Whether the config has no seed of its own; an earlier start's is then used.
        is_outdated: Whether what an existing folder has is of other inputs; the folder is then kept
            under another name. It is called when no other process is in the folder.

    Raises:
        ConfigError: The folder has another job, or cannot be made.
        JobRunsError: Another process runs the job.
    """
    resolved = resolved.pinned()
    with exclusive(folder, "job"):
        state = state_in(folder, verb)
        if state == "new":
            if not (folder / CONFIG).is_file():
                adopt(folder)
            yield Entered(resolved)
            return
        if is_outdated():
            _keep_as_earlier(folder)
            yield Entered(resolved)
            return
        earlier = read_config(folder / CONFIG)
        if seed_is_drawn:
            resolved = resolved.changed(seed=earlier.get("seed"))
        _check_same_config(folder, earlier, resolved)
        if state == "finished":
            objective = objective_in(folder)
            yield Entered(resolved, is_continued=True, finished=True, objective=objective)
            return
        if state == "stopped":
            new_name = _keep_as_earlier(folder)
            _log.warning("%s was not finished and has no checkpoint: kept as %s", folder, new_name)
            yield Entered(resolved)
            return
        if state == "resumable":
            resolved = resolved.changed(resume=str(folder.resolve()))
        _move_evaluation_files(folder)
        yield Entered(resolved, is_continued=True)


def state_in(folder: Path, verb: JobVerb) -> State:
    """Return what a job's folder says about the job.

    Raises:
        ConfigError: `summary.json` is damaged.
    """
    with suppress(OSError):
        if not (folder / CONFIG).stat().st_size:
            return "new"  # killed before the config was written
    if not (folder / CONFIG).is_file():
        return "new"
    if is_finished(folder, verb):
        return "finished"
    if verb != "train":
        return "stopped"
    if read_summary(folder).get("status") == "finished":
        return "learned"
    from embodichain.learning.training.keeper import find_resumable

    try:
        find_resumable(folder)
    except EmbodichainError:
        return "stopped"
    return "resumable"


def is_finished(folder: Path, verb: JobVerb) -> bool:
    """Whether nothing is left to do for the job of a folder."""
    summary = read_summary(folder)
    status = summary.get("status")
    if verb != "train":
        return status in ("finished", "max_steps")
    if status != "finished":
        return False
    evaluation = summary.get("eval") or {}
    if evaluation.get("complete"):
        return True
    eval_cfg = read_config(folder / CONFIG).get("eval") or {}
    return not eval_cfg.get("episodes")


def has_ended(folder: Path, verb: str) -> bool:
    """Whether a launcher has nothing left to do for the job of a folder.

    Args:
        folder: The job's folder.
        verb: The verb of the job, or ``study_job``: such a job writes its own errors into its
            folder, so it has ended whatever its status is.
    """
    if verb == STUDY_JOB:
        return "status" in read_summary(folder)
    return is_finished(folder, "train" if verb == "train" else "run")


def objective_in(folder: Path) -> float | None:
    """Return the objective of a finished job, from its `summary.json`."""
    summary = read_summary(folder)
    value = summary.get("objective", (summary.get("return") or {}).get("mean"))
    return None if value is None else float(value)


def read_summary(folder: Path) -> dict[str, Any]:
    """Return the content of `summary.json`; empty without the file.

    Raises:
        ConfigError: The file is damaged.
    """
    path = folder / SUMMARY
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise ConfigError(f"cannot read {path}: {error}") from error
    return summary if isinstance(summary, dict) else {}


def process_log(sweep: Path, name: str) -> Path:
    """Return the path of the output of a job's process, where a launcher keeps it.

    Args:
        sweep: The sweep's folder.
        name: The name of the job's folder.
    """
    return sweep / _LOGS / f"{name}.log"


def stop_mark(sweep: Path) -> Path:
    """Return the file that exists while a sweep is ending because of a signal.

    Args:
        sweep: The sweep's folder.
    """
    return sweep / ".stopped"


@contextmanager
def exclusive(folder: Path, noun: str) -> Iterator[None]:
    """Lock the folder's name; the lock ends with the process that has it (flock(2)).

    Args:
        folder: The folder, which need not exist.
        noun: What the folder is of, for messages: ``job`` or ``study``.

    Raises:
        JobRunsError: Another process has the lock.
        ConfigError: The folder above cannot be made.
    """
    path = folder.with_name(f".{folder.name}.lock")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        stream = path.open("a+", encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot make the run folder {folder}: {error}") from error
    with stream:
        try:
            import fcntl

            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            message = f"{folder}: another process runs this {noun} now{_owner(stream)}"
            raise JobRunsError(message) from error
        except (ImportError, OSError) as error:  # Windows, and some network file systems
            _log.warning("%s cannot be locked (%s): do not start it twice", folder, error)
        _note_owner(stream)
        yield


def _owner(stream: TextIO) -> str:
    """The process that has a lock, in brackets; empty where that is not known."""
    pid = platforms.locked_by(stream.fileno())
    if pid is not None:
        return f" (process {pid} on {platform.node()})"
    stream.seek(0)
    note = stream.read().strip()  # by a process of another machine
    return f" ({note})" if note else ""


def _note_owner(stream: TextIO) -> None:
    """Write into a lock's file which process has it, for the messages of other processes."""
    with suppress(OSError):  # the lock holds on a full disk, too
        stream.truncate(0)
        stream.write(f"process {os.getpid()} on {platform.node()}\n")
        stream.flush()


def _check_same_config(folder: Path, earlier: Mapping[str, Any], resolved: Resolved) -> None:
    """Check that a folder's job is the one with this config."""
    now = yaml.safe_load(dump_yaml(resolved.tree))
    changes = list(differences(_relevant_keys(earlier), _relevant_keys(now)))
    if not changes:
        return
    text = "; ".join(changes[:_MOST_NAMED])
    if len(changes) > _MOST_NAMED:
        text += f" and {len(changes) - _MOST_NAMED} more"
    message = f"{folder} has another job: {text}. Give another hydra.sweep.dir"
    raise ConfigError([Problem("hydra.sweep.dir", message)])


def _relevant_keys(config: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a config on which a job's results depend."""
    return {key: value for key, value in config.items() if key not in _MAY_DIFFER}


def differences(before: Any, now: Any, path: str = "") -> Iterator[str]:
    """``KEY is A there, B here`` for each value that differs."""
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        for key in dict.fromkeys([*before, *now]):
            key_path = f"{path}.{key}" if path else str(key)
            yield from differences(before.get(key), now.get(key), key_path)
    elif before != now:
        yield f"{path} is {before!r} there, {now!r} here"


def _keep_as_earlier(folder: Path) -> Path:
    """Rename a job's folder and claim it anew; return its new name."""
    new_name = _unused_path(folder.with_name(f"{folder.name}.earlier"))
    folder.rename(new_name)
    adopt(folder)
    return new_name


def _move_evaluation_files(folder: Path) -> None:
    """Move files of an evaluation that did not end into a folder of their own."""
    evaluation_files = [*folder.glob("rollout.*"), *folder.glob("eval.json")]
    if not evaluation_files:
        return
    earlier = _unused_path(folder / "earlier")
    earlier.mkdir()
    for path in evaluation_files:
        shutil.move(path, earlier / path.name)
    _log.warning("%s: files of an evaluation that did not end were moved there", earlier)


def _unused_path(path: Path) -> Path:
    """The path with the first number for which nothing exists."""
    number = 1
    while path.with_name(f"{path.name}-{number}").exists():
        number += 1
    return path.with_name(f"{path.name}-{number}")
