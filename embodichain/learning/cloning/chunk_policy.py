"""`ChunkPolicy`: predicts the next actions at once, as a policy of Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.preprocessing import preprocess_obs
from stable_baselines3.common.torch_layers import (
    BaseFeaturesExtractor,
    FlattenExtractor,
    NatureCNN,
    create_mlp,
)
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule

from embodichain.learning.cloning.chunks import blend
from embodichain.learning.sb3.extractors import SmallCnn

__all__ = ["ChunkPolicy", "CnnChunkPolicy", "MultiInputChunkPolicy"]


class ChunkPolicy(BasePolicy):
    """Maps an observation to the next H actions; acts by their temporal ensemble (`blend`).

    With H = 1 it has no memory.

    Args:
        observation_space: A Box (K,); see the subclasses for images and dicts.
        action_space: The actions, (A,) in [-1, 1].
        lr_schedule: The learning rate.
        chunk_size: H.
        ensemble_decay: See `blend`.
        ignored: What the network does not read: columns of a Box, entries of a Dict.
        net_arch: Widths of the layers between the features and the actions.
        activation_fn: Class of the activation between layers.
        features_extractor_class: Class of the features extractor.
        features_extractor_kwargs: Its arguments.
        normalize_images: Whether pixels are divided by 255.
        optimizer_class: Class of the optimizer.
        optimizer_kwargs: Its arguments, without the learning rate.
    """

    default_extractor: type[BaseFeaturesExtractor] = FlattenExtractor

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Box,
        lr_schedule: Schedule,
        *,
        chunk_size: int = 16,
        ensemble_decay: float = 0.1,
        ignored: Sequence[int | str] = (),
        net_arch: list[int] | None = None,
        activation_fn: type[torch.nn.Module] = torch.nn.ReLU,
        features_extractor_class: type[BaseFeaturesExtractor] | None = None,
        features_extractor_kwargs: dict[str, Any] | None = None,
        normalize_images: bool = True,
        optimizer_class: type[torch.optim.Optimizer] = torch.optim.Adam,
        optimizer_kwargs: dict[str, Any] | None = None,
    ) -> None:
        super().__init__(
            observation_space,
            action_space,
            features_extractor_class or self.default_extractor,
            features_extractor_kwargs,
            normalize_images=normalize_images,
            optimizer_class=optimizer_class,
            optimizer_kwargs=optimizer_kwargs,
        )
        self.chunk_size = chunk_size
        self.ensemble_decay = ensemble_decay
        # Entries of a Dict, or columns of a Box; without any, all of the observation is read.
        self._read: list[Any] = []
        read_space = observation_space
        if isinstance(observation_space, spaces.Dict):
            self._read = [key for key in observation_space if key not in ignored]
            read_space = spaces.Dict({key: observation_space[key] for key in self._read})
        elif ignored and isinstance(observation_space, spaces.Box):
            self._read = [i for i in range(observation_space.shape[0]) if i not in ignored]
            low = observation_space.low[self._read]
            high = observation_space.high[self._read]
            read_space = spaces.Box(low, high, dtype=np.float32)
        self._read_space = read_space
        self.features_extractor = self.features_extractor_class(
            read_space, **self.features_extractor_kwargs
        )
        layers = create_mlp(
            input_dim=self.features_extractor.features_dim,
            output_dim=chunk_size * int(action_space.shape[0]),
            net_arch=[256, 256] if net_arch is None else net_arch,
            activation_fn=activation_fn,
        )
        self.network = torch.nn.Sequential(*layers)
        arguments: Any = {"lr": lr_schedule(1), **self.optimizer_kwargs}
        self.optimizer = optimizer_class(self.parameters(), **arguments)

    @property
    def has_memory(self) -> bool:
        """Whether an action depends on observations before the last one."""
        return self.chunk_size > 1

    def chunks(self, observation: PyTorchObs) -> torch.Tensor:
        """Return (B, H, A) actions for B observations, not clipped."""
        read: Any = observation
        if isinstance(observation, dict):
            read = {key: observation[key] for key in self._read}
        elif self._read:
            read = observation[:, self._read]
        scaled = preprocess_obs(read, self._read_space, normalize_images=self.normalize_images)
        features = self.features_extractor(scaled)
        return self.network(features).unflatten(1, (self.chunk_size, -1))

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> torch.Tensor:
        """Return (B, A) actions for the current step from this observation alone."""
        return self.chunks(observation)[:, 0]

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[Any], tuple[NDArray[Any], ...] | None]:
        """Return the actions of the current step and the memory.

        Args:
            observation: As for other policies: of one environment, or (N, ...).
            state: The memory that the last call returned; None forgets everything.
            episode_start: (N,) whether an episode begins.
            deterministic: Without effect: it always is.

        Returns:
            (N, A) or (A,) in [-1, 1], and the memory; None if the policy has none.
        """
        if not self.has_memory:
            return super().predict(observation, state, episode_start, deterministic)
        memory: Any = state
        chunks = self.plan(observation)
        actions, memory = blend(chunks, memory, episode_start, self.ensemble_decay)
        if not self.is_vectorized_observation(observation):
            return actions[0], memory
        return actions, memory

    def plan(self, observation: Any) -> NDArray[np.float32]:
        """Return (N, H, A) actions in [-1, 1] for this step and the next ones."""
        self.set_training_mode(False)
        batch, _ = self.obs_to_tensor(observation)
        with torch.no_grad():
            return self.chunks(batch).clamp(-1.0, 1.0).cpu().numpy()


class CnnChunkPolicy(ChunkPolicy):
    """`ChunkPolicy` for one image."""

    default_extractor = NatureCNN


class MultiInputChunkPolicy(ChunkPolicy):
    """`ChunkPolicy` for a dict of images and vectors."""

    default_extractor = SmallCnn
