"""Logs of a training: `progress.csv` and TensorBoard's event files, by Stable-Baselines3's logger.

What is logged besides Stable-Baselines3's own keys is in `watch.py`.
"""

from __future__ import annotations

import importlib.util
import logging
from pathlib import Path

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import (
    CSVOutputFormat,
    KVWriter,
    Logger,
    TensorBoardOutputFormat,
)
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

__all__ = ["PROGRESS_FILE", "TENSORBOARD", "log_interval", "make_logger"]

PROGRESS_FILE = "progress.csv"
TENSORBOARD = "tensorboard"
_MOST_ROWS = 200
_log = logging.getLogger(__name__)


def make_logger(run_dir: Path) -> Logger:
    """Return a logger into a run's folder; event files only where `tensorboard` is installed."""
    formats: list[KVWriter] = [CSVOutputFormat(str(run_dir / PROGRESS_FILE))]
    if importlib.util.find_spec("tensorboard") is not None:
        formats.append(TensorBoardOutputFormat(str(run_dir / TENSORBOARD)))
    else:
        _log.info("no event files: pip install tensorboard")
    return Logger(folder=str(run_dir), output_formats=formats)


def log_interval(model: BaseAlgorithm, total_timesteps: int) -> int:
    """Return Stable-Baselines3's `log_interval` that makes at most about 200 rows.

    It counts rollouts for on-policy algorithms, episodes for the others.
    """
    if isinstance(model, OnPolicyAlgorithm):
        rollouts = total_timesteps // (model.n_steps * model.n_envs)
        return max(1, rollouts // _MOST_ROWS)
    return max(4, model.n_envs)
