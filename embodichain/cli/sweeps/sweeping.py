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
from typing import Any, TextIO

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import IntervalSweep, Override
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig

from embodichain.cli.sweeps.hydra_folders import check_subfolders, folder_named, numbers_jobs
from embodichain.cli.sweeps.sweep_jobs import JobStoppedError, enter, stop_mark
from embodichain.cli.sweeps.sweep_plan import (
    Plan,
    composed_for_hydra,
    plan_sweep,
    with_sweepers_params,
)
from embodichain.cli.sweeps.sweep_progress import job_label
from embodichain.cli.sweeps.sweep_run import run_sweep
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
from embodichain.config.keys.schema import Verb
from embodichain.config.resolved import Resolved, resolve
from embodichain.config.run_folder import adopt, check_unused, missing_folders, take_back
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["call_hydra", "points", "towards_scores"]

_RUN_FOLDER = "hydra.run.dir"
_DIRECTION = "hydra.sweeper.direction"
_MOST_CHECKED_JOBS = 64
_ONE_BY_ONE, _AT_ONCE = "BasicLauncher", "JoblibLauncher"
_NO_SEARCH = "BasicSweeper"


def call_hydra(
    verb: Verb,
    check: Callable[[Sequence[str]], Resolved],
    do: Callable[[Resolved, Path | None, bool, Callable[[], None] | None], float | None],
    options: JobOptions,
    overrides: Sequence[str],
) -> None:
    """Call Hydra's `main` for a verb; its exceptions are raised unchanged.

    Args:
        verb: The verb, ``run`` or ``train``.
        check: Checks the config of one job.
        do: Runs a job, in the given folder or a new one; the further arguments are whether it
            continues in this folder, and what undoes the folder of a job that is refused.
        options: `cfg`, `info`, `multirun`, `package`, `resolve`.
        overrides: As typed.

    Raises:
        ConfigError: Mistakes in the config of any job; no job was started.
    """
    plan: Plan | None = None
    made: list[Path] = []
    failed: list[Exception] = []
    gym = any(line.lstrip("+").startswith("gym_config=") for line in overrides)
    if options.cfg is not None or options.info is not None:
        if options.cfg is not None and gym:
            raise ConfigError("--cfg prints YAML only: embodichain convert prints a gym config")
        composed = compose(overrides, verb)
        if composed.problems:
            raise ConfigError(composed.problems)
    elif options.multirun:
        _parsed(overrides)
        refuse_token(overrides)
        overrides = with_sweepers_params(verb, overrides)
        jobs = list(points(overrides, _MOST_CHECKED_JOBS))
        checked = [check(point) for point in jobs]
        if not numbers_jobs(composed_for_hydra(verb, jobs[0])):
            check_subfolders([composed_for_hydra(verb, point) for point in jobs])
        plan = plan_sweep(verb, towards_scores(overrides), checked[0])
        overrides = plan.overrides
    else:
        check(overrides)
        made = _check_run_folder(verb, overrides)
    keys = plan.keys if plan is not None else ()
    config_dir = chosen_config_dir()

    # Pickled by value for the workers of a sweep, with its closure.
    @hydra.main(**VERSION_BASE, config_path="pkg://embodichain.conf", config_name=verb)
    def job(composed: DictConfig) -> float | None:
        with user_configs(config_dir):
            found = from_hydra()
            resolved, folder = resolve(found, verb), HydraConfig.get().runtime.output_dir
        # In a worker, too, whose streams are its own.
        with degrading_text(), _labelled_lines(_label(keys), json=resolved.root.json):
            if HydraConfig.get().mode == RunMode.MULTIRUN:
                drawn = found.tree.get("seed") is None
                if stop_mark(Path(HydraConfig.get().sweep.dir)).exists():
                    raise JobStoppedError("the sweep was interrupted before this job")
                with enter(Path(folder), resolved, verb, seed_is_drawn=drawn) as entered:
                    objective = entered.objective
                    if not entered.finished:
                        with _stopping_alone():
                            objective = do(entered.resolved, Path(folder), entered.goes_on, None)
                    elif not resolved.root.quiet:
                        sys.stderr.write(f"finished already: {folder}\n")
                    _check_objective(objective, verb, resolved)
                    return objective
            if HydraConfig.get().run.dir == ".":
                return do(resolved, None, False, None)
            before = {entry.name for entry in Path(folder).iterdir()}
            new = [Path(folder), *made] if made else []
            undo = partial(take_back, Path(folder), before, new)
            try:
                return do(resolved, adopt(folder), False, undo)
            except Exception as error:  # noqa: BLE001  (raised below: Hydra adds a line of its own)
                failed.append(error)
                return None

    with config_loader() as loader:
        relaxed = relax(overrides, loader)
    program = f"embodichain {verb}"
    places, _ = search_path(overrides)
    arguments = [*_flags(options), *relaxed, *([WITHOUT_TASK] * gym)]
    with searched(places), _process(program, arguments):
        if plan is None:
            job()
            if failed:
                raise failed[0]
        else:
            run_sweep(plan, verb, job, quiet=options.quiet or options.json)


