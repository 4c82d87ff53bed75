"""Hydra's own `main`: sweeps, `--cfg` and `--info`.

Sweeps are run by Hydra's basic sweeper and launcher, or by the plug-ins of the extra `sweep`:
`hydra/launcher=joblib` and `hydra/sweeper=optuna`. The configs of all jobs are checked before a
sweep starts.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TextIO

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import IntervalSweep, Override
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from embodichain.cli.sweeps.hydra_folders import check_subfolders, folder_named, numbers_jobs
from embodichain.cli.sweeps.sweep_jobs import JobStoppedError, enter, stop_mark
from embodichain.cli.sweeps.sweep_plan import (
    Plan,
    compose_for_hydra,
    plan_sweep,
    with_sweepers_params,
)
from embodichain.cli.sweeps.sweep_progress import job_label
from embodichain.cli.sweeps.sweep_run import JobsOfVerb, JobStates, run_sweep
from embodichain.cli.terminal.plain_text import degrading_text
from embodichain.cli.terminal.process import Interrupted
from embodichain.cli.verb import JobOptions
from embodichain.config.checks.viewer_access import refuse_token
from embodichain.config.composition.composed import (
    WITHOUT_TASK,
    compose,
    from_hydra,
    relax,
    search_path,
)
from embodichain.config.composition.hydra_loader import (
    VERSION_BASE,
    chosen_config_dir,
    config_loader,
    searched,
    user_configs,
)
from embodichain.config.composition.override_text import malformed
from embodichain.config.keys.schema import JobVerb
from embodichain.config.resolved import Resolved, resolve
from embodichain.config.run_folder import adopt, check_unused, missing_folders, take_back
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["call_hydra", "launch_jobs", "points", "towards_scores"]

_RUN_FOLDER = "hydra.run.dir"
_DIRECTION = "hydra.sweeper.direction"
_MOST_CHECKED_JOBS = 64
_BASIC_LAUNCHER = "BasicLauncher"
_JOBLIB_LAUNCHER = "JoblibLauncher"
_BASIC_SWEEPER = "BasicSweeper"


class RunJob(Protocol):
    """Runs a checked job, see `embodichain.cli.jobs.job.execute`."""

    def __call__(
        self,
        resolved: Resolved,
        *,
        folder: Path | None = None,
        is_continued: bool = False,
        in_sweep: bool = False,
        undo_claim: Callable[[], None] | None = None,
    ) -> float | None: ...


def call_hydra(
    verb: JobVerb,
    check: Callable[[Sequence[str]], Resolved],
    run_job: RunJob,
    options: JobOptions,
    *,
    overrides: Sequence[str],
) -> None:
    """Call Hydra's `main` for a verb; its exceptions are raised unchanged.

    Args:
        verb: The verb, ``run`` or ``train``.
        check: Checks the config of one job.
        run_job: Runs a job.
        options: `cfg`, `info`, `multirun`, `package`, `resolve`.
        overrides: As typed.

    Raises:
        ConfigError: Mistakes in the config of any job; no job was started.
    """
    plan: Plan | None = None
    new_folders: list[Path] = []
    errors: list[Exception] = []
    has_gym_config = any(line.lstrip("+").startswith("gym_config=") for line in overrides)
    if options.cfg is not None or options.info is not None:
        if options.cfg is not None and has_gym_config:
            raise ConfigError("--cfg prints YAML only: embodichain convert prints a gym config")
        composed = compose(overrides, verb)
        if composed.problems:
            raise ConfigError(composed.problems)
        _check_package(verb, options, overrides)
    elif options.multirun:
        plan = _check_sweep(verb, check, overrides)
        overrides = plan.overrides
    else:
        check(overrides)
        new_folders = _check_run_folder(verb, overrides)
    keys = plan.keys if plan is not None else ()
    config_dir = chosen_config_dir()

    # Pickled by value for the workers of a sweep, with its closure.
    @hydra.main(**VERSION_BASE, config_path="pkg://embodichain.conf", config_name=verb)
    def job(_: DictConfig) -> float | None:
        with user_configs(config_dir):
            composed = from_hydra()
            resolved = resolve(composed, verb)
        # In a worker, too, whose streams are its own.
        with degrading_text(), _labelled_lines(_label(keys), json=resolved.root.json):
            if HydraConfig.get().mode == RunMode.MULTIRUN:
                seed_is_drawn = composed.tree.get("seed") is None
                return _run_in_sweep(run_job, resolved, verb, seed_is_drawn=seed_is_drawn)
            if HydraConfig.get().run.dir == ".":
                return run_job(resolved)
            try:
                return _run_in_folder(run_job, resolved, new_folders)
            except Exception as error:  # noqa: BLE001  (raised below: Hydra adds a line of its own)
                errors.append(error)
                return None

    with config_loader() as loader:
        arguments = [*_flags(options), *relax(overrides, loader)]
    if has_gym_config:
        arguments.append(WITHOUT_TASK)
    places, _ = search_path(overrides)
    with searched(places), _process(f"embodichain {verb}", arguments):
        if plan is None:
            job()
            if errors:
                raise errors[0]
        else:
            quiet = options.quiet or options.json
            run_sweep(plan, JobsOfVerb(plan, verb), job, quiet=quiet)
            if verb == "train":
                from embodichain.cli.sweeps.sweep_report import report_sweep

                report_sweep(plan.folder, quiet=quiet)


def launch_jobs(
    config_name: str,
    run_job: Callable[[DictConfig], None],
    plan: Plan,
    states: JobStates,
    *,
    quiet: bool,
) -> None:
    """Run the jobs of a plan with Hydra's launchers, where a job is not that of a verb.

    Args:
        config_name: The root config of the jobs.
        run_job: Runs the job of a composed config; it is pickled for the workers of a launcher.
        plan: The jobs, see `plan_sweep`.
        states: Reads the states of the jobs.
        quiet: Whether to show no progress.

    Raises:
        SweepError: Jobs were killed.
        Interrupted: A signal came.
    """
    config_dir = chosen_config_dir()

    @hydra.main(**VERSION_BASE, config_path="pkg://embodichain.conf", config_name=config_name)
    def job(config: DictConfig) -> None:
        # In a worker, too, whose streams are its own.
        with user_configs(config_dir), degrading_text():
            if stop_mark(Path(HydraConfig.get().sweep.dir)).exists():
                raise JobStoppedError("the sweep was interrupted before this job")
            with _replace_interrupt():
                run_job(config)

    with config_loader() as loader:
        arguments = ["--multirun", *relax(plan.overrides, loader)]
    places, _ = search_path(plan.overrides)
    with searched(places), _process(f"embodichain {config_name}", arguments):
        run_sweep(plan, states, job, quiet=quiet, jobs_are_quiet=True)


def _check_package(verb: JobVerb, options: JobOptions, overrides: Sequence[str]) -> None:
    """Refuse a `--package` that the config does not have, which Hydra does without an error.

    Raises:
        ConfigError: There is no such key.
    """
    package = options.package
    if options.cfg is None or package is None or package in ("_global_", ""):
        return
    config = compose_for_hydra(verb, overrides, RunMode.RUN)
    parent, _, name = package.rpartition(".")
    node: Any = OmegaConf.select(config, parent) if parent else config
    if isinstance(node, DictConfig) and name in node:
        return
    names = [str(key) for key in node] if isinstance(node, DictConfig) else []
    message = f"there is no {package!r} in the config; there are: {listing(names, name)}."
    raise ConfigError([Problem("--package", message, did_you_mean(name, names).strip())])


def _check_sweep(
    verb: JobVerb, check: Callable[[Sequence[str]], Resolved], overrides: Sequence[str]
) -> Plan:
    """Check the jobs of a sweep as far as they are known, and plan it."""
    _parse(overrides)
    refuse_token(overrides)
    overrides = with_sweepers_params(verb, overrides)
    jobs = list(points(overrides, _MOST_CHECKED_JOBS))
    checked_jobs = [check(job_overrides) for job_overrides in jobs]
    if not numbers_jobs(compose_for_hydra(verb, jobs[0])):
        check_subfolders([compose_for_hydra(verb, job_overrides) for job_overrides in jobs])
    return plan_sweep(verb, towards_scores(overrides), checked_jobs[0])


def _run_in_sweep(
    run_job: RunJob, resolved: Resolved, verb: JobVerb, *, seed_is_drawn: bool
) -> float | None:
    """Run a job of a sweep in its folder, or what is left of it; return its objective.

    Args:
        run_job: Runs a job.
        resolved: The job's config.
        verb: The verb of the job.
        seed_is_drawn: Whether the config has no seed of its own.
    """
    folder = Path(HydraConfig.get().runtime.output_dir)
    if stop_mark(Path(HydraConfig.get().sweep.dir)).exists():
        raise JobStoppedError("the sweep was interrupted before this job")
    with enter(folder, resolved, verb, seed_is_drawn=seed_is_drawn) as entered:
        objective = entered.objective
        if not entered.finished:
            with _replace_interrupt():
                objective = run_job(
                    entered.resolved,
                    folder=folder,
                    is_continued=entered.is_continued,
                    in_sweep=True,
                )
        elif not resolved.root.quiet:
            sys.stderr.write(f"finished already: {folder}\n")
        _check_objective(objective, verb, resolved)
        return objective


def _run_in_folder(
    run_job: RunJob, resolved: Resolved, new_folders: Sequence[Path]
) -> float | None:
    """Run the only job of a command in the folder of `hydra.run.dir`.

    Args:
        run_job: Runs a job.
        resolved: The job's config.
        new_folders: Folders that Hydra has made for it; they are removed if the job is refused.
    """
    folder = Path(HydraConfig.get().runtime.output_dir)
    names_before = {entry.name for entry in folder.iterdir()}
    removed = [folder, *new_folders] if new_folders else []
    undo = partial(take_back, folder, names_before, removed)
    return run_job(resolved, folder=adopt(folder), undo_claim=undo)


def _check_run_folder(verb: JobVerb, overrides: Sequence[str]) -> list[Path]:
    """Refuse a folder in `hydra.run.dir` that cannot be made; Hydra's own errors have no sentence.

    Returns:
        The folders that will be made, the innermost first.
    """
    config = compose_for_hydra(verb, overrides, RunMode.RUN)
    is_typed = any(line.lstrip("+").startswith(f"{_RUN_FOLDER}=") for line in overrides)
    folder = folder_named(config, _RUN_FOLDER)
    if not is_typed and folder == ".":
        return []  # the run claims one
    try:
        new_folders = missing_folders(folder)
        check_unused(folder)
        Path(folder).mkdir(parents=True, exist_ok=True)
        for path in new_folders:  # Hydra makes it again, by another name if the name has the time
            path.rmdir()
    except ConfigError as error:
        raise ConfigError([Problem(_RUN_FOLDER, p.message) for p in error.problems]) from error
    except OSError as error:
        message = f"cannot make the run folder {folder}: {error}"
        raise ConfigError([Problem(_RUN_FOLDER, message)]) from error
    return new_folders


def points(overrides: Sequence[str], most: int) -> Iterator[list[str]]:
    """Yield the overrides of each job of a sweep, as far as they are known before it starts.

    A search chooses its points while it runs; for it, only the first value of each key is used.

    Args:
        overrides: As typed, with sweeps.
        most: Largest number of jobs to yield.

    Raises:
        ConfigError: Lists the overrides that are malformed.
    """
    from hydra._internal.core_plugins.basic_sweeper import BasicSweeper

    parsed = _parse(overrides)
    if _is_search(overrides) or any(override.is_interval_sweep() for override in parsed):
        yield [_first_value(override) for override in parsed]
        return
    for batch in BasicSweeper.split_arguments(parsed, max_batch_size=most)[:1]:
        yield from (list(job) for job in batch)


def _parse(overrides: Sequence[str]) -> list[Override]:
    """Parse overrides with Hydra's parser; raise a `ConfigError` that lists the malformed ones."""
    parser = OverridesParser.create()
    parsed: list[Override] = []
    problems: list[Problem] = []
    for line in overrides:
        try:
            parsed.append(parser.parse_override(line))
        except HydraException as error:
            problems.append(malformed(line, error))
    if problems:
        raise ConfigError(problems)
    return parsed


