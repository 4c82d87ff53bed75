"""`Session`: a model, its environment and its statistics, from the first step or from a checkpoint.

What is written of it is `keeper.py`'s; what happens in every step, `watch.py`'s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import KVWriter

from embodichain.learning.episodes import TrainStatistics
from embodichain.learning.normalization import load_statistics, statistics_path
from embodichain.learning.replay_buffer import buffer_of, buffer_path, load_buffer
from embodichain.learning.train_logs import log_interval, make_logger
from embodichain.learning.training_state import (
    load_parameters,
    restore,
    restore_exploration,
    restore_generators,
)
from embodichain.learning.vec_env import SB3VecEnv
from embodichain.learning.watch import Progress, Watch
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["Session"]


@dataclass
class Session:
    """One training in this process.

    Attributes:
        model: What learns.
        vec_env: What it learns in, without wrappers.
        statistics: How it goes.
        run_dir: The run's folder.
        writers: Who is told the logged numbers besides the files in it.
    """

    model: BaseAlgorithm
    vec_env: SB3VecEnv
    statistics: TrainStatistics
    run_dir: Path
    writers: tuple[KVWriter, ...] = ()
    _restored: dict[str, Any] | None = None

    def resume(self, checkpoint: Path, state: dict[str, Any]) -> None:
        """Put the new model where a checkpoint was written.

        Args:
            checkpoint: The zip.
            state: What lies beside it, see `find_resumable`.

        Raises:
            ConfigError: The checkpoint is damaged, of another network, or of code that kept less.
        """
        load_parameters(self.model, checkpoint)
        try:
            restore(self.model, self.vec_env, state["training"])
            self.statistics.load_state_dict(state["statistics"])
        except KeyError as error:
            message = (
                f"no training can go on from {checkpoint}: its state has no {error}. Other code"
                " wrote it (versions.json in its run's folder), of embodichain or of a term with a"
                " state; `policy=` loads its network nevertheless"
            )
            raise ConfigError([Problem("resume", message)]) from error
        buffer = buffer_of(self.model)
        if buffer is not None and state.get("replay_buffer"):
            load_buffer(buffer_path(checkpoint), buffer, state["env_steps"])
        normalizer = self.model.get_vec_normalize_env()
        if normalizer is not None:
            load_statistics(statistics_path(checkpoint)).restore(normalizer)
        self.statistics.env_steps = self.model.num_timesteps
        self._restored = state["training"]

    def learn(
        self, on_boundary: Callable[[], None], progress: Progress | None
    ) -> tuple[KeyboardInterrupt | None, bool]:
        """Learn until all steps are taken or somebody stops it.

        Args:
            on_boundary: Called as each rollout begins.
            progress: See `train`.

        Returns:
            What stopped it, None for its end; and whether the model is between two rollouts:
            a Ctrl-C that Python itself raised may have come in the middle of an update.
        """
        model, total = self.model, self.statistics.total_timesteps

        def boundary() -> None:
            self._restore_exploration()
            on_boundary()

        watch = Watch(self.vec_env, self.statistics, progress, boundary)
        logger = make_logger(self.run_dir, self.writers)
        model.set_logger(logger)
        interval, new = log_interval(model, total), self._restored is None
        if self._restored is not None:
            restore_generators(model, self._restored)
        self.statistics.begin()
        try:
            remaining = total - model.num_timesteps
            model.learn(remaining, watch, log_interval=interval, reset_num_timesteps=new)
        except KeyboardInterrupt as error:
            return error, error is watch.stopped
        finally:
            self.statistics.end()
            watch.end()
            logger.close()
        return None, True

    def _restore_exploration(self) -> None:
        """Undo, once, what the first rollout of a resumed training drew anew as it began."""
        saved, self._restored = self._restored, None
        if saved is not None:
            restore_exploration(self.model, saved)
        if saved is not None and saved["exploration"]:
            restore_generators(self.model, saved)
