"""`BehaviorCloning`: supervised learning from demonstrations, as an algorithm of SB3.

It steps the environment only to evaluate the policy while it learns.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import MaybeCallback, Schedule
from stable_baselines3.common.utils import safe_mean
from stable_baselines3.common.vec_env import VecEnv

from embodichain.learning.cloning.chunk_policy import (
    ChunkPolicy,
    CnnChunkPolicy,
    MultiInputChunkPolicy,
)
from embodichain.learning.cloning.demonstrations import Demonstrations, learn_scales
from embodichain.learning.sb3.normalization import NormalizeStatistics
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["PLAY_SEED_OFFSET", "BehaviorCloning"]

PLAY_SEED_OFFSET = 2**33
"""Added to the seed of the episodes that are played while learning: other ones than those of
collections, trainings and evaluations."""
_LOG_ROWS = 200
"""Rows of a training's log."""
_LONGEST_EPISODE = 1000
"""Control steps played of an episode without a limit."""
_VALIDATION_STEPS = 8192
"""Most steps of demonstrations on which the validation loss is computed."""
# First entries of the seeds of separate generators.
_SPLIT_STREAM = 0
_BATCH_STREAM = 1


class BehaviorCloning(BaseAlgorithm):
    """Learns to do what demonstrations do in the same situation, the next H actions at once.

    The loss is the mean squared difference of actions in [-1, 1], which is averaged over the steps
    of a chunk that are in the episode. A "timestep" is a step of a demonstration in a batch.

    Args:
        policy: A `ChunkPolicy` or its alias.
        env: The environment: its spaces, and where the policy is played.
        learning_rate: Of the optimizer.
        batch_size: Steps of demonstrations in one update.
        chunk_size: H; 1 is behaviour cloning without memory.
        ensemble_decay: How much less later predictions of the same action count, see `chunks`.
        validation_share: Share of the demonstrations that is not learned from; their loss is
            logged.
        ignore: Observations that the policy does not read; None are those of the last action, which
            it would copy instead of looking at the rest.
        max_grad_norm: Largest norm of a gradient.
        policy_kwargs: Arguments of the policy's class.
        seed: Seed of networks, batches and played episodes.
        device: Where the networks are.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {
        "MlpPolicy": ChunkPolicy,
        "CnnPolicy": CnnChunkPolicy,
        "MultiInputPolicy": MultiInputChunkPolicy,
    }
    policy: ChunkPolicy

    def __init__(
        self,
        policy: str | type[BasePolicy],
        env: VecEnv | None,
        learning_rate: float | Schedule = 1e-3,
        batch_size: int = 256,
        chunk_size: int = 16,
        ensemble_decay: float = 0.1,
        validation_share: float = 0.1,
        ignore: list[str] | None = None,
        max_grad_norm: float = 10.0,
        policy_kwargs: dict[str, Any] | None = None,
        seed: int | None = None,
        device: torch.device | str = "auto",
        _init_setup_model: bool = True,
    ) -> None:
        super().__init__(
            policy,
            env,
            learning_rate,
            policy_kwargs=policy_kwargs,
            seed=seed,
            device=device,
            support_multi_env=True,
        )
        self.batch_size = batch_size
        self.chunk_size = chunk_size
        self.ensemble_decay = ensemble_decay
        self.validation_share = validation_share
        self.ignore = ignore
        self.max_grad_norm = max_grad_norm
        self.play_every: int | None = None
        self.after_row: Callable[[], None] | None = None
        self._next_play: int | None = None
        self._data: _Batches | None = None
        self._held_out: _Batches | None = None
        if _init_setup_model:
            self._setup_model()

    def _setup_model(self) -> None:
        self._setup_lr_schedule()
        self.set_random_seed(self.seed)
        self.policy = self.policy_class(  # type: ignore[assignment]
            self.observation_space,
            self.action_space,
            self.lr_schedule,
            chunk_size=self.chunk_size,
            ensemble_decay=self.ensemble_decay,
            **self.policy_kwargs,
        ).to(self.device)

    def set_demonstrations(self, found: Demonstrations) -> None:
        """Take demonstrations to learn from; observations are normalized by their statistics.

        Raises:
            ConfigError: If no episode remains for learning or for validation.
        """
        count = len(found.lengths)
        held_out_count = round(count * self.validation_share)
        if self.validation_share and held_out_count in (0, count):
            message = f"{self.validation_share} of {count} episodes leaves none on one side"
            raise ConfigError([Problem("algo.validation_share", message)])
        observations: Any = found.observations
        normalizer = self._vec_normalize_env
        if normalizer is not None:
            learn_scales(normalizer, found, rewards=False)
            normalizer.training = False
            statistics = NormalizeStatistics.of(normalizer)
            if "" in observations:
                observations = {"": statistics.normalize(observations[""])}
            else:
                observations = statistics.normalize(observations)
        generator = np.random.default_rng([self.seed or 0, _SPLIT_STREAM])
        held_out_episodes = generator.permutation(count)[:held_out_count]
        is_held_out = np.isin(found.episode, held_out_episodes)
        self._data = _Batches(observations, found, np.flatnonzero(~is_held_out))
        self._held_out = _Batches(observations, found, np.flatnonzero(is_held_out))

    def learn(
        self,
        total_timesteps: int,
        callback: MaybeCallback = None,
        log_interval: int = 1,
        tb_log_name: str = "BC",
        reset_num_timesteps: bool = True,
        progress_bar: bool = False,
    ) -> BehaviorCloning:
        """Learn from `total_timesteps` steps of demonstrations, in batches.

        The policy is played after every `play_every` of them (None: at the end alone), one episode
        in each environment: for callbacks these are the rollouts.

        Args:
            total_timesteps: Steps of demonstrations, each as often as it is used.
            callback: Called as by other algorithms, and after every update.
            log_interval: Unused: about 200 rows are logged.
            tb_log_name: As for other algorithms.
            reset_num_timesteps: Whether to begin at 0.
            progress_bar: As for other algorithms.

        Raises:
            ValueError: If there are no demonstrations.
        """
        data = self._data
        if data is None:
            raise ValueError("there is nothing to learn from: call set_demonstrations first")
        total, callbacks = self._setup_learn(
            total_timesteps,
            callback,
            reset_num_timesteps,
            tb_log_name=tb_log_name,
            progress_bar=progress_bar,
        )
        callbacks.on_training_start(locals(), globals())
        play_every = self.play_every or total
        row_steps = -(-total // _LOG_ROWS)
        if self._next_play is None or reset_num_timesteps:
            self._next_play = self.num_timesteps + play_every
        while self.num_timesteps < total:
            self._train(data, min(self.num_timesteps + row_steps, total), callbacks)
            callbacks.on_rollout_start()
            if self.num_timesteps >= min(self._next_play, total):
                self._next_play = self.num_timesteps + play_every
                self._play(callbacks)
            callbacks.on_rollout_end()
            self.logger.record("time/total_timesteps", self.num_timesteps, exclude="tensorboard")
            self.logger.dump(step=self.num_timesteps)
            if self.after_row is not None:
                self.after_row()
        callbacks.on_training_end()
        return self

    def _train(self, data: _Batches, until: int, callbacks: BaseCallback) -> None:
        """Update the policy with batches until so many steps were used."""
        policy = self.policy
        losses: list[float] = []
        policy.set_training_mode(True)
        self._update_current_progress_remaining(self.num_timesteps, self._total_timesteps)
        self._update_learning_rate(policy.optimizer)
        callbacks.update_locals({"infos": [], "dones": np.zeros(0, np.bool_)})
        while self.num_timesteps < until:
            # One generator for each update, so that a resumed training draws the same batches.
            generator = np.random.default_rng([self.seed or 0, _BATCH_STREAM, self._n_updates])
            loss = self._loss(data, generator.integers(data.count, size=self.batch_size))
            policy.optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(policy.parameters(), self.max_grad_norm)
            policy.optimizer.step()
            losses.append(loss.item())
            self._n_updates += 1
            self.num_timesteps += self.batch_size
            callbacks.on_step()
        self.logger.record("train/loss", float(np.mean(losses)))
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        held_out = self._held_out
        if held_out is not None and held_out.count:
            policy.set_training_mode(False)
            stride = -(-held_out.count // _VALIDATION_STEPS)
            with torch.no_grad():
                loss = self._loss(held_out, np.arange(0, held_out.count, stride))
            self.logger.record("train/validation_loss", loss.item())

    def _loss(self, data: _Batches, numbers: NDArray[np.int64]) -> torch.Tensor:
        """Return the mean squared difference from the actions of some steps and the next ones."""
        observations, actions, is_inside = data.batch(numbers, self.chunk_size, self.device)
        differences = (self.policy.chunks(observations) - actions).square().mean(dim=-1)
        return (differences * is_inside).sum() / is_inside.sum()

    def _play(self, callbacks: BaseCallback) -> None:
        """Play one episode in each environment; callbacks see their ends."""
        env = self.env
        if env is None:
            raise ValueError("a model without environment cannot play")
        env.seed(PLAY_SEED_OFFSET + (self.seed or 0))
        obs: Any = env.reset()
        memory: Any = None
        starts = np.ones(env.num_envs, np.bool_)
        is_playing = starts.copy()
        final_infos: list[dict[str, Any]] = []
        limit = env.get_attr("max_episode_steps")[0]
        if limit <= 0:
            limit = _LONGEST_EPISODE
        for _ in range(limit):
            actions, memory = self.policy.predict(obs, memory, starts)
            obs, _, dones, infos = env.step(actions)
            starts = dones
            ended = dones & is_playing
            is_playing &= ~dones
            final_infos += [infos[i] for i in np.flatnonzero(ended)]
            callbacks.update_locals({"infos": infos, "dones": ended})
            callbacks.on_step()
            if not is_playing.any():
                break
        if final_infos:
            returns = [info["episode"]["r"] for info in final_infos]
            lengths = [info["episode"]["l"] for info in final_infos]
            self.logger.record("rollout/ep_rew_mean", safe_mean(returns))
            self.logger.record("rollout/ep_len_mean", safe_mean(lengths))
        successes = [info["is_success"] for info in final_infos if "is_success" in info]
        if successes:
            self.logger.record("rollout/success_rate", safe_mean(successes))

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "_data", "_held_out", "after_row"]

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        return ["policy", "policy.optimizer"], []


class _Batches:
    """Some steps of demonstrations, as batches of tensors.

    Args:
        observations: Those of the demonstrations, normalized.
        demonstrations: The demonstrations.
        steps: (n,) the steps.

    Attributes:
        count: n.
    """

    def __init__(
        self, observations: Any, demonstrations: Demonstrations, steps: NDArray[np.int64]
    ) -> None:
        last_steps = np.cumsum(demonstrations.lengths) - 1
        self.count = len(steps)
        self._observations = observations
        self._actions = demonstrations.actions
        self._steps = steps
        # Of each step: the row of its observation, and the last step of its episode.
        self._before = demonstrations.before[steps]
        self._last = last_steps[demonstrations.episode[steps]]

    def batch(
        self, numbers: NDArray[np.int64], size: int, device: torch.device
    ) -> tuple[Any, torch.Tensor, torch.Tensor]:
        """Return observations (B, ...), the actions (B, H, A), and whether these exist (B, H).

        Args:
            numbers: (B,) numbers from 0 to n - 1.
            size: H.
            device: Where the tensors are.
        """
        chunk = self._steps[numbers][:, None] + np.arange(size)
        last = self._last[numbers][:, None]
        actions = torch.from_numpy(self._actions[np.minimum(chunk, last)]).to(device)
        is_inside = torch.from_numpy((chunk <= last).astype(np.float32)).to(device)
        rows = self._before[numbers]
        observations = {
            key: torch.from_numpy(entry[rows]).to(device)
            for key, entry in self._observations.items()
        }
        return observations.get("", observations), actions, is_inside
