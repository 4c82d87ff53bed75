"""Logging of a training's numbers: `progress.csv`, TensorBoard, Weights & Biases."""

from __future__ import annotations

import csv
import importlib.util
import logging
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import (
    CSVOutputFormat,
    KVWriter,
    Logger,
    TensorBoardOutputFormat,
    filter_excluded_keys,
)
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from embodichain.config.keys.schema import WandbCfg
from embodichain.learning.evaluation.comparison import PROGRESS, STEPS
from embodichain.learning.sb3.vec_env import ENDS
from embodichain.utils.errors import EmbodichainError, Problem
from embodichain.utils.system.atomic import write_text

if TYPE_CHECKING:
    import wandb

__all__ = [
    "MOST_ROWS",
    "TENSORBOARD",
    "TrainLogger",
    "WandbWriter",
    "check_wandb",
    "log_episode",
    "log_interval",
    "make_logger",
    "rows_apart",
    "wandb_writers",
]

TENSORBOARD = "tensorboard"
MOST_ROWS = 200
"""Most rows of `progress.csv`, about."""
_ITERATIONS = "time/iterations"
_log = logging.getLogger(__name__)


class TrainLogger(Logger):
    """Stable-Baselines3's logger, of which a resumed training writes the same rows.

    Args:
        folder: The run's folder.
        output_formats: Where rows are written.
        every: Write one row of so many; the others' values go into the next that is written.

    Attributes:
        rows: Rows so far, written or not, including those before a resume.
    """

    def __init__(self, folder: str, output_formats: list[KVWriter], every: int = 1) -> None:
        super().__init__(folder, output_formats)
        self.rows = 0
        self._every = every

    def dump(self, step: int = 0) -> None:
        """Write the values as a row, if it is due."""
        self.rows += 1
        if _ITERATIONS in self.name_to_value:  # counted since `learn` was called
            self.record(_ITERATIONS, self.rows, exclude="tensorboard")
        if self.rows % self._every == 0:
            super().dump(step)

    def state_dict(self) -> dict[str, Any]:
        """Return what is not yet written, for resuming the training."""
        return {
            "rows": self.rows,
            "values": dict(self.name_to_value),
            "counts": dict(self.name_to_count),
            "excluded": dict(self.name_to_excluded),
        }

    def load_state_dict(self, saved: Mapping[str, Any]) -> None:
        """Continue from a `state_dict`."""
        self.rows = saved["rows"]
        self.name_to_value.update(saved["values"])
        self.name_to_count.update(saved["counts"])
        self.name_to_excluded.update(saved["excluded"])


def make_logger(
    run_dir: Path, writers: Sequence[KVWriter] = (), env_steps: int = 0, every: int = 1
) -> TrainLogger:
    """Return a logger for a run's folder; event files need an installed `tensorboard`.

    Args:
        run_dir: The folder.
        writers: Further outputs of the same numbers.
        env_steps: Environment steps that the training has taken already. If it continues in its
            folder, rows of `progress.csv` up to there are kept.
        every: Write one row of so many.
    """
    formats: list[KVWriter] = [_ContinuedCsv(run_dir / PROGRESS, env_steps)]
    if importlib.util.find_spec("tensorboard") is not None:
        formats.append(TensorBoardOutputFormat(str(run_dir / TENSORBOARD)))
    else:
        _log.info("no event files: pip install tensorboard")
    return TrainLogger(str(run_dir), [*formats, *writers], every)


class _ContinuedCsv(CSVOutputFormat):
    """Stable-Baselines3's CSV file, with the rows that it has already up to a number of steps."""

    def __init__(self, path: Path, env_steps: int) -> None:
        super().__init__(os.devnull)  # it would empty the file
        self.file.close()
        self._path = path
        lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
        rows = list(csv.reader(lines))
        if rows and STEPS in rows[0]:
            self.keys = rows[0]
            step_column = self.keys.index(STEPS)
            lines_before = [lines[0]]
            for line, cells in zip(lines[1:], rows[1:], strict=False):
                # A killed process may have written a part of the last row.
                is_complete = len(cells) == len(self.keys)
                if is_complete and 0 < float(cells[step_column] or 0) <= env_steps:
                    lines_before.append(line)
            write_text(path, "\n".join(lines_before) + "\n")
        else:
            write_text(path, "")
        self._open()

    def _open(self) -> None:
        self.file = self._path.open("r+", encoding="utf-8")
        self.file.seek(0, os.SEEK_END)

    def write(
        self,
        key_values: dict[str, Any],
        key_excluded: dict[str, tuple[str, ...]],
        step: int = 0,
    ) -> None:
        """Write a row; new columns are sorted, since a set of names has a random order."""
        names = filter_excluded_keys(key_values, key_excluded, "csv").keys()
        new_names = sorted(names - set(self.keys))
        if new_names:
            self.keys.extend(new_names)
            empty_cells = "," * len(new_names)
            rows = self._path.read_text(encoding="utf-8").splitlines()[1:]
            lines = [",".join(self.keys)]
            lines += [row + empty_cells for row in rows]
            write_text(self._path, "\n".join(lines) + "\n")
            self.file.close()
            self._open()
        super().write(key_values, key_excluded, step)


