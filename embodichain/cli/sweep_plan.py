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
from hydra.core.utils import setup_globals
from hydra.types import RunMode
from omegaconf import DictConfig

from embodichain.config.composed import relax
from embodichain.config.hydra_loader import COMPOSING, config_loader, explain
from embodichain.config.resolved import Resolved
from embodichain.config.schema import Verb
from embodichain.lab.sim.engine.mujoco_process import all_cores
from embodichain.utils.errors import ConfigError

__all__ = ["Plan", "plan_sweep", "swept_keys"]

LAUNCHER = "hydra/launcher"
CLUSTERS = ("slurm", "ray")
"""Launchers that start jobs on other machines, each with its own number of cores."""
_FOLDER = "hydra.sweep.dir"
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
    setup_globals()  # resolvers such as `now`
    with config_loader() as loader:
        installed = loader.get_group_options(LAUNCHER)

        def composed() -> DictConfig:
            try:
                return loader.load_configuration(verb, relax(lines, loader), RunMode.MULTIRUN)
            except COMPOSING as error:
                raise ConfigError(explain(error, loader)) from error

        config = composed()
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
            config = composed()
    note = ""
    if launcher != _ONE_BY_ONE:
        at_once, threads = _shares(config, launcher, cores, most)
        if first.tree["sim"]["num_threads"] == 0 and first.tree["sim"]["engine"] == "mujoco":
            lines.append(f"sim.num_threads={threads}")
        else:
            threads = int(first.tree["sim"]["num_threads"])
        note = _note(jobs, at_once, threads, launcher)
    folder = str(config.hydra.sweep.dir)
    quoted = folder.replace("\\", "\\\\").replace("'", "\\'")
    lines = [line for line in lines if line.lstrip("+").partition("=")[0] != _FOLDER]
    lines.append(f"{_FOLDER}='{quoted}'")
    keys = (*swept_keys(lines), *_searched(config))
    return Plan(tuple(lines), Path(folder), keys, launcher, jobs, note)


def swept_keys(overrides: Sequence[str]) -> list[str]:
    """Return the keys with several values in a sweep.

    Args:
        overrides: As typed.
    """
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    return [override.key_or_group for override in parsed if override.is_sweep_override()]


def _searched(config: DictConfig) -> list[str]:
    """Keys with several values in the sweeper's config."""
    params = config.hydra.sweeper.get("params") or {}
    return [str(key).lstrip("+") for key in params]


def _jobs(config: DictConfig, overrides: Sequence[str]) -> int:
    """Number of jobs: of trials, or of combinations of values."""
    if "n_trials" in config.hydra.sweeper:
        return int(config.hydra.sweeper.n_trials or 1)
    params = config.hydra.sweeper.get("params") or {}
    lines = [*(f"{key}={value}" for key, value in params.items()), *overrides]
    parsed = OverridesParser.create().parse_overrides(lines)
    sweeps = {o.key_or_group: o for o in parsed}.values()
    return prod(sum(1 for _ in o.sweep_string_iterator()) for o in sweeps if o.is_discrete_sweep())


def _batch(config: DictConfig, jobs: int) -> int:
    """Number of jobs that the sweeper starts before it waits for results."""
    sweeper = config.hydra.sweeper
    return int(sweeper.get("n_jobs") or sweeper.get("max_batch_size") or jobs)


def _shares(config: DictConfig, launcher: str, cores: int, most: int) -> tuple[int, int]:
    """Jobs at once, and threads of each."""
    settings = config.hydra.launcher
    if launcher in CLUSTERS:
        return most, max(1, int(settings.cpus))
    asked = int(settings.get("n_jobs", cores))
    workers = asked if asked > 0 else max(1, cores + 1 + asked)  # as joblib counts
    at_once = min(workers, most)
    return at_once, max(1, cores // at_once)


def _note(jobs: int, at_once: int, threads: int, launcher: str) -> str:
    whole = f"{jobs} jobs" if jobs != 1 else "1 job"
    each = "every core" if threads == 0 else f"{threads} thread{'s' * (threads > 1)}"
    at = "" if launcher in CLUSTERS else f", {at_once} at once"
    return f"{whole}{at}, {each} of physics in each (sim.num_threads), {LAUNCHER}={launcher}"
