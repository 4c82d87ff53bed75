"""The plan of a sweep before its first job: launcher, folder, and cores of each job.

On one machine jobs run at once if joblib's launcher is installed. Cores are divided among them:
a job that used all of them would slow the others down.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.types import RunMode
from omegaconf import DictConfig

from embodichain.cli.sweeps.hydra_folders import folder_named
from embodichain.config.composition.composed import placed_key, relax, search_path
from embodichain.config.composition.hydra_loader import (
    COMPOSING,
    SEARCH_PATH,
    config_loader,
    explain,
    register_resolvers,
    searched,
)
from embodichain.config.composition.override_text import readable
from embodichain.config.keys.launchers import LAUNCHERS
from embodichain.config.keys.schema import JobVerb
from embodichain.config.resolved import Resolved
from embodichain.lab.sim.engine.cpu.mujoco_process import all_cores
from embodichain.lab.sim.engine.engine_register import ENGINES
from embodichain.utils.errors import ConfigError, Problem

__all__ = [
    "Plan",
    "compose_for_hydra",
    "needs_machine",
    "plan_sweep",
    "swept_keys",
    "with_sweepers_params",
]

LAUNCHER = "hydra/launcher"
_FOLDER = "hydra.sweep.dir"
_PARAMS = "hydra.sweeper.params"
_JOBLIB = "joblib"
"""The launcher that runs jobs at once on this machine."""
_BASIC = "basic"
"""Hydra's own launcher, which runs one job after the other."""


@dataclass(frozen=True)
class Plan:
    """How a sweep is run.

    Attributes:
        overrides: For Hydra: as typed, with launcher, folder and threads.
        folder: The sweep's folder.
        keys: Keys with several values.
        launcher: Option of the group `hydra/launcher`.
        jobs: Number of jobs; of a search, of its trials.
        note: The decision, as one line; empty if nothing was decided.
    """

    overrides: tuple[str, ...]
    folder: Path
    keys: tuple[str, ...]
    launcher: str
    jobs: int
    note: str = ""

    @property
    def is_parallel(self) -> bool:
        """Whether jobs run at once, in other processes."""
        return self.launcher != _BASIC


def with_sweepers_params(verb: JobVerb, overrides: Sequence[str]) -> list[str]:
    """Write `hydra.sweeper.params` of files as overrides, so that they are checked like these.

    Typed overrides of the same keys win.

    Args:
        verb: The verb of the jobs.
        overrides: As typed, with sweeps.

    Raises:
        ConfigError: The overrides of Hydra's own keys are wrong.
    """
    lines = list(overrides)
    params = compose_for_hydra(verb, lines).hydra.sweeper.get("params") or {}
    if not params:
        return lines
    typed_keys = {line.lstrip("+~").partition("=")[0] for line in overrides}
    values = {str(key).lstrip("+"): value for key, value in params.items()}
    for key, value in values.items():
        if key not in typed_keys:
            lines.append(readable(f"{key}={value}"))
    lines.append(f"{_PARAMS}=null")
    return lines


def compose_for_hydra(
    config_name: str, lines: Sequence[str], mode: RunMode = RunMode.MULTIRUN
) -> DictConfig:
    """Return a config with Hydra's own node, composed as Hydra's `main` does.

    Args:
        config_name: The root config of the jobs: their verb, or ``study_job``.
        lines: Overrides as typed.
        mode: Whether it is a sweep.

    Raises:
        ConfigError: It cannot be composed.
    """
    register_resolvers()  # such as `now`
    places, _ = search_path(lines)
    other_lines = [line for line in lines if not line.lstrip("+").startswith(SEARCH_PATH)]
    with searched(places), config_loader() as loader:
        try:
            return loader.load_configuration(config_name, relax(other_lines, loader), mode)
        except COMPOSING as error:
            raise ConfigError(explain(error, loader, relax(other_lines, loader))) from error


