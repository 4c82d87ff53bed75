"""`NumpyVectorEnv`: an environment as Gymnasium's numpy `VectorEnv`, for its vector wrappers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.closed import require_open
from embodichain.lab.gym.envs.describing import describe, warn_undrawn
from embodichain.lab.gym.envs.managers.value_managers import TermRows
from embodichain.lab.gym.envs.observation import numpy_obs
from embodichain.lab.gym.envs.step.episodes import parse_mode
from embodichain.lab.gym.policy_view import PolicyView
from embodichain.lab.sim.types import EnvObs

__all__ = ["NumpyVectorEnv"]

_FINAL = ("final_obs", "final_observation", "final_info", "_final_obs", "_final_info")


class NumpyVectorEnv(VectorEnv[Any, NDArray[np.floating[Any]], NDArray[Any]]):
    """N environments with numpy observations, rewards and flags.

    Modes for Gymnasium's wrappers: RecordEpisodeStatistics, NormalizeReward, TransformReward and
    DictInfoToList take any; NormalizeObservation needs NEXT_STEP and `flatten`, FlattenObservation
    NEXT_STEP or DISABLED; RecordVideo omits the last image of an episode with SAME_STEP.

    Args:
        env: The environment; `close` closes it.
        autoreset_mode: NEXT_STEP, which is the mode of Gymnasium's own vector environments,
            SAME_STEP or DISABLED; replaces the environment's mode.
        flatten: Whether observations are those of a policy (`PolicyView`: a vector, or a dict
            with images) instead of all entries in nested dicts.

    Raises:
        ValueError: If there is no such mode; lists them.
    """

    def __init__(
        self,
        env: BaseEnv,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        flatten: bool = True,
    ) -> None:
        env.arrays.require_host("results that are arrays of numpy")
        self.env = env
        env.metadata["autoreset_mode"] = parse_mode(autoreset_mode)
        self.metadata = env.metadata
        self.render_mode = env.render_mode
        self.num_envs = env.num_envs
        self.single_action_space = env.single_action_space
        self.action_space = env.action_space
        view = PolicyView(env) if flatten else None
        self.single_observation_space = env.single_observation_space if view is None else view.space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._numpy: Callable[[EnvObs], Any] = numpy_obs if view is None else view

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start new episodes; see `BaseEnv.reset`.

        Args:
            seed: One integer, from which each environment derives its own streams.
            options: ``reset_mask`` (N,) bool selects environments; all others are passed on.

        Raises:
            ValueError: If the seed is a list, or the mask has the wrong shape or type.
        """
        super().reset(seed=None)
        if options is not None and "reset_mask" in options:
            mask = options["reset_mask"]
            if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or not mask.any():
                raise ValueError("reset_mask must be a numpy array of booleans, one of them True")
        obs, info = self.env.reset(seed=seed, options=options)
        if seed is not None:
            self._np_random, self._np_random_seed = self.env.np_random, seed
        return self._numpy(obs), self._infos(info)

    def step(
        self, actions: NDArray[np.floating[Any]]
    ) -> tuple[Any, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Advance all environments by one control step; see `BaseEnv.step`.

        Args:
            actions: (N, A) finite floating point numbers.
        """
        action: Any = np.asarray(actions)
        if self.env.steps_in_arrays:
            result = self.env.step_arrays(action)
            infos = self._infos(result.entries())
            if result.final_obs is not None and result.done is not None:
                self._add_finals(infos, result.final_obs, dict(infos), result.done)
            obs = self._numpy(result.obs)
            return obs, result.reward, result.terminated, result.truncated, infos
        obs, reward, terminated, truncated, info = self.env.step(action)
        return (
            self._numpy(obs),
            reward.numpy(),
            terminated.numpy(),
            truncated.numpy(),
            self._infos(info),
        )

    def _infos(self, info: Mapping[str, Any]) -> dict[str, Any]:
        """Info with an array (N, ...) for each entry."""
        arrays = {key: self._array(value) for key, value in info.items() if key not in _FINAL}
        if "final_obs" in info:
            done = info["_final_obs"].numpy()
            final_info = self._infos(info["final_info"])
            self._add_finals(arrays, info["final_obs"], final_info, done)
        return arrays

    def _add_finals(
        self, infos: dict[str, Any], obs: EnvObs, info: dict[str, Any], done: NDArray[np.bool_]
    ) -> None:
        """Add the final observation and info of environments that are done."""
        infos["final_obs"] = self._final_obs(obs, done)
        infos["final_info"] = info
        infos["_final_obs"] = done
        infos["_final_info"] = done.copy()

    def _final_obs(self, obs: EnvObs, done: NDArray[np.bool_]) -> NDArray[np.object_]:
        """One observation per environment, None where it is not final (Gymnasium's convention)."""
        rows = self._numpy(obs)
        final = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(done):  # only environments that are done
            final[i] = _row(rows, int(i))
        return final

    def _array(self, value: Any) -> Any:
        """Copies of rows, nested dicts of them, or anything else once for each environment."""
        if isinstance(value, TermRows):
            return {name: row.copy() for name, row in value.arrays()}
        if isinstance(value, Mapping):
            return {key: self._array(v) for key, v in value.items()}
        if isinstance(value, torch.Tensor):
            return self._array(value.cpu().numpy())
        if isinstance(value, np.ndarray) and value.shape[:1] == (self.num_envs,):
            return value.copy()
        return np.full(self.num_envs, value, dtype=object)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One image per environment, (480, 640, 3) RGB; None, with a warning, without a mode."""
        if self.render_mode != "rgb_array":
            warn_undrawn(self.env.task_name)
            return None
        require_open(self.env.is_closed)
        return tuple(self.env.sim.render(None))

    def close_extras(self, **kwargs: Any) -> None:
        """Close the environment."""
        self.env.close()

    def __repr__(self) -> str:
        """Return task, size, mode and spaces in one line."""
        mode: AutoresetMode = self.metadata["autoreset_mode"]
        return describe(
            type(self).__name__,
            self.env.task_name or type(self.env).__name__,
            f"num_envs={self.num_envs}",
            f"autoreset_mode={mode.name}",
            action=self.single_action_space,
            observation=self.single_observation_space,
        )

    __str__ = __repr__


def _row(value: Any, index: int) -> Any:
    """A copy of one row of an array, or of all arrays in nested dicts."""
    if isinstance(value, dict):
        return {key: _row(v, index) for key, v in value.items()}
    return value[index].copy()
