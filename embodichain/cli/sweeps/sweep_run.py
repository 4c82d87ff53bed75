"""Runs a planned sweep: its progress, and its failures."""

from __future__ import annotations

import importlib.util
import os
import re
import shlex
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from hydra.core.plugins import Plugins

from embodichain.cli.sweeps.launching import Cluster
from embodichain.cli.sweeps.sweep_jobs import is_finished, process_log, stop_mark
from embodichain.cli.sweeps.sweep_plan import Plan
from embodichain.cli.sweeps.sweep_progress import JobRow, job_rows, show_progress
from embodichain.cli.terminal.process import Interrupted, StopFlag
from embodichain.config.composition.registered_options import hydras_name
from embodichain.config.keys.launchers import LAUNCHERS
from embodichain.config.keys.schema import JobVerb
from embodichain.config.run_folder import CONFIG
from embodichain.utils.errors import ConfigError, EmbodichainError, Problem
from embodichain.utils.notes import shared_by_jobs
from embodichain.utils.system.processes import end_with, own_process

__all__ = ["JobStates", "JobsOfVerb", "SweepError", "run_sweep"]

_BACKEND = "loky"
_ENDED_BY = " ERROR   run: ended by "
_TAIL = 12
"""Lines of a log that are shown of a job that failed."""
_SIGNAL_PERIOD_S = 0.2
"""Time between two looks at whether a signal has come."""


class SweepError(EmbodichainError):
    """Jobs of a sweep failed."""


class JobStates(Protocol):
    """What the folders of a sweep say about its jobs."""

    @property
    def how_to_continue(self) -> str:
        """What to type so that unfinished jobs are done."""

    def begun(self) -> list[str]:
        """The names of the jobs that have begun, in order."""

    def is_finished(self, name: str) -> bool:
        """Whether nothing is left to do for a job."""

    def rows(self) -> list[JobRow]:
        """The states of the jobs that have begun, for the table of progress."""

    def log(self, name: str) -> Path:
        """The newest `run.log` of a job, which need not exist."""


@dataclass(frozen=True)
class JobsOfVerb:
    """The jobs of a sweep of one verb, each with one run in its folder.

    Attributes:
        plan: The sweep's plan.
        verb: The verb.
    """

    plan: Plan
    verb: JobVerb

    @property
    def how_to_continue(self) -> str:
        """See `JobStates`."""
        return f"the same command with hydra.sweep.dir={self.plan.folder} does the rest"

    def begun(self) -> list[str]:
        """See `JobStates`."""
        sweep = self.plan.folder
        names = {path.parent.name for path in sweep.glob(f"*/{CONFIG}")}
        names |= {path.stem for path in process_log(sweep, "0").parent.glob("*.log")}
        jobs = [name for name in names if ".earlier-" not in name]
        return sorted(jobs, key=lambda name: (len(name), name))  # 10 after 9

    def is_finished(self, name: str) -> bool:
        """See `JobStates`."""
        return is_finished(self.plan.folder / name, self.verb)

    def rows(self) -> list[JobRow]:
        """See `JobStates`."""
        return job_rows(self.plan.folder, self.plan.keys)

    def log(self, name: str) -> Path:
        """See `JobStates`."""
        return self.plan.folder / name / "run.log"


def run_sweep(
    plan: Plan,
    states: JobStates,
    job: Callable[[], Any],
    *,
    quiet: bool,
    jobs_are_quiet: bool = False,
) -> None:
    """Run a sweep with Hydra.

    Args:
        plan: Its plan.
        states: Reads the states of its jobs.
        job: Hydra's `main`.
        quiet: Whether only errors and the jobs' results are written.
        jobs_are_quiet: Whether no job shows its own progress, also where it is the only one.

    Raises:
        SweepError: Jobs failed. They are shown with the last lines of their logs.
        Exception: Any exception before the first job.
    """
    if plan.launcher in LAUNCHERS.names():
        _register(plan.launcher)
    if plan.note and not quiet:
        sys.stderr.write(f"{plan.note}\n{plan.folder}\n")
    stop = StopFlag()
    try:
        with ExitStack() as stack:
            stack.enter_context(shared_by_jobs())
            if (plan.is_parallel or jobs_are_quiet) and not quiet:
                stack.enter_context(show_progress(states.rows, plan.jobs))
            if plan.launcher == "joblib":
                stack.enter_context(_workers_of_joblib(stop, plan.folder))
            job()
    except KeyboardInterrupt as error:
        if plan.folder.is_dir():
            text = f"{str(error) or 'interrupted'}; {_count_finished(plan, states)}"
            raise Interrupted.by(getattr(error, "signal", None), text) from error
        raise
    except Exception as error:
        if stop.stopped is not None:
            text = f"interrupted ({stop.stopped}); {_count_finished(plan, states)}"
            raise Interrupted.by(stop.stopped, text) from error
        unfinished_jobs = _unfinished_jobs(states) if plan.folder.is_dir() else []
        if not unfinished_jobs or _is_about_hydra(error):
            raise
        killed_worker = _describe_killed_worker(error)
        sys.stderr.write(f"{killed_worker or error}\n")
        for name in unfinished_jobs:
            # Jobs that only ended with the killed worker have nothing to say.
            if not killed_worker or _has_logged_error(states.log(name)):
                _show_logs(name, states.log(name), process_log(plan.folder, name))
        raise SweepError(_count_finished(plan, states)) from error


