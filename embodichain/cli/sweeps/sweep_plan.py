"""The plan of a sweep before its first job: launcher, folder, and cores of each job.

On one machine jobs run at once if joblib's launcher is installed. Cores are divided among them:
a job that used all of them would slow the others down.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.types import RunMode
from omegaconf import DictConfig

from embodichain.cli.sweeps.hydra_folders import folder_named
from embodichain.config.composition.composed import relax, search_path
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
from embodichain.config.keys.schema import Verb
from embodichain.config.resolved import Resolved
from embodichain.lab.sim.engine.cpu.mujoco_process import all_cores
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["Plan", "composed_for_hydra", "plan_sweep", "swept_keys", "with_sweepers_params"]

LAUNCHER = "hydra/launcher"
_FOLDER = "hydra.sweep.dir"
_PARAMS = "hydra.sweeper.params"
_AT_ONCE = "joblib"
_ONE_BY_ONE = "basic"


@dataclass(frozen=True)
class Plan:
    """How a sweep is run.

    Attributes:
        overrides: For Hydra: as typed, with launcher, folder and threads.
        folder: The sweep's folder.
        keys: Keys with several values.
        launcher: Option of the group `hydra/launcher`.
        jobs: Number of jobs; of a search, of its trials.
        note: What was decided, as one line; empty if nothing was.
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
        return self.launcher != _ONE_BY_ONE


def with_sweepers_params(verb: Verb, overrides: Sequence[str]) -> list[str]:
    """Write `hydra.sweeper.params` of files as overrides, so that they are checked like these.

    Typed overrides of the same keys win.

    Args:
        verb: The verb of the jobs.
        overrides: As typed, with sweeps.

    Raises:
        ConfigError: The overrides of Hydra's own keys are wrong.
    """
    lines = list(overrides)
    params = composed_for_hydra(verb, lines).hydra.sweeper.get("params") or {}
    typed = {line.lstrip("+~").partition("=")[0] for line in lines}
    rest = {str(key).lstrip("+"): value for key, value in params.items()}
    found = [readable(f"{key}={value}") for key, value in rest.items() if key not in typed]
    return [*lines, *found, f"{_PARAMS}=null"] if rest else lines


def composed_for_hydra(
    verb: Verb, lines: Sequence[str], mode: RunMode = RunMode.MULTIRUN
) -> DictConfig:
    """Return a config with Hydra's own node, composed as Hydra's `main` does.

    Args:
        verb: The verb of the jobs.
        lines: Overrides as typed.
        mode: Whether it is a sweep.

    Raises:
        ConfigError: It cannot be composed.
    """
    register_resolvers()  # such as `now`
    with searched(search_path(lines)[0]), config_loader() as loader:
        others = [line for line in lines if not line.lstrip("+").startswith(SEARCH_PATH)]
        try:
            return loader.load_configuration(verb, relax(others, loader), mode)
        except COMPOSING as error:
            raise ConfigError(explain(error, loader)) from error


def plan_sweep(verb: Verb, overrides: Sequence[str], first: Resolved) -> Plan:
    """Decide how a sweep is run.

    Args:
        verb: The verb of the jobs.
        overrides: As typed, with sweeps.
        first: The config of the first job.

    Raises:
        ConfigError: The overrides of Hydra's own keys are wrong.
    """
    lines = list(overrides)
    with config_loader() as loader:
        installed = loader.get_group_options(LAUNCHER)
    config = composed_for_hydra(verb, lines)
    cores = all_cores()
    jobs = _jobs(config, lines)
    most = min(jobs, _batch(config, jobs))
    launcher = str(config.hydra.runtime.choices[LAUNCHER])
    chosen = launcher != _ONE_BY_ONE or any(
        line.lstrip("+").partition("=")[0] == LAUNCHER for line in lines
    )
    sim = first.tree["sim"]
    alone = (sim["engine"], sim["backend"]) != ("mujoco", "local")
    alone = alone or first.tree["viewer"]["name"] != "none"
    if not chosen and not alone and min(cores, most) > 1 and _AT_ONCE in installed:
        launcher = _AT_ONCE
        lines.append(f"{LAUNCHER}={launcher}")
        config = composed_for_hydra(verb, lines)
    note = ""
    if launcher != _ONE_BY_ONE:
        at_once, threads = _shares(config, launcher, cores, most)
        if first.tree["sim"]["num_threads"] == 0 and first.tree["sim"]["engine"] == "mujoco":
            lines.append(f"sim.num_threads={threads}")
        else:
            threads = int(first.tree["sim"]["num_threads"])
        note = _note(jobs, at_once, threads, launcher)
    folder = folder_named(config, _FOLDER)
    if Path(folder).is_file():
        raise ConfigError([Problem(_FOLDER, f"{folder} is a file: name a folder")])
    quoted = folder.replace("\\", "\\\\").replace("'", "\\'")
    lines = [line for line in lines if line.lstrip("+").partition("=")[0] != _FOLDER]
    lines.append(f"{_FOLDER}='{quoted}'")
    keys = tuple(swept_keys(lines))
    return Plan(tuple(lines), Path(folder), keys, launcher, jobs, note)


def swept_keys(overrides: Sequence[str]) -> list[str]:
    """Return the keys with several values in a sweep.

    Args:
        overrides: As typed.
    """
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    return [override.key_or_group for override in parsed if override.is_sweep_override()]


def _jobs(config: DictConfig, overrides: Sequence[str]) -> int:
    """Number of jobs: of trials, or of combinations of values."""
    if "n_trials" in config.hydra.sweeper:
        return int(config.hydra.sweeper.n_trials or 1)
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    sweeps = {o.key_or_group: o for o in parsed}.values()
    return prod(sum(1 for _ in o.sweep_string_iterator()) for o in sweeps if o.is_discrete_sweep())


def _batch(config: DictConfig, jobs: int) -> int:
    """Number of jobs that the sweeper starts before it waits for results."""
    sweeper = config.hydra.sweeper
    return int(sweeper.get("n_jobs") or sweeper.get("max_batch_size") or jobs)


def _shares(config: DictConfig, launcher: str, cores: int, most: int) -> tuple[int, int]:
    """Jobs at once, and threads of each."""
    settings = config.hydra.launcher
    if launcher in LAUNCHERS.names():  # on other machines, each with its own number of cores
        return most, max(1, int(settings.get("cpus", 1)))
    asked = int(settings.get("n_jobs", cores))
    workers = asked if asked > 0 else max(1, cores + 1 + asked)  # as joblib counts
    at_once = min(workers, most)
    return at_once, max(1, cores // at_once)


def _note(jobs: int, at_once: int, threads: int, launcher: str) -> str:
    whole = f"{jobs} jobs" if jobs != 1 else "1 job"
    each = "every core" if threads == 0 else f"{threads} thread{'s' * (threads > 1)}"
    at = "" if launcher in LAUNCHERS.names() else f", {at_once} at once"
    return f"{whole}{at}, {each} of physics in each (sim.num_threads), {LAUNCHER}={launcher}"
