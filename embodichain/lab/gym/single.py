"""`SingleEnv`: a batch of one as a Gymnasium `Env`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.describing import describe, warn_undrawn
from embodichain.lab.gym.envs.managers.value_managers import TermRows
from embodichain.lab.gym.envs.observation import as_array, numpy_obs
from embodichain.lab.gym.envs.step.episodes import AutoresetMode
from embodichain.lab.gym.policy_view import PolicyView
from embodichain.lab.sim.types import EnvObs

__all__ = ["SingleEnv"]


class SingleEnv(gym.Env[Any, NDArray[np.float32]]):
    """One environment without the batch dimension and without autoreset.

    Args:
        env: An environment with ``num_envs`` 1; `close` closes it.
        flatten: Whether the observation is that of a policy (`PolicyView`: a vector, or a dict
            with images) instead of all entries in nested dicts.

    Raises:
        ValueError: If there is more than one environment.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"]}

    def __init__(self, env: BaseEnv, flatten: bool = True) -> None:
        if env.num_envs != 1:
            raise ValueError(
                f"SingleEnv shows one environment, this batch has {env.num_envs}: "
                "NumpyVectorEnv shows a batch in numpy, SB3VecEnv to Stable-Baselines3"
            )
        env.arrays.require_host("results that are arrays of numpy")
        env.metadata["autoreset_mode"] = AutoresetMode.DISABLED
        self.env = env
        self.metadata = {k: v for k, v in env.metadata.items() if k != "autoreset_mode"}
        self.render_mode = env.render_mode
        self.action_space = env.single_action_space
        view = PolicyView(env) if flatten else None
        self.observation_space = env.single_observation_space if view is None else view.space
        self._to_numpy = numpy_obs if view is None else view

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start a new episode; see `BaseEnv.reset`."""
        super().reset(seed=seed)
        obs, info = self.env.reset(seed=seed, options=options)
        return self._first(obs), _first_info(info)

    def step(self, action: NDArray[np.float32]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advance by one control step; see `BaseEnv.step`.

        Of a task with success, info has ``is_success`` too: ``success`` by the name that
        Stable-Baselines3 and Gymnasium-Robotics read.

        Args:
            action: (A,) finite numbers.
        """
        batched: Any = np.asarray(action, np.float32)[None]
        if self.env.steps_in_arrays:
            result = self.env.step_arrays(batched)
            obs: EnvObs = result.obs
            reward: Any = result.reward
            terminated: Any = result.terminated
            truncated: Any = result.truncated
            single_info = _first_info(result.entries())
        else:
            obs, reward, terminated, truncated, info = self.env.step(batched)
            single_info = _first_info(info)
        if self.env.judges_success:
            single_info["is_success"] = single_info["success"]
        return (
            self._first(obs),
            float(reward[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            single_info,
        )

    def _first(self, obs: EnvObs) -> Any:
        """The observation of the environment, without the batch dimension."""
        return _first_row(self._to_numpy(obs))

    def render(self) -> NDArray[np.uint8] | None:
        """(480, 640, 3) RGB; None, with a warning, without a render mode."""
        if self.render_mode != "rgb_array":
            warn_undrawn(self.env.task_name)
            return None
        return self.env.render()

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def __repr__(self) -> str:
        """Return task and spaces in one line."""
        return describe(
            type(self).__name__,
            self.env.task_name or type(self.env).__name__,
            action=self.action_space,
            observation=self.observation_space,
        )


def _first_row(value: Any) -> Any:
    """The first row of an array, or of all arrays in nested dicts."""
    if isinstance(value, dict):
        return {key: _first_row(item) for key, item in value.items()}
    return value[0]


def _first_info(info: Mapping[str, Any]) -> dict[str, Any]:
    """The entries of the environment; scalars become Python scalars."""
    first: dict[str, Any] = {}
    for key, value in info.items():
        if isinstance(value, TermRows):
            first[key] = {name: row[0].item() for name, row in value.arrays()}
        elif isinstance(value, Mapping):
            first[key] = _first_info(value)
        elif isinstance(value, (torch.Tensor, np.ndarray)) and value.shape[:1] == (1,):
            first[key] = value[0].item() if value.ndim == 1 else as_array(value[0])
        else:
            first[key] = value
    return first