def towards_scores(overrides: Sequence[str]) -> list[str]:
    """Make a search maximize the objective unless a direction is typed; Optuna minimizes.

    Args:
        overrides: As typed.
    """
    has_direction = any(line.lstrip("+").startswith(f"{_DIRECTION}=") for line in overrides)
    if _is_search(overrides) and not has_direction:
        return [*overrides, f"{_DIRECTION}=maximize"]
    return list(overrides)


def _is_search(overrides: Sequence[str]) -> bool:
    return "hydra/sweeper=optuna" in overrides


def _first_value(override: Override) -> str:
    """The override with the first value of its sweep."""
    line = override.input_line or ""
    if not override.is_sweep_override():
        return line
    value = override.value()
    if isinstance(value, IntervalSweep):
        return f"{override.get_key_element()}={value.start}"
    return f"{override.get_key_element()}={next(iter(override.sweep_string_iterator()))}"


def _check_objective(objective: float | None, verb: JobVerb, resolved: Resolved) -> None:
    """Refuse a job without an objective in a search, which has nothing to compare then."""
    is_search = not _has_target(HydraConfig.get().sweeper, _BASIC_SWEEPER)
    if objective is not None or not is_search:
        return
    message = "a search compares the objectives of its jobs, and this job has none: "
    if verb != "train":
        message += f"{verb} has no objective; use train"
        raise ConfigError([Problem("hydra.sweeper", message)])
    if resolved.root.eval.episodes == 0:
        message += "eval.episodes=0, and the training finished no episode; set eval.episodes"
        raise ConfigError([Problem("eval.episodes", message)])
    message += "no episode was finished; use a larger total_timesteps or shorter episodes"
    raise ConfigError([Problem("total_timesteps", message)])


