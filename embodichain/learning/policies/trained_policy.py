"""`TrainedPolicy`: a policy from a file, which checks that it fits its environment."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.learning.checkpoints.task_digest import (
    Change,
    TaskDigest,
    check_unchanged,
    name_other_columns,
)
from embodichain.learning.spaces import flat_observation, observation_columns
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.short_repr import short_repr

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.types import EnvObs
    from embodichain.utils.array_types import EnvIds

__all__ = ["TrainedPolicy", "check_columns"]

F32 = NDArray[np.float32]


class TrainedPolicy(ABC):
    """A function of flat observations that acts in batched environments.

    Args:
        name: Its name in messages.
        group: The observation group it was trained on.
        trained_in: The digest of its task in training; None if unknown.

    Attributes:
        allow_changed: Whether to accept a task that has changed since training.
        changed: Differences between the task last checked and that of training.
        stage: The stage of the curriculum in training (`BaseEnv.curriculum_stage`), if known.
    """

    def __init__(self, name: str, group: str, trained_in: TaskDigest | None = None) -> None:
        self.name = name
        self.group = group
        self.trained_in = trained_in
        self.allow_changed = False
        self.changed: tuple[Change, ...] = ()
        self.stage: dict[str, Any] | None = None
        self._env: BaseEnv | None = None

    def __repr__(self) -> str:
        """Return class, name and observation group, in one line."""
        return short_repr(self, self.name, group=self.group)

    def check(self, env: BaseEnv) -> None:
        """Check that the policy fits an environment.

        Raises:
            ConfigError: If its observations or actions differ from the task's, or the task changed
                since training and `allow_changed` is not set.
        """
        try:
            self._fit(env)
        except ConfigError as error:
            names = name_other_columns(self.trained_in, env, self.group)
            if not names:
                raise
            raise ConfigError(
                [
                    replace(problem, message=f"{problem.message} ({names})")
                    for problem in error.problems
                ]
            ) from error
        self.changed = check_unchanged(
            self.name, self.trained_in, env, self.group, allow=self.allow_changed
        )
        self._env = env

    def __call__(self, obs: EnvObs, env: BaseEnv) -> torch.Tensor:
        """Return (N, A) float32 actions for an observation.

        Raises:
            ConfigError: At the first call in an environment, if the policy does not fit it.
        """
        if env is not self._env:
            self.check(env)
        actions = self.act(self.observed(obs, env))
        return torch.from_numpy(np.array(actions, np.float32)).to(env.device)

    def observed(self, obs: EnvObs, env: BaseEnv) -> Any:
        """Return the policy's part of an observation: by default (N, K) float32."""
        return flat_observation(env, obs, self.group)

    @abstractmethod
    def act(self, obs: Any) -> F32:
        """Return (N, A) actions for observations (N, ...), both in the task's units."""

    @abstractmethod
    def _fit(self, env: BaseEnv) -> None:
        """Check that observations and actions have the widths of those of an environment."""

    @abstractmethod
    def reset(self, env_ids: EnvIds | None) -> None:
        """Reset the policy's state for these environments; None is all."""


def check_columns(name: str, columns: Sequence[str], env: BaseEnv, group: str) -> None:
    """Check that the observation columns of an environment are those of a policy's training.

    Args:
        name: The policy's name in messages.
        columns: Observation columns in training.
        env: The environment that it will act in.
        group: The observation group.

    Raises:
        ConfigError: If the columns differ; names the first difference.
    """
    task_columns = observation_columns(env, group)
    pairs = itertools.zip_longest(columns, task_columns, fillvalue="nothing")
    for i, (column, task_column) in enumerate(pairs):
        if column != task_column:
            message = (
                f"{name} was made for other observations: column {i} of {len(columns)} was "
                f"{column}, this task has {task_column} ({len(task_columns)} columns)"
            )
            raise ConfigError([Problem("policy", message)])
