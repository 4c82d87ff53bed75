"""Logs of a training: `progress.csv`, TensorBoard's event files, by Stable-Baselines3's logger.

What is logged besides Stable-Baselines3's own keys, by the names that Isaac Lab and mjlab have.
When it is logged is in `watch.py`.
"""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import (
    CSVOutputFormat,
    KVWriter,
    Logger,
    TensorBoardOutputFormat,
)
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from embodichain.learning.vec_env import ENDS

__all__ = [
    "PROGRESS_FILE",
    "TENSORBOARD",
    "log_curriculum",
    "log_episode",
    "log_fractions",
    "log_interval",
    "make_logger",
]

PROGRESS_FILE = "progress.csv"
TENSORBOARD = "tensorboard"
_MOST_ROWS = 200
_log = logging.getLogger(__name__)


def make_logger(run_dir: Path, writers: Sequence[KVWriter] = ()) -> Logger:
    """Return a logger into a run's folder; event files only where `tensorboard` is installed.

    Args:
        run_dir: The folder.
        writers: Who is told the same numbers besides.
    """
    formats: list[KVWriter] = [CSVOutputFormat(str(run_dir / PROGRESS_FILE))]
    if importlib.util.find_spec("tensorboard") is not None:
        formats.append(TensorBoardOutputFormat(str(run_dir / TENSORBOARD)))
    else:
        _log.info("no event files: pip install tensorboard")
    return Logger(folder=str(run_dir), output_formats=[*formats, *writers])


def log_interval(model: BaseAlgorithm, total_timesteps: int) -> int:
    """Return Stable-Baselines3's `log_interval` that makes at most about 200 rows.

    It counts rollouts for on-policy algorithms, episodes for the others.
    """
    if isinstance(model, OnPolicyAlgorithm):
        rollouts = total_timesteps // (model.n_steps * model.n_envs)
        return max(1, rollouts // _MOST_ROWS)
    return max(4, model.n_envs)


def log_episode(logger: Logger, info: Mapping[str, Any]) -> None:
    """Take in the info of an environment whose episode ended, averaged until a row is written.

    ``Episode_Reward/TERM`` is the sum of a reward term over an episode, ``Episode_Metrics/NAME`` a
    metric at its end; ``Episode_Termination/`` are shares of episodes: ``success``, ``fail``,
    ``time_out``, ``diverged`` say what ended them (the first that applies), the names of
    termination terms at the end of how many each was true.
    """
    for name, value in info["reward_sums"].items():
        logger.record_mean(f"Episode_Reward/{name}", value)
    for name, value in info["metrics"].items():
        logger.record_mean(f"Episode_Metrics/{name}", float(value))
    diverged = info["ended_by"] == "diverged"
    ends = {kind: info["ended_by"] == kind for kind in ENDS}
    for name, true in info["terminations"].items():
        ends.setdefault(name, true and not diverged)
    for name, true in ends.items():
        logger.record_mean(f"Episode_Termination/{name}", float(true))


def log_fractions(logger: Logger, fractions: Mapping[str, float]) -> None:
    """Take in where the wall time went so far: ``time/physics_fraction`` and the like."""
    for name, value in fractions.items():
        logger.record(f"time/{name}_fraction", round(value, 4))


def log_curriculum(logger: Logger, values: Mapping[str, float]) -> None:
    """Take in what curricula have set, as it stands: ``Curriculum/TERM``."""
    for name, value in values.items():
        logger.record(f"Curriculum/{name}", value)