@contextmanager
def _replace_interrupt() -> Iterator[None]:
    """In a worker of joblib, replace an interrupt, for which joblib would kill other workers."""
    try:
        yield
    except Interrupted as error:
        if _has_target(HydraConfig.get().launcher, _JOBLIB_LAUNCHER):
            raise JobStoppedError(str(error)) from error
        raise


def _has_target(plugin: DictConfig, name: str) -> bool:
    """Whether a node of Hydra's config is for the plug-in class of a name."""
    return str(plugin.get("_target_", "")).endswith(name)


def _label(keys: Sequence[str]) -> str | None:
    """``[NUMBER KEY=VALUE ...]`` of a job among several at once, else None."""
    config = HydraConfig.get()
    if config.mode != RunMode.MULTIRUN or _has_target(config.launcher, _BASIC_LAUNCHER):
        return None
    if threading.current_thread() is not threading.main_thread():
        return None
    return f"[{job_label(str(config.job.num), config.overrides.task, keys)}] "


@contextmanager
def _labelled_lines(label: str | None, *, json: bool) -> Iterator[None]:
    """Prefix each line printed inside the context with a label.

    Args:
        label: The label and a blank; None changes nothing.
        json: Whether stdout is JSON; its lines are then not changed.
    """
    stdout = sys.stdout
    stderr = sys.stderr
    if label is not None:
        sys.stderr = _LabelledStream(stderr, label)
        if not json:
            sys.stdout = _LabelledStream(stdout, label)
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        sys.stdout = stdout
        sys.stderr = stderr


