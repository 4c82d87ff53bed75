"""Training on the environment's tensors: `TensorAlgorithm` builds, `TensorSession` trains.

The loop, logs and checkpoints are the same for all libraries; a `Learner` is one of them.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
import torch
from stable_baselines3.common.logger import KVWriter, Logger
from stable_baselines3.common.utils import set_random_seed
from torch import Tensor

from embodichain import __version__
from embodichain.config.keys.learners import LEARNERS
from embodichain.config.keys.tensor_algorithms import TensorAlgoCfg
from embodichain.learning.checkpoints.checkpoint import DIGEST, save_script
from embodichain.learning.checkpoints.curriculum_stage import save_stage
from embodichain.learning.checkpoints.plain_state import write_tree
from embodichain.learning.evaluation.episodes import TrainStatistics
from embodichain.learning.policies.exported import PolicyMetadata, script_bytes
from embodichain.learning.spaces import observation_columns
from embodichain.learning.tensors.tensor_env import (
    GROUP,
    EpisodeRecorder,
    Groups,
    TensorEnv,
    TensorStep,
    to_bounds,
)
from embodichain.learning.training.finite import check_finite, told_apart
from embodichain.learning.training.keeper import state_path
from embodichain.learning.training.session import Progress, TimeSplit
from embodichain.learning.training.train_logs import MOST_ROWS, make_logger
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["Learner", "TensorAlgorithm", "TensorSession"]


class Learner(Protocol):
    """An algorithm: it acts, stores steps, and learns from so many of them.

    It is made by ``build(cfg, env)``, with its config and the `TensorEnv` that it learns in, and
    registered with `learner`, see `embodichain.config.keys.learners`.

    Attributes:
        steps: Control steps of each environment between two updates.
    """

    steps: int

    def act(self, groups: Groups) -> Tensor:
        """Return actions (N, A), drawn for exploration."""

    def record(self, step: TensorStep) -> None:
        """Store what the last actions led to."""

    def update(self, groups: Groups) -> dict[str, float]:
        """Learn from the stored steps; `groups` is the current observation.

        Returns:
            Losses and other numbers to log.
        """

    def actor(self) -> torch.nn.Module:
        """Return a copy of the network: observations (N, K) -> mean actions (N, A)."""

    def parameters(self) -> Iterable[Tensor]:
        """Return the parameters of all networks."""

    def state_dict(self) -> dict[str, Any]:
        """Return networks, normalization and optimizer as plain values."""

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from a `state_dict`."""


@dataclass(frozen=True)
class TensorAlgorithm:
    """A checked algorithm on tensors, not yet built; see `Algorithm`."""

    cfg: TensorAlgoCfg
    flat: ClassVar[bool] = True
    has_replay_buffer: ClassVar[bool] = False
    is_cloning: ClassVar[bool] = False

    @classmethod
    def of(cls, cfg: TensorAlgoCfg) -> TensorAlgorithm:
        """Check that the library is installed.

        Raises:
            ConfigError: It is not; names the extra.
        """
        LEARNERS[cfg.name].require()
        return cls(cfg)

    @property
    def name(self) -> str:
        """As in ``algo.name``."""
        return self.cfg.name

    @property
    def critic_groups(self) -> tuple[str, ...]:
        """Observation groups of the critic; empty if it reads what the policy reads."""
        return tuple(self.cfg.critic_groups or ())

    def build(self, env: TensorEnv, seed: int | None) -> Learner:
        """Construct the algorithm; the seed is that of Python, numpy and torch.

        Raises:
            ConfigError: If a rollout has fewer steps than there are batches.
        """
        build = LEARNERS[self.name].load()
        if seed is not None:
            set_random_seed(seed)
        learner: Learner = build(self.cfg, env)
        key = self.cfg.batches_key  # empty for an algorithm whose rollout is one batch
        batches = getattr(self.cfg, key) if key else 1
        steps = learner.steps * env.num_envs
        if batches > steps:
            message = (
                f"a rollout has {steps} steps in all environments, {batches} batches need more"
            )
            raise ConfigError([Problem(f"algo.{key}", message)])
        return learner