def _check_run_folder(verb: Verb, overrides: Sequence[str]) -> list[Path]:
    """Refuse a folder in `hydra.run.dir` that cannot be made; Hydra's own errors have no sentence.

    Returns:
        The folders that will be made, the innermost first.
    """
    config = composed_for_hydra(verb, overrides, RunMode.RUN)
    typed = any(line.lstrip("+").startswith(f"{_RUN_FOLDER}=") for line in overrides)
    folder = folder_named(config, _RUN_FOLDER)
    if not typed and folder == ".":
        return []  # the run claims one
    try:
        made = missing_folders(folder)
        check_unused(folder)
        Path(folder).mkdir(parents=True, exist_ok=True)
        for new in made:  # Hydra makes it again, by another name if the name has the time
            new.rmdir()
    except ConfigError as error:
        raise ConfigError([Problem(_RUN_FOLDER, p.message) for p in error.problems]) from error
    except OSError as error:
        message = f"cannot make the run folder {folder}: {error}"
        raise ConfigError([Problem(_RUN_FOLDER, message)]) from error
    return made


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

    parsed = _parsed(overrides)
    if _searches(overrides) or any(o.is_interval_sweep() for o in parsed):
        yield [_first(override) for override in parsed]
        return
    for batch in BasicSweeper.split_arguments(parsed, max_batch_size=most)[:1]:
        yield from (list(job) for job in batch)


def _parsed(overrides: Sequence[str]) -> list[Override]:
    """The overrides in Hydra's form; raises a `ConfigError` that lists the malformed ones."""
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
    typed = any(o.lstrip("+").startswith(f"{_DIRECTION}=") for o in overrides)
    added = [f"{_DIRECTION}=maximize"] if _searches(overrides) and not typed else []
    return [*overrides, *added]


def _searches(overrides: Sequence[str]) -> bool:
    return "hydra/sweeper=optuna" in overrides


def _first(override: Override) -> str:
    """The override with the first value of its sweep."""
    line = override.input_line or ""
    if not override.is_sweep_override():
        return line
    value = override.value()
    if isinstance(value, IntervalSweep):
        return f"{override.get_key_element()}={value.start}"
    return f"{override.get_key_element()}={next(iter(override.sweep_string_iterator()))}"


def _check_objective(objective: float | None, verb: Verb, resolved: Resolved) -> None:
    """Refuse a job without an objective in a search, which has nothing to compare then."""
    searches = not str(HydraConfig.get().sweeper.get("_target_", "")).endswith(_NO_SEARCH)
    if objective is not None or not searches:
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
def _stopping_alone() -> Iterator[None]:
    """In a worker of joblib, replace an interrupt, for which joblib would kill other workers."""
    try:
        yield
    except Interrupted as error:
        if str(HydraConfig.get().launcher.get("_target_", "")).endswith(_AT_ONCE):
            raise JobStoppedError(str(error)) from error
        raise


def _label(keys: Sequence[str]) -> str | None:
    """``[NUMBER KEY=VALUE ...]`` of a job among several at once, else None."""
    config = HydraConfig.get()
    alone = str(config.launcher.get("_target_", "")).endswith(_ONE_BY_ONE)
    if (
        config.mode != RunMode.MULTIRUN
        or alone
        or threading.current_thread() is not threading.main_thread()
    ):
        return None
    return f"[{job_label(str(config.job.num), config.overrides.task, keys)}] "


@contextmanager
def _labelled_lines(label: str | None, *, json: bool) -> Iterator[None]:
    """Prefix each line printed inside the context with a label.

    Args:
        label: The label and a blank; None changes nothing.
        json: Whether stdout is JSON; its lines are then not changed.
    """
    before = sys.stdout, sys.stderr
    if label is not None:
        sys.stderr = _Labelled(sys.stderr, label)
        sys.stdout = sys.stdout if json else _Labelled(sys.stdout, label)
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        sys.stdout, sys.stderr = before


class _Labelled:
    """A text stream that prefixes each line with a label and writes it at once.

    It is not a terminal even if `stream` is: bars of several jobs would overwrite each other.

    Attributes:
        is_of_sweep: True: progress is not shown here, but in the sweep's table.
    """

    is_of_sweep = True

    def __init__(self, stream: TextIO, label: str) -> None:
        self._stream, self._label, self._rest = stream, label, ""

    def write(self, text: str) -> int:
        *lines, self._rest = (self._rest + text).split("\n")
        if lines:
            self._stream.write(
                "".join(f"{self._label}{line}\n" if line else "\n" for line in lines)
            )
            self._stream.flush()
        return len(text)

    def flush(self) -> None:
        """Write the remaining text as a line."""
        if self._rest:
            self.write("\n")

    def isatty(self) -> bool:
        return False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _flags(options: JobOptions) -> list[str]:
    """Hydra's flags, which its parser accepts only before the overrides."""
    flags = ["--multirun"] if options.multirun else []
    flags += ["--resolve"] if options.resolve else []
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
    argv, full = sys.argv, os.environ.get("HYDRA_FULL_ERROR")
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    sys.argv = [program, *arguments]
    os.environ["HYDRA_FULL_ERROR"] = "1"
    try:
        yield
    finally:
        sys.argv = argv
        root.handlers[:] = handlers
        root.setLevel(level)
        if full is None:
            del os.environ["HYDRA_FULL_ERROR"]
        else:
            os.environ["HYDRA_FULL_ERROR"] = full