class _LabelledStream:
    """A text stream that prefixes each line with a label and writes it at once.

    It is not a terminal even if `stream` is: bars of several jobs would overwrite each other.

    Attributes:
        is_of_sweep: True: progress is not shown here, but in the sweep's table.
    """

    is_of_sweep = True

    def __init__(self, stream: TextIO, label: str) -> None:
        self._stream = stream
        self._label = label
        self._incomplete_line = ""

    def write(self, text: str) -> int:
        *lines, self._incomplete_line = (self._incomplete_line + text).split("\n")
        if lines:
            labelled = [f"{self._label}{line}\n" if line else "\n" for line in lines]
            self._stream.write("".join(labelled))
            self._stream.flush()
        return len(text)

    def flush(self) -> None:
        """Write the remaining text as a line."""
        if self._incomplete_line:
            self.write("\n")

    def isatty(self) -> bool:
        return False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _flags(options: JobOptions) -> list[str]:
    """Hydra's flags, which its parser accepts only before the overrides."""
    flags = []
    if options.multirun:
        flags.append("--multirun")
    if options.resolve:
        flags.append("--resolve")
    for name in ("cfg", "package", "info"):
        value = getattr(options, name)
        if value is not None:
            flags += [f"--{name}", value]
    return flags


@contextmanager
def _process(program: str, arguments: list[str]) -> Iterator[None]:
    """Put arguments into `sys.argv`, where Hydra reads them, and let its exceptions through.

    Hydra's changes to `logging` are undone afterwards.
    """
    argv = sys.argv
    full_error = os.environ.get("HYDRA_FULL_ERROR")
    root = logging.getLogger()
    handlers = root.handlers[:]
    level = root.level
    sys.argv = [program, *arguments]
    os.environ["HYDRA_FULL_ERROR"] = "1"
    try:
        yield
    finally:
        sys.argv = argv
        root.handlers[:] = handlers
        root.setLevel(level)
        if full_error is None:
            del os.environ["HYDRA_FULL_ERROR"]
        else:
            os.environ["HYDRA_FULL_ERROR"] = full_error