@dataclass
class TensorSession:
    """One training in this process, see `Session`.

    Attributes:
        learner: The algorithm.
        vec_env: Its environment.
        statistics: The progress of the training.
        run_dir: The run's folder.
        writers: Further outputs of the logged numbers.
        seed: The seed of the environment's first reset.
    """

    learner: Learner
    vec_env: TensorEnv
    statistics: TrainStatistics
    run_dir: Path
    writers: tuple[KVWriter, ...] = ()
    seed: int = 0
    _groups: Groups = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._recorder = EpisodeRecorder(self.vec_env)
        self._generators: dict[str, Any] | None = None
        self._logged: dict[str, Any] | None = None
        self._losses: dict[str, float] = {}

    @property
    def env_steps(self) -> int:
        """Environment steps taken, summed over environments."""
        return self.statistics.env_steps

    @property
    def updates(self) -> int:
        """Updates so far: one a rollout."""
        return self.env_steps // (self.learner.steps * self.vec_env.num_envs)

    def parameters(self) -> Iterable[Tensor]:
        """Parameters of all networks."""
        return self.learner.parameters()

    def losses(self) -> dict[str, float]:
        """What the last update returned."""
        return self._losses

    def resume(self, checkpoint: Path, state: dict[str, Any]) -> None:
        """Restore networks, environment, statistics and generators from a checkpoint.

        Args:
            checkpoint: The zip.
            state: The training state from the file beside it.

        Raises:
            ConfigError: The state is of another network or of an older version that saved less.
        """
        device = self.vec_env.device
        try:
            saved = state["training"]
            self.learner.load_state_dict(saved["learner"])
            self.vec_env.reset()  # creates lazily built state, which is overwritten below
            self.vec_env.base.load_state_dict(saved["env"])
            self._groups = {name: value.to(device) for name, value in saved["groups"].items()}
            self._recorder.returns = saved["returns"].to(device)
            self._generators = saved["generators"]
            self.statistics.load_state_dict(state["statistics"])
            self._logged = state["logged"]
        except (KeyError, RuntimeError, ValueError) as error:
            why = " ".join(str(error).split())
            message = f"no training can continue from {checkpoint}, its state does not fit: {why}"
            raise ConfigError([Problem("resume", message)]) from error
        self.statistics.env_steps = state["env_steps"]

    def learn(
        self, on_boundary: Callable[[], None], progress: Progress | None
    ) -> tuple[KeyboardInterrupt | None, bool]:
        """Learn until all steps are taken or the training is stopped; see `Session.learn`."""
        statistics = self.statistics
        split = TimeSplit()
        rollout_steps = self.learner.steps * self.vec_env.num_envs
        logger = make_logger(
            self.run_dir,
            self.writers,
            env_steps=statistics.env_steps,
            every=max(1, statistics.total_timesteps // rollout_steps // MOST_ROWS),
        )
        if self._logged is not None:
            logger.load_state_dict(self._logged)
        self._logger = logger
        if self._generators is None:
            self._groups = self.vec_env.reset(seed=self.seed)
        else:
            _set_generators(self._generators)
        stopped = None
        statistics.begin()
        try:
            while statistics.env_steps < statistics.total_timesteps:
                on_boundary()
                if stopped is not None:
                    return stopped, True
                split.rollout_begins(self.vec_env)
                stopped = self._rollout(progress)
                episodes = self._recorder.finish()
                split.rollout_ends(self.vec_env)
                statistics.fractions = split.fractions
                with told_apart(self):
                    self._losses = self.learner.update(self._groups)
                    check_finite(self)
                self._log(logger, episodes, self._losses)
                logger.dump(step=statistics.env_steps)
        except KeyboardInterrupt as error:
            return error, False
        finally:
            statistics.end()
            split.end()
            statistics.fractions = split.fractions
            logger.close()
        return stopped, True

    def _rollout(self, progress: Progress | None) -> KeyboardInterrupt | None:
        """Take the steps of one rollout; return the interrupt that `progress` raised."""
        stopped = None
        with torch.no_grad():
            for _ in range(self.learner.steps):
                step = self.vec_env.step(self.learner.act(self._groups))
                self.learner.record(step)
                self._recorder.add(step)
                self._groups = step.groups
                self.statistics.env_steps += self.vec_env.num_envs
                if progress is not None and stopped is None:
                    try:
                        progress(self.statistics)
                    except KeyboardInterrupt as error:
                        stopped = error  # after the update, so that nothing is lost
        return stopped

    def _log(self, logger: Logger, episodes: dict[str, Any], losses: dict[str, float]) -> None:
        """Log a rollout and its update.

        Args:
            logger: The logger.
            episodes: Name -> (E,) values of the episodes that ended in the rollout.
            losses: What the update returned.
        """
        statistics = self.statistics
        statistics.extend(episodes["return"], episodes["length"], episodes.get("success"))
        for name, values in episodes.items():
            if "/" in name and len(values):
                logger.record_mean(name, float(values.mean()))
        means = {
            "ep_rew_mean": statistics.mean_return,
            "ep_len_mean": statistics.mean_length,
            "success_rate": statistics.success_rate,
        }
        for name, mean in means.items():
            if mean is not None:
                logger.record(f"rollout/{name}", mean)
        for name, value in losses.items():
            logger.record(f"train/{name}", value)
        for name, value in statistics.fractions.items():
            logger.record(f"time/{name}_fraction", round(value, 4))
        for name, value in self.vec_env.base.curriculum_manager.values.items():
            logger.record(f"Curriculum/{name}", value)
        logger.record("time/fps", int(statistics.env_steps_per_second))
        logger.record("time/total_timesteps", statistics.env_steps, exclude="tensorboard")

    def save(self, path: Path, note: dict[str, Any], *, resumable: bool, rolling: bool) -> None:
        """Write a checkpoint: the policy, and beside it what the training needs to continue.

        Args:
            path: The zip.
            note: Its metadata.
            resumable: Whether the training is between two rollouts.
            rolling: Unused: nothing is drawn before the first step of a rollout.
        """
        if resumable:
            training = {
                "learner": self.learner.state_dict(),
                "env": self.vec_env.base.state_dict(),
                "groups": self._groups,
                "returns": self._recorder.returns,
                "generators": _get_generators(self.vec_env.device),
            }
            state = {
                "env_steps": self.env_steps,
                "replay_buffer": False,
                "training": training,
                "statistics": self.statistics.state_dict(),
                "logged": self._logger.state_dict(),
            }
            write_tree(state_path(path), state)
        save_stage(path, self.vec_env.base)
        low = self.vec_env.low.cpu()
        high = self.vec_env.high.cpu()
        metadata = PolicyMetadata(
            task=note["task"],
            algo=note["algo"],
            group=GROUP,
            columns=observation_columns(self.vec_env.base, GROUP),
            action_low=tuple(low.tolist()),
            action_high=tuple(high.tolist()),
            embodichain=__version__,
            trained_in=note[DIGEST],
        )
        example = torch.zeros(2, len(metadata.columns))
        actor = self.learner.actor().cpu()
        policy = _Acting(actor, self.vec_env.action_scale, low, high)
        save_script(script_bytes(policy, example, metadata), path, note)


class _Acting(torch.nn.Module):
    """Maps observations (N, K) to the mean action (N, A) within the task's bounds."""

    low: Tensor
    high: Tensor

    def __init__(self, actor: torch.nn.Module, scale: float, low: Tensor, high: Tensor) -> None:
        super().__init__()
        self.actor = actor
        self.scale = scale
        self.register_buffer("low", low)
        self.register_buffer("high", high)

    def forward(self, observations: Tensor) -> Tensor:
        return to_bounds(self.actor(observations) * self.scale, self.low, self.high)


def _get_generators(device: torch.device) -> dict[str, Any]:
    """Return the state of the generators that the libraries draw from."""
    states: dict[str, Any] = {
        "torch": torch.get_rng_state(),
        "python": random.getstate(),
        "numpy": np.random.get_state(),  # noqa: NPY002
    }
    if device.type == "cuda":
        states["cuda"] = torch.cuda.get_rng_state(device)
    return states


def _set_generators(saved: dict[str, Any]) -> None:
    torch.set_rng_state(saved["torch"])
    random.setstate(saved["python"])
    np.random.set_state(saved["numpy"])  # noqa: NPY002
    if "cuda" in saved:
        torch.cuda.set_rng_state(saved["cuda"])
