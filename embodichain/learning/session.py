"""`Session`: a model that learns in this process, from the first step or from a checkpoint.

A callback counts, logs, writes checkpoints and stops, on rollout boundaries. `TimeSplit` divides
the wall time into physics, environment, policy and update.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter

from embodichain.learning.episodes import TrainStatistics
from embodichain.learning.normalization import load_statistics, statistics_path
from embodichain.learning.train_logs import log_episode, log_interval, make_logger
from embodichain.learning.training_state import (
    buffer_of,
    buffer_path,
    load_buffer,
    load_parameters,
    restore,
    restore_exploration,
    restore_generators,
)
from embodichain.learning.vec_env import SB3VecEnv
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["PARTS", "Progress", "Session", "TimeSplit"]

Progress = Callable[[TrainStatistics], None]
"""Is called after every control step. KeyboardInterrupt stops at the next rollout boundary."""
PARTS = ("physics", "environment", "policy", "update")
"""Physics steps; what else `env.step` does (observations, rewards, resets); what else a rollout
does (actions of the policy, buffers, statistics); the time between two rollouts (the algorithm's
update, logs, checkpoints)."""


@dataclass
class Session:
    """One training in this process.

    Attributes:
        model: What learns.
        vec_env: What it learns in, without wrappers.
        statistics: How it goes.
        run_dir: The run's folder.
        writers: Further outputs of the logged numbers.
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
            state: From the file beside it, see `find_resumable`.

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
        """Learn until all steps are taken or it is stopped.

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

        watch = _Watch(self.vec_env, self.statistics, progress, boundary)
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


class _Watch(BaseCallback):
    """Counts steps and episodes; acts where a rollout begins, after the update of the last one."""

    def __init__(
        self,
        env: SB3VecEnv,
        statistics: TrainStatistics,
        progress: Progress | None,
        on_boundary: Callable[[], None],
    ) -> None:
        super().__init__()
        # What `progress` raised to stop the training.
        self.stopped: KeyboardInterrupt | None = None
        self._env = env
        self._split = TimeSplit()
        self._statistics = statistics
        self._progress = progress
        self._on_boundary = on_boundary

    def _on_rollout_start(self) -> None:
        self._on_boundary()
        self._split.rollout_begins(self._env)
        if self.stopped is not None:
            raise self.stopped

    def _on_step(self) -> bool:
        statistics = self._statistics
        statistics.env_steps = self.num_timesteps
        infos = self.locals["infos"]
        for i in np.flatnonzero(self.locals["dones"]).tolist():
            statistics.add(infos[i])
            log_episode(self.logger, infos[i])
        if self._progress is not None and self.stopped is None:
            try:
                self._progress(statistics)
            except KeyboardInterrupt as error:
                self.stopped = error  # the rollout and its update come first: nothing is lost
        return True

    def _on_rollout_end(self) -> None:
        self._split.rollout_ends(self._env)
        self._statistics.fractions = self._split.fractions
        for name, value in self._split.fractions.items():
            self.logger.record(f"time/{name}_fraction", round(value, 4))
        for name, value in self._env.base.curriculum_manager.values.items():
            self.logger.record(f"Curriculum/{name}", value)

    def end(self) -> None:
        """Learning ended, in whatever way: what came after the last rollout counts."""
        self._split.end()
        self._statistics.fractions = self._split.fractions


class TimeSplit:
    """Wall time by part; it is called where rollouts begin and end.

    Attributes:
        seconds: Seconds of each of `PARTS` so far.
    """

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(PARTS, 0.0)
        self._mark: float | None = None
        self._before = (0.0, 0.0)

    @property
    def fractions(self) -> dict[str, float]:
        """Share of each part in all of them, 0 to 1; empty before the end of the first rollout."""
        total = sum(self.seconds.values())
        return {name: value / total for name, value in self.seconds.items()} if total > 0 else {}

    def rollout_begins(self, env: SB3VecEnv) -> None:
        """A rollout begins: what lay between the last one and this is the update's."""
        self.end()
        self._before = _spent(env)

    def rollout_ends(self, env: SB3VecEnv) -> None:
        """A rollout ended, and the algorithm's update begins."""
        whole = self._lap()
        physics, steps = (
            now - before for now, before in zip(_spent(env), self._before, strict=True)
        )
        for part, seconds in zip(PARTS, (physics, steps - physics, whole - steps), strict=False):
            self.seconds[part] += seconds

    def end(self) -> None:
        """An update, or what came after the last rollout, has ended."""
        self.seconds["update"] += self._lap()

    def _lap(self) -> float:
        """Seconds since the last call; 0 in the first."""
        before, self._mark = self._mark, time.perf_counter()
        return 0.0 if before is None else self._mark - before


def _spent(env: SB3VecEnv) -> tuple[float, float]:
    return env.base.sim.physics_seconds, env.step_seconds