def log_interval(model: BaseAlgorithm) -> int:
    """Return the `log_interval` for Stable-Baselines3.

    For on-policy algorithms it is each rollout, of which the logger skips some (`rows_apart`), for
    the others some episodes.
    """
    if isinstance(model, OnPolicyAlgorithm):
        return 1
    return max(4, model.n_envs)


def rows_apart(model: BaseAlgorithm, total_timesteps: int) -> int:
    """Return how many rows of a model's log make one that is written, of at most about 200."""
    if isinstance(model, OnPolicyAlgorithm):
        rollouts = total_timesteps // (model.n_steps * model.n_envs)
        return max(1, rollouts // MOST_ROWS)
    return 1


def log_episode(logger: Logger, info: Mapping[str, Any]) -> None:
    """Log the info of an environment at the end of its episode, averaged until a row is written.

    ``Episode_Reward/TERM`` is the sum of a reward term over an episode, ``Episode_Metrics/NAME`` a
    metric at its end. ``Episode_Termination/`` are shares of episodes: ``success``, ``fail``,
    ``time_out`` or ``diverged`` is the cause of the end (the first that applies); for the name of a
    termination term, the share of episodes at whose end the term was true.
    """
    for name, value in info["reward_sums"].items():
        logger.record_mean(f"Episode_Reward/{name}", value)
    for name, value in info["metrics"].items():
        logger.record_mean(f"Episode_Metrics/{name}", float(value))
    has_diverged = info["ended_by"] == "diverged"
    ends = {cause: info["ended_by"] == cause for cause in ENDS}
    for name, is_true in info["terminations"].items():
        ends.setdefault(name, is_true and not has_diverged)
    for name, is_true in ends.items():
        logger.record_mean(f"Episode_Termination/{name}", float(is_true))


class WandbWriter(KVWriter):
    """Writes rows of Stable-Baselines3's logger into a run of Weights & Biases.

    Args:
        run: The run; this class does not finish it.
    """

    def __init__(self, run: wandb.Run) -> None:
        self._run = run

    def write(
        self,
        key_values: dict[str, Any],
        key_excluded: dict[str, tuple[str, ...]],
        step: int = 0,
    ) -> None:
        """Write the numbers of a row; `step` is in environment steps."""
        numbers = {key: value for key, value in key_values.items() if not isinstance(value, str)}
        self._run.log(numbers, step=step)

    def close(self) -> None:
        """Do nothing: the run ends with the training."""


def check_wandb(cfg: WandbCfg) -> list[Problem]:
    """Return a problem if Weights & Biases is configured but not installed."""
    if cfg.mode == "disabled" or importlib.util.find_spec("wandb") is not None:
        return []
    message = "needs the package wandb: pip install 'embodichain[wandb]'"
    return [Problem("wandb.mode", message)]


@contextmanager
def wandb_writers(
    cfg: WandbCfg, run_dir: Path, config: Mapping[str, Any]
) -> Iterator[tuple[KVWriter, ...]]:
    """Open a run of Weights & Biases if configured; the context marks it finished or failed.

    Its files are in the folder `wandb` of the run's folder; `wandb sync` uploads those of an
    offline run.

    Args:
        cfg: The config; with ``online`` the environment variable ``WANDB_MODE`` is respected.
        run_dir: The training's folder.
        config: The resolved config, saved with the run.

    Raises:
        EmbodichainError: The run cannot be opened: not logged in, no network, no such entity.
    """
    if cfg.mode == "disabled":
        yield ()
        return
    import wandb

    try:
        run = wandb.init(
            mode=_mode(cfg),
            dir=str(run_dir),
            project=cfg.project,
            entity=cfg.entity,
            name=cfg.name or run_dir.name,
            group=cfg.group,
            tags=list(cfg.tags),
            config=dict(config),
            reinit="create_new",  # each job of a sweep is a separate run
            settings=wandb.Settings(console="off", silent=True),
        )
    except wandb.errors.Error as error:
        raise EmbodichainError(
            f"Weights & Biases: {error} (wandb.mode=offline needs none)"
        ) from error
    failed = True
    try:
        yield (WandbWriter(run),)
        failed = False
    except KeyboardInterrupt:
        failed = False
        raise
    finally:
        run.finish(exit_code=int(failed))


def _mode(cfg: WandbCfg) -> Any:
    """Return the mode of a run; ``online`` may be changed by ``WANDB_MODE``."""
    if cfg.mode == "online":
        # The package reads the variable only once per process.
        return os.environ.get("WANDB_MODE", "online")
    return cfg.mode
