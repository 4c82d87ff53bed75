"""A training's numbers for Weights & Biases, where it is installed and asked for (extra `wandb`).

What the numbers are is in `train_logs.py`.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stable_baselines3.common.logger import KVWriter

from embodichain.config.schema import WandbCfg
from embodichain.utils.errors import EmbodichainError, Problem

if TYPE_CHECKING:
    import wandb

__all__ = ["WandbWriter", "check_wandb", "wandb_writers"]


class WandbWriter(KVWriter):
    """Writes rows of Stable-Baselines3's logger into a run of Weights & Biases.

    Args:
        run: The run; whoever opened it finishes it.
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
        numbers = {k: v for k, v in key_values.items() if not isinstance(v, str)}
        self._run.log(numbers, step=step)

    def close(self) -> None:
        """Do nothing: the run ends with the training."""


def check_wandb(cfg: WandbCfg) -> list[Problem]:
    """Return what is wrong if Weights & Biases is asked for but not installed."""
    if cfg.mode == "disabled" or importlib.util.find_spec("wandb") is not None:
        return []
    message = "needs the package wandb: pip install 'embodichain[wandb]'"
    return [Problem("wandb.mode", message)]


@contextmanager
def wandb_writers(
    cfg: WandbCfg, run_dir: Path, config: Mapping[str, Any]
) -> Iterator[tuple[KVWriter, ...]]:
    """Open a run for a training; nothing without one. It is finished, or failed, with the block.

    Its files are in the folder `wandb` of the run's folder: `wandb sync` sends those of a run that
    was offline.

    Args:
        cfg: Whether and where to. With ``online`` the environment variable ``WANDB_MODE`` counts.
        run_dir: The training's folder.
        config: The resolved config, which is kept with the run.

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
            reinit="create_new",  # the jobs of a sweep are runs of their own
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
    """Read the variable here: the package does it only once a process."""
    return os.environ.get("WANDB_MODE", "online") if cfg.mode == "online" else cfg.mode