@contextmanager
def _workers_of_joblib(stop: StopFlag, folder: Path) -> Iterator[None]:
    """Inside the context, workers of joblib save at a signal, and none outlives this process."""
    with _end_workers_with_process(), _save_workers_at_signal(stop, folder):
        yield


@contextmanager
def _end_workers_with_process() -> Iterator[None]:
    """Let the workers of joblib end with this process, also where it is killed.

    A worker waits for its next job and for the place of a result, in pipes that stay open as long
    as other workers live. Hydra names the backend that it uses; here that name means another one.
    """
    from joblib import register_parallel_backend
    from joblib._parallel_backends import LokyBackend

    parent = own_process()

    class Watched(LokyBackend):  # type: ignore[misc]
        """Loky's backend, whose workers watch their parent before they do anything else."""

        def configure(self, *args: Any, **kwargs: Any) -> Any:
            return super().configure(*args, initializer=end_with, initargs=(parent,), **kwargs)

    register_parallel_backend(_BACKEND, Watched)
    try:
        yield
    finally:
        register_parallel_backend(_BACKEND, LokyBackend)


@contextmanager
def _save_workers_at_signal(stop: StopFlag, folder: Path) -> Iterator[None]:
    """Let the workers of joblib save at a signal: an exception here would kill them.

    Afterwards the workers end: joblib would give them to the next sweep of this process, with the
    working directory and `sys.path` of this one.

    Args:
        stop: Set by a signal inside the context.
        folder: The sweep's folder; the jobs that have not begun find a mark in it.
    """
    from joblib.externals.loky import get_reusable_executor

    mark = stop_mark(folder)
    mark.unlink(missing_ok=True)
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(_SIGNAL_PERIOD_S):
            if stop.stopped is None:
                continue
            folder.mkdir(parents=True, exist_ok=True)
            mark.touch()
            for worker in _child_processes():
                with suppress(ProcessLookupError):
                    os.kill(worker, signal.SIGTERM)
            return

    thread = threading.Thread(target=watch, name="sweep signals", daemon=True)
    with stop:
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()
            mark.unlink(missing_ok=True)
            get_reusable_executor().shutdown()


def _child_processes() -> list[int]:
    """The child processes of this one (proc(5)); empty where there is no such file."""
    pids: list[int] = []
    for path in Path(f"/proc/{os.getpid()}/task").glob("*/children"):
        with suppress(OSError):
            pids += map(int, path.read_text().split())
    return pids


def _is_about_hydra(error: Exception) -> bool:
    """Whether keys of the sweep are wrong, such as its folder or the launcher's, and not a job."""
    return isinstance(error, ConfigError) and all(
        problem.path.startswith("hydra") for problem in error.problems
    )


def _register(launcher: str) -> None:
    """Make a launcher known to Hydra.

    Hydra takes launchers from the namespace package `hydra_plugins` only, whose modules it imports
    at every start. The class is registered under such a name instead.

    Args:
        launcher: Its name in `LAUNCHERS`.

    Raises:
        ConfigError: Its package is not installed.
    """
    entry: Cluster = LAUNCHERS[launcher]
    if entry.package and importlib.util.find_spec(entry.package) is None:
        requires = shlex.quote(entry.requires or entry.package)
        message = f"{launcher!r} needs a package: pip install {requires}"
        raise ConfigError([Problem("hydra/launcher", message)])
    Plugins.instance().class_name_to_class[hydras_name(entry.launcher)] = entry.launcher


def _unfinished_jobs(states: JobStates) -> list[str]:
    return [name for name in states.begun() if not states.is_finished(name)]


def _count_finished(plan: Plan, states: JobStates) -> str:
    """A sentence about finished and unfinished jobs, and how to continue."""
    unfinished = _unfinished_jobs(states)
    finished = [name for name in states.begun() if name not in unfinished]
    text = f"{len(finished)} of {plan.jobs} jobs are done"
    if finished:
        text += f": {', '.join(finished)}"
    if unfinished:
        text += f"; not done: {', '.join(unfinished)}"
    return f"{text}; {states.how_to_continue}"


def _describe_killed_worker(error: Exception) -> str:
    """The message about a worker of joblib that was killed; empty for another error."""
    if not any(kind.__name__ == "BrokenProcessPool" for kind in type(error).__mro__):
        return ""
    signals = dict.fromkeys(re.findall(r"[A-Z][A-Z0-9_]+\(-?\d+\)", str(error)))
    by_signal = f" ({', '.join(signals)})" if signals else ""
    return (
        f"a worker was killed{by_signal}, perhaps because there was no memory left; "
        "joblib has ended the other workers with it"
    )


def _has_logged_error(log: Path) -> bool:
    """Whether a job's log has an error, and did not just end with its process."""
    with suppress(OSError):
        return _ENDED_BY in log.read_text(encoding="utf-8", errors="replace")
    return False


def _show_logs(name: str, *logs: Path) -> None:
    """Write the last lines of a job's logs to stderr."""
    for path in logs:
        try:
            lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError:
            continue  # a job that did not begin has no run.log, one on this machine no other
        if lines:
            text = "".join(f"  {line}\n" for line in lines[-_TAIL:])
            sys.stderr.write(f"job {name} failed, the end of {path}:\n{text}")
