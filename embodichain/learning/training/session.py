"""`Session`: trains a model in this process, from the first step or from a checkpoint.

A callback counts and logs, and on rollout boundaries writes checkpoints and stops. `TimeSplit`
divides the wall time into physics, environment, policy and update.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from torch import Tensor

from embodichain.learning.checkpoints.checkpoint import save_checkpoint
from embodichain.learning.checkpoints.curriculum_stage import save_stage
from embodichain.learning.checkpoints.plain_state import write_tree
from embodichain.learning.cloning.behavior_cloning import BehaviorCloning
from embodichain.learning.evaluation.episodes import TrainStatistics
from embodichain.learning.sb3.normalization import load_statistics, save_statistics, statistics_path
from embodichain.learning.sb3.training_state import (
    buffer_of,
    buffer_path,
    capture,
    full_size,
    load_buffer,
    load_parameters,
    restore,
    restore_exploration,
    restore_generators,
    save_buffer,
)
from embodichain.learning.sb3.vec_env import SB3VecEnv
from embodichain.learning.tensors.tensor_env import TensorEnv
from embodichain.learning.training.finite import NoValidStepError, told_apart
from embodichain.learning.training.keeper import state_path
from embodichain.learning.training.train_logs import (
    log_episode,
    log_interval,
    make_logger,
    rows_apart,
)
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["PARTS", "Progress", "Session", "TimeSplit"]

_log = logging.getLogger(__name__)
Progress = Callable[[TrainStatistics], None]
"""Called after every control step; KeyboardInterrupt stops at the next rollout boundary."""
PARTS = ("physics", "environment", "policy", "update")
"""Physics steps; the rest of `env.step` (observations, rewards, resets); the rest of a rollout
(actions of the policy, buffers, statistics); the time between two rollouts (the algorithm's
update, logs, checkpoints)."""
_MOST_INVALID_STEPS = 10
"""Control steps in a row in which every environment diverges, before a training ends."""


@dataclass
class Session:
    """One training in this process.

    Attributes:
        model: The model to train.
        vec_env: Its environment, without wrappers.
        statistics: The progress of the training.
        run_dir: The run's folder.
        writers: Further outputs of the logged numbers.
        replay_buffer: Whether resumable checkpoints include the replay buffer.
    """

    model: BaseAlgorithm
    vec_env: SB3VecEnv
    statistics: TrainStatistics
    run_dir: Path
    writers: tuple[KVWriter, ...] = ()
    replay_buffer: bool = False
    _restored: dict[str, Any] | None = None
    _logged: dict[str, Any] | None = None
    _watch: _Watch | None = None

    def __post_init__(self) -> None:
        self._buffer = buffer_of(self.model) if self.replay_buffer else None
        if self._buffer is not None:
            size = full_size(self._buffer) / 1e6
            _log.info("each checkpoint has the replay buffer, %.0f MB when it is full", size)

    @property
    def env_steps(self) -> int:
        """Environment steps taken, summed over environments."""
        return self.model.num_timesteps

    @property
    def updates(self) -> int:
        """Updates so far: one a rollout, or with a replay buffer the steps of its optimizers."""
        model = self.model
        if isinstance(model, OnPolicyAlgorithm):
            return model.num_timesteps // (model.n_steps * model.n_envs)
        # The model does not count the steps of an update that did not end.
        is_updating = self._watch is not None and self._watch.updating
        return int(getattr(model, "_n_updates", 0)) + is_updating

    def parameters(self) -> Iterator[Tensor]:
        """Parameters of the networks, and of SAC's temperature."""
        yield from self.model.policy.parameters()
        temperature = getattr(self.model, "log_ent_coef", None)
        if temperature is not None:
            yield temperature

    def losses(self) -> dict[str, Any]:
        """What the last update logged."""
        prefix = "train/"
        return {
            name.removeprefix(prefix): value
            for name, value in self.model.logger.name_to_value.items()
            if name.startswith(prefix)
        }

    def resume(self, checkpoint: Path, state: dict[str, Any]) -> None:
        """Restore a new model to the state of a checkpoint.

        Args:
            checkpoint: The zip.
            state: The training state from the file beside it, see `find_resumable`.

        Raises:
            ConfigError: The checkpoint is damaged, of another network, or of an older version that
                saved less.
        """
        load_parameters(self.model, checkpoint)
        try:
            restore(self.model, self.vec_env, state["training"])
            self.statistics.load_state_dict(state["statistics"])
            self._logged = state["logged"]
        except KeyError as error:
            message = (
                f"no training can continue from {checkpoint}: its state has no {error}. Other code"
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
        """Learn until all steps are taken or the training is stopped.

        Args:
            on_boundary: Called at the beginning of each rollout.
            progress: See `train`.

        Returns:
            The exception that stopped it, or None; and whether the model is between two rollouts,
            since a Ctrl-C raised by Python may come in the middle of an update.

        Raises:
            NotFiniteError: The networks or the losses are not finite.
            NoValidStepError: Every environment diverged in each of several control steps.
        """
        model = self.model
        total = self.statistics.total_timesteps

        def boundary() -> None:
            self._restore_exploration()
            on_boundary()

        watch = _Watch(
            env=self.vec_env,
            statistics=self.statistics,
            progress=progress,
            on_boundary=boundary,
            judges=isinstance(model, BehaviorCloning),
        )
        self._watch = watch
        if isinstance(model, BehaviorCloning):
            self.vec_env.base.hold_curriculum()  # its environments judge at the first stage
            model.after_row = watch.boundary
        logger = make_logger(
            self.run_dir,
            self.writers,
            env_steps=model.num_timesteps,
            every=rows_apart(model, total),
        )
        if self._logged is not None:
            logger.load_state_dict(self._logged)
        self._logger = logger
        model.set_logger(logger)
        is_new = self._restored is None
        if self._restored is not None:
            restore_generators(model, self._restored)
        self.statistics.begin()
        try:
            remaining = total - model.num_timesteps
            if remaining > 0:  # else only its results were not written
                with told_apart(self):
                    model.learn(
                        remaining,
                        watch,
                        log_interval=log_interval(model),
                        reset_num_timesteps=is_new,
                    )
        except KeyboardInterrupt as error:
            return error, error is watch.stopped
        finally:
            self.statistics.end()
            watch.end()
            logger.close()
        return None, True

    def save(self, path: Path, note: dict[str, Any], *, resumable: bool, rolling: bool) -> None:
        """Write a checkpoint, see `keeper.Saved`."""
        normalizer = self.model.get_vec_normalize_env()
        if normalizer is not None:
            save_statistics(statistics_path(path), normalizer)
        if resumable:
            if self._buffer is not None:
                save_buffer(buffer_path(path), self._buffer, self.env_steps)
            state = {
                "env_steps": self.env_steps,
                "replay_buffer": self._buffer is not None,
                "training": capture(self.model, self.vec_env, rolling=rolling),
                "statistics": self.statistics.state_dict(),
                "logged": self._logger.state_dict(),
            }
            write_tree(state_path(path), state)
        save_stage(path, self.vec_env.base)
        save_checkpoint(self.model, path, note)

    def _restore_exploration(self) -> None:
        """Restore, once, the exploration that the first rollout after a resume drew anew."""
        saved = self._restored
        self._restored = None
        if saved is None:
            return
        restore_exploration(self.model, saved)
        if saved["exploration"]:
            restore_generators(self.model, saved)


class _Watch(BaseCallback):
    """Counts steps and episodes; calls `on_boundary` between an update and the next rollout.

    With `judges`, a rollout evaluates the updates before it: `boundary` is to be called between
    the rollout and the next update instead.
    """

    def __init__(
        self,
        *,
        env: SB3VecEnv,
        statistics: TrainStatistics,
        progress: Progress | None,
        on_boundary: Callable[[], None],
        judges: bool,
    ) -> None:
        super().__init__()
        self.stopped: KeyboardInterrupt | None = None
        """The exception that `progress` raised to stop the training."""
        self.updating = False
        """Whether a rollout has ended and its update has not."""
        self._env = env
        self._split = TimeSplit()
        self._statistics = statistics
        self._progress = progress
        self._on_boundary = on_boundary
        self._judges = judges
        self._invalid_steps = 0

    def boundary(self) -> None:
        """Call `on_boundary`, and stop if told to; called between an update and a rollout."""
        self.updating = False
        self._on_boundary()
        if self.stopped is not None:
            raise self.stopped

    def _on_training_start(self) -> None:
        if self._judges:
            self._on_boundary()

    def _on_rollout_start(self) -> None:
        if not self._judges:
            self.boundary()
        self._split.rollout_begins(self._env)

    def _on_step(self) -> bool:
        statistics = self._statistics
        statistics.env_steps = self.num_timesteps
        infos = self.locals["infos"]
        diverged = 0
        for i in np.flatnonzero(self.locals["dones"]).tolist():
            statistics.add(infos[i])
            log_episode(self.logger, infos[i])
            diverged += infos[i]["ended_by"] == "diverged"
        if infos:  # cloning takes no steps
            self._check_validity(is_any_valid=diverged < len(infos))
        if self._progress is not None and self.stopped is None:
            try:
                self._progress(statistics)
            except KeyboardInterrupt as error:
                self.stopped = error  # after the rollout and its update, so that nothing is lost
        return True

    def _check_validity(self, *, is_any_valid: bool) -> None:
        """Count control steps that are invalid in every environment.

        Raises:
            NoValidStepError: There were `_MOST_INVALID_STEPS` in a row: nothing can be learned.
        """
        if is_any_valid:
            self._invalid_steps = 0
            return
        self._invalid_steps += 1
        if self._invalid_steps == _MOST_INVALID_STEPS:
            terms = ", ".join(f"task.{name}" for name in self._env.base.not_finite_terms)
            cause = f"{terms} not finite" if terms else "the physics diverges"
            raise NoValidStepError(
                f"no step of any environment was valid in {_MOST_INVALID_STEPS} control steps in a "
                f"row ({cause}), after {self.num_timesteps} environment steps: there is nothing to "
                "learn from"
            )

    def _on_rollout_end(self) -> None:
        self.updating = True
        self._split.rollout_ends(self._env)
        self._statistics.fractions = self._split.fractions
        for name, value in self._split.fractions.items():
            self.logger.record(f"time/{name}_fraction", round(value, 4))
        for name, value in self._env.base.curriculum_manager.values.items():
            self.logger.record(f"Curriculum/{name}", value)

    def end(self) -> None:
        """Count the time since the last rollout; called when learning ended, normally or not."""
        self.updating = False
        self._split.end()
        self._statistics.fractions = self._split.fractions


class TimeSplit:
    """Wall time by part; its methods are called at the beginning and end of rollouts.

    Attributes:
        seconds: Seconds of each of `PARTS` so far.
    """

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(PARTS, 0.0)
        self._last_call: float | None = None
        # Counters of the environment at the beginning of the rollout.
        self._physics_before = 0.0
        self._steps_before = 0.0

    @property
    def fractions(self) -> dict[str, float]:
        """Share of each part in the total, 0 to 1; empty before the end of the first rollout."""
        total = sum(self.seconds.values())
        if total <= 0:
            return {}
        return {name: value / total for name, value in self.seconds.items()}

    def rollout_begins(self, env: SB3VecEnv | TensorEnv) -> None:
        """Count the time since the last rollout as the update's."""
        self.end()
        self._physics_before = env.base.sim.physics_seconds
        self._steps_before = env.step_seconds

    def rollout_ends(self, env: SB3VecEnv | TensorEnv) -> None:
        """Count the time of a rollout that ended; the algorithm's update begins."""
        rollout = self._lap()
        physics = env.base.sim.physics_seconds - self._physics_before
        steps = env.step_seconds - self._steps_before
        self.seconds["physics"] += physics
        self.seconds["environment"] += steps - physics
        self.seconds["policy"] += rollout - steps

    def end(self) -> None:
        """Count the time since the last call of any method as the update's."""
        self.seconds["update"] += self._lap()

    def _lap(self) -> float:
        """Return the seconds since the last call; 0 in the first."""
        previous = self._last_call
        self._last_call = time.perf_counter()
        if previous is None:
            return 0.0
        return self._last_call - previous
