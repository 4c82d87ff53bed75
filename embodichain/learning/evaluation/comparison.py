"""Comparison of finished trainings; runs that differ only in their seed form a group."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from embodichain.config.run_folder import SUMMARY
from embodichain.learning.evaluation.episodes import EPISODE_WINDOW
from embodichain.learning.evaluation.statistics import SeedEstimate, over_seeds
from embodichain.utils.env_text import shown
from embodichain.utils.errors import ConfigError

__all__ = [
    "Curve",
    "Group",
    "TrainedRun",
    "band",
    "best_group",
    "group_runs",
    "is_training",
    "read_curves",
    "read_run",
    "short_labels",
    "training_trials",
    "trainings_in",
]

PROGRESS = "progress.csv"
# Columns of Stable-Baselines3's logger.
STEPS = "time/total_timesteps"
RETURN = "rollout/ep_rew_mean"
SUCCESS = "rollout/success_rate"
LENGTH = "rollout/ep_len_mean"
_ROW_EPISODES = 100
"""Episodes that a row of `progress.csv` has its success rate from, once so many have ended."""
_SUMMARY_NUMBERS = (
    "success_rate",
    "mean_return",
    "env_steps_per_second",
    "train_seconds",
    "env_steps",
    "objective",
)
_IGNORED_KEYS = (
    "seed",
    "output_dir",
    "quiet",
    "json",
    "traceback",
    "record",
    "viewer",
    "resume",
    "eval",
    "video",
    "wandb",
    "checkpoint",
    "sim",
    "allow_changed",
    "hydra",  # how a sweep runs: launcher, sweeper, folders
)
"""Keys that may differ in a group: the seed, and keys that change no number."""
_SEPARATOR = re.compile(r"[./@]")
"""What follows the first word of a key: ``hydra/launcher``, ``hydra.launcher.n_jobs``."""

F64 = NDArray[np.float64]


class Curve(NamedTuple):
    """One quantity of a training: (n,) increasing environment steps, and (n,) values at these."""

    steps: F64
    values: F64


@dataclass(frozen=True, slots=True)
class TrainedRun:
    """The results of one training.

    Attributes:
        folder: The run folder.
        parts: Task, algorithm and overrides without the seed.
        seed: The training's seed.
        numbers: ``success_rate``, ``mean_return``, ``env_steps_per_second``, ``train_seconds``,
            ``env_steps``, ``objective``, ``eval_return``, ``eval_success``, as far as known.
        trials: Episodes behind each of the numbers that is a success rate.
        curves: Column of `progress.csv` -> curve; empty without that file.
    """

    folder: Path
    parts: tuple[str, ...]
    seed: int | None
    numbers: dict[str, float]
    trials: dict[str, int]
    curves: dict[str, Curve]

    @property
    def label(self) -> str:
        """The parts in one line."""
        return " ".join(self.parts)


@dataclass(frozen=True, slots=True)
class Group:
    """Runs that differ only in their seed, in the order given."""

    label: str
    runs: tuple[TrainedRun, ...]

    def number(self, name: str) -> SeedEstimate | None:
        """Summarize a number over the runs; the interval is over seeds."""
        runs = [run for run in self.runs if name in run.numbers]
        numbers = [run.numbers[name] for run in runs]
        is_rate = any(name in run.trials for run in runs)
        if not is_rate:
            return over_seeds(numbers)
        return over_seeds(numbers, [run.trials.get(name, 0) for run in runs])


def is_training(folder: Path) -> bool:
    """Whether a folder contains a finished training, possibly with a damaged summary.

    `read_run` reports the damage.
    """
    path = folder / SUMMARY
    return path.is_file() and "train_seconds" in path.read_text(encoding="utf-8", errors="replace")


def trainings_in(folder: Path) -> list[Path]:
    """The trainings of a folder: the folder itself, or its subfolders, as in a sweep.

    Returns:
        Folders, the jobs of a sweep ordered by number; empty if there is no training.
    """
    if is_training(folder):
        return [folder]
    trainings = [path for path in folder.iterdir() if path.is_dir() and is_training(path)]
    return sorted(trainings, key=lambda path: (len(path.name), path.name))


def read_run(folder: Path) -> TrainedRun:
    """Read the results of a training.

    Raises:
        ConfigError: If the folder is not that of a training, or a file in it is damaged.
    """
    summary = _read_json(folder / SUMMARY)
    if summary is None or "train_seconds" not in summary:
        raise ConfigError(f"{folder} has no finished training: no summary.json of one")
    task = str(summary.get("task"))
    algo = str(summary.get("algo"))
    numbers: dict[str, float] = {}
    trials: dict[str, int] = {}
    for name in _SUMMARY_NUMBERS:
        if summary.get(name) is not None:
            numbers[name] = float(summary[name])
    if "success_rate" in numbers:
        trials["success_rate"] = training_trials(summary)
    evaluation = _newest_evaluation(folder) or summary.get("eval") or {}
    returns = evaluation.get("returns") or {}
    if returns.get("mean") is not None:
        numbers["eval_return"] = float(returns["mean"])
    success = evaluation.get("success") or {}
    if success.get("rate") is not None:
        numbers["eval_success"] = float(success["rate"])
        trials["eval_success"] = int(success.get("trials") or 0)
    # The objective is one of the rates; of tasks without success it is a return.
    for name in ("eval_success", "success_rate"):
        if name in trials and numbers[name] == numbers.get("objective"):
            trials["objective"] = trials[name]
            break
    return TrainedRun(
        folder=folder,
        parts=(task, algo, *_read_overrides(folder)),
        seed=summary.get("seed"),
        numbers=numbers,
        trials=trials,
        curves=read_curves(folder / PROGRESS),
    )


def training_trials(summary: Mapping[str, Any]) -> int:
    """Return the number of episodes behind the success rate in the summary of a training."""
    window = summary.get("num_envs") if summary.get("algo") == "bc" else EPISODE_WINDOW
    return min(int(summary.get("episodes") or 0), int(window or 0))


def group_runs(runs: Iterable[TrainedRun]) -> list[Group]:
    """Group runs by label, in the order of each group's first run.

    Raises:
        ConfigError: If a folder is given twice, or two runs of a group have the same seed: their
            results are identical, and an interval over them would be too narrow.
    """
    members: dict[str, list[TrainedRun]] = {}
    for run in runs:
        group = members.setdefault(run.label, [])
        for other in group:
            if other.seed == run.seed:
                raise ConfigError(
                    f"{other.folder} and {run.folder} are the same training with the same seed "
                    f"{run.seed}: name one of them"
                )
        group.append(run)
    return [Group(label, tuple(group)) for label, group in members.items()]


def best_group(groups: Sequence[Group], objective: float | None = None) -> Group | None:
    """Return the group with the largest mean objective; None without any.

    Args:
        groups: The groups.
        objective: The best value of a search, which may minimize; its group is returned.
    """
    means: dict[int, float] = {}
    for index, group in enumerate(groups):
        estimate = group.number("objective")
        if estimate is not None:
            means[index] = estimate.mean
    if not means:
        return None
    if objective is not None:
        return groups[min(means, key=lambda index: abs(means[index] - objective))]
    return groups[max(means, key=means.__getitem__)]


def short_labels(groups: Sequence[Group]) -> tuple[str, list[str]]:
    """Return what all groups have in common, and each group's label without it.

    Args:
        groups: The groups; a single one keeps its whole label.
    """
    parts = [group.runs[0].parts for group in groups]
    if len(parts) < 2:
        return "", [group.label for group in groups]
    common = [part for part in parts[0] if all(part in other for other in parts)]
    labels = []
    for group in groups:
        label = " ".join(part for part in group.runs[0].parts if part not in common)
        labels.append(label or group.label)
    return " ".join(common), labels


def band(
    curves: Sequence[Curve], points: int = 200, *, share: bool = False
) -> tuple[F64, F64, F64 | None, F64 | None]:
    """Average curves of several seeds.

    Args:
        curves: At least one; averaged over the range of steps that they share.
        points: Number of steps at which the curves are linearly interpolated.
        share: Whether the values are rates.

    Returns:
        Steps, mean, and low and high end of the 95 % interval of `over_seeds`, each (points,). Too
        few seeds have no interval: None.

    Raises:
        ValueError: If the curves have no steps in common.
    """
    first = max(float(curve.steps[0]) for curve in curves)
    last = min(float(curve.steps[-1]) for curve in curves)
    if first > last:
        raise ValueError(f"the curves have no steps in common: {first:g} to {last:g}")
    steps = np.linspace(first, last, points)
    rows = np.stack([np.interp(steps, curve.steps, curve.values) for curve in curves])
    mean: F64 = rows.mean(axis=0)
    trials = np.full(len(curves), _ROW_EPISODES) if share else None
    intervals = []
    for column in rows.T:
        estimate = over_seeds(column, trials)
        if estimate is not None and estimate.mean_interval is not None:
            intervals.append(estimate.mean_interval)
    if not intervals:
        return steps, mean, None, None
    low, high = np.array(intervals, np.float64).T
    return steps, mean, low, high


def _read_overrides(folder: Path) -> list[str]:
    """Return the overrides without the task and the keys that may differ in a group, sorted."""
    try:
        lines = yaml.safe_load((folder / "overrides.yaml").read_text(encoding="utf-8")) or []
    except FileNotFoundError:
        return []
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise ConfigError(f"cannot read {folder / 'overrides.yaml'}: {error}") from error
    # Without the +, which a sweep's jobs have before every override.
    overrides = {shown(str(line)).lstrip("+") for line in lines}
    distinguishing = []
    for override in overrides:
        key = override.partition("=")[0].lstrip("~")
        if key != "task" and _SEPARATOR.split(key)[0] not in _IGNORED_KEYS:
            distinguishing.append(override)
    return sorted(distinguishing)


def _newest_evaluation(folder: Path) -> dict[str, Any] | None:
    """Return the newest evaluation of this training among the runs in the same folder."""
    by_time: dict[int, dict[str, Any]] = {}
    for path in folder.parent.parent.glob("*/*/eval.json"):
        evaluation = _read_json(path) or {}
        if Path(str(evaluation.get("policy"))).is_relative_to(folder):
            by_time[path.stat().st_mtime_ns] = evaluation
    if not by_time:
        return None
    return by_time[max(by_time)]


def read_curves(
    path: Path, wanted: Callable[[str], bool] = (RETURN, SUCCESS, LENGTH).__contains__
) -> dict[str, Curve]:
    """Read curves over environment steps from a `progress.csv`.

    Args:
        path: The file.
        wanted: Picks columns by name; by default return, success and length of episodes.

    Returns:
        Column -> curve, from rows with both cells filled. Empty without the file.

    Raises:
        ConfigError: The file is damaged.
    """
    if not path.is_file():
        return {}
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
        names = list(rows[0]) if rows else []
        curves: dict[str, Curve] = {}
        for name in names:
            if not name or not wanted(name):  # a row may have more cells than there are names
                continue
            cells = [(row.get(STEPS), row.get(name)) for row in rows]
            points = [(float(steps), float(value)) for steps, value in cells if steps and value]
            if points:
                steps, values = np.array(sorted(points)).T
                curves[name] = Curve(steps, values)
    except (OSError, ValueError, csv.Error) as error:
        raise ConfigError(f"cannot read {path}: {error}") from error
    return curves


def _read_json(path: Path) -> dict[str, Any] | None:
    """Return the object in a JSON file; None if there is no file, or it is not an object."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise ConfigError(f"cannot read {path}: {error}") from error
    return data if isinstance(data, dict) else None