def plan_sweep(config_name: str, overrides: Sequence[str], first: Resolved) -> Plan:
    """Decide how a sweep is run.

    Args:
        config_name: The root config of the jobs: their verb, or ``study_job``.
        overrides: As typed, with sweeps.
        first: The config of the first job.

    Raises:
        ConfigError: The overrides of Hydra's own keys are wrong.
    """
    lines = list(overrides)
    with config_loader() as loader:
        installed = loader.get_group_options(LAUNCHER)
    config = compose_for_hydra(config_name, lines)
    cores = all_cores()
    jobs = _count_jobs(config, lines)
    most_at_once = min(jobs, _batch_size(config, jobs))
    launcher = str(config.hydra.runtime.choices[LAUNCHER])
    is_chosen = launcher != _BASIC or any(_key_of(line) == LAUNCHER for line in lines)
    can_be_parallel = min(cores, most_at_once) > 1 and _JOBLIB in installed
    if can_be_parallel and not is_chosen and not needs_machine(first):
        launcher = _JOBLIB
        lines.append(f"{LAUNCHER}={launcher}")
        config = compose_for_hydra(config_name, lines)
    note = ""
    if launcher != _BASIC:
        at_once, threads = _divide_cores(config, launcher, cores, most_at_once)
        sim = first.tree["sim"]
        if sim["num_threads"] == 0 and _is_on_cores(sim["engine"]):
            lines.append(f"sim.num_threads={threads}")
        else:
            threads = int(sim["num_threads"])
        note = _describe_jobs(jobs, at_once, threads, launcher)
    folder = folder_named(config, _FOLDER)
    if Path(folder).is_file():
        raise ConfigError([Problem(_FOLDER, f"{folder} is a file: name a folder")])
    quoted_folder = folder.replace("\\", "\\\\").replace("'", "\\'")
    lines = [line for line in lines if _key_of(line) != _FOLDER]
    lines.append(f"{_FOLDER}='{quoted_folder}'")
    return Plan(
        overrides=tuple(lines),
        folder=Path(folder),
        keys=tuple(swept_keys(lines)),
        launcher=launcher,
        jobs=jobs,
        note=note,
    )


def _key_of(override: str) -> str:
    return override.lstrip("+").partition("=")[0]


def needs_machine(job: Resolved) -> bool:
    """Whether a job takes the GPU, a cluster or a viewer's port, which jobs cannot share.

    Args:
        job: The job's config.
    """
    sim = job.tree["sim"]
    if not _is_on_cores(sim["engine"]) or sim["backend"] != "local":
        return True
    return job.tree["viewer"]["name"] != "none"


def _is_on_cores(engine: str) -> bool:
    """Whether an engine runs on the cores of the CPU alone, which jobs share."""
    return ENGINES[engine].devices == ("cpu",)


def swept_keys(overrides: Sequence[str]) -> list[str]:
    """Return the keys with several values in a sweep.

    Args:
        overrides: As typed.
    """
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    return [placed_key(override) for override in parsed if override.is_sweep_override()]


def _count_jobs(config: DictConfig, overrides: Sequence[str]) -> int:
    """Number of jobs: of trials, or of combinations of values."""
    if "n_trials" in config.hydra.sweeper:
        return int(config.hydra.sweeper.n_trials or 1)
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    last_of_key = {override.key_or_group: override for override in parsed}
    jobs = 1
    for override in last_of_key.values():
        if override.is_discrete_sweep():
            jobs *= len(list(override.sweep_string_iterator()))
    return jobs


def _batch_size(config: DictConfig, jobs: int) -> int:
    """Number of jobs that the sweeper starts before it waits for results."""
    sweeper = config.hydra.sweeper
    return int(sweeper.get("n_jobs") or sweeper.get("max_batch_size") or jobs)


def _divide_cores(
    config: DictConfig, launcher: str, cores: int, most_at_once: int
) -> tuple[int, int]:
    """Jobs at once, and threads of each.

    Args:
        config: A job's config with Hydra's own node.
        launcher: Option of the group `hydra/launcher`.
        cores: Of this machine.
        most_at_once: Jobs that the sweeper has at once.
    """
    settings = config.hydra.launcher
    if launcher in LAUNCHERS.names():  # on other machines, each with its own number of cores
        return most_at_once, max(1, int(settings.get("cpus", 1)))
    workers = int(settings.get("n_jobs", cores))
    if workers <= 0:  # as joblib counts: -1 is all cores, -2 all but one
        workers = max(1, cores + 1 + workers)
    at_once = min(workers, most_at_once)
    return at_once, max(1, cores // at_once)


def _describe_jobs(jobs: int, at_once: int, threads: int, launcher: str) -> str:
    """One line about the jobs, and the cores of each."""
    text = "1 job" if jobs == 1 else f"{jobs} jobs"
    if launcher not in LAUNCHERS.names():
        text += f", {at_once} at once"
    if threads == 0:
        share = "every core"
    elif threads == 1:
        share = "1 thread"
    else:
        share = f"{threads} threads"
    return f"{text}, {share} of physics in each (sim.num_threads), {LAUNCHER}={launcher}"
