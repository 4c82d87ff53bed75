"""Spaces for learners: observations as a flat vector or by name, actions in [-1, 1]."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from embodichain.lab.gym.envs.managers.observation_manager import no_vector
from embodichain.lab.gym.envs.observation import entry_spaces, named_obs
from embodichain.lab.gym.single import SingleEnv
from embodichain.lab.gym.vector import NumpyVectorEnv
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = [
    "UNBOUNDED",
    "ActionScale",
    "LearnerView",
    "flat_observation",
    "observation_box",
    "observation_columns",
    "observation_dict",
    "require_bounds",
    "require_torch_batch",
]

F32 = NDArray[np.float32]
UNBOUNDED = 1e6
"""Bound that a learner's Box has where the task's action has none."""


class ActionScale:
    """Maps actions linearly from [-1, 1] to the bounds of an action space.

    Learners need bounds that are finite, symmetric and of the size of their noise. -1 maps exactly
    to `low` and 1 exactly to `high`. If the bounds are [-1, 1] already, nothing is computed.
    Columns without bounds stay as they are; `require_bounds` refuses them.

    Args:
        space: Action space of one environment.

    Attributes:
        space: The learner's Box, (A,) in [-1, 1]; +-`UNBOUNDED` in columns without bounds, because
            Stable-Baselines3 takes finite numbers only.
        unbounded: (A,) columns without bounds.

    Raises:
        ConfigError: If the space is not a Box (A,), or is empty, or a column has one bound.
    """

    def __init__(self, space: Any) -> None:
        if not isinstance(space, spaces.Box) or len(space.shape) != 1:
            raise ConfigError(f"learning needs a Box (A,) as action space, got {space}")
        if not space.shape[0]:
            raise ConfigError(
                "learning needs actions: nothing in this task is driven; give it an action term, "
                "or a robot that has actuators or drives (drive_pros)"
            )
        self._low = np.asarray(space.low, np.float32)
        self._high = np.asarray(space.high, np.float32)
        self.unbounded: NDArray[np.bool_] = np.isneginf(self._low) & np.isposinf(self._high)
        finite = np.isfinite(self._low) & np.isfinite(self._high)
        if not (finite | self.unbounded).all():
            columns = np.flatnonzero(~(finite | self.unbounded)).tolist()
            raise ConfigError(f"learning needs finite action bounds; columns {columns} have none")
        # Without bounds as with [-1, 1]: the action itself.
        self._low = np.where(self.unbounded, np.float32(-1), self._low)
        self._high = np.where(self.unbounded, np.float32(1), self._high)
        self._is_bounded = not self.unbounded.any()
        self._identity = bool((self._low == -1).all() and (self._high == 1).all())
        bound = np.where(self.unbounded, np.float32(UNBOUNDED), np.float32(1))
        self.space = spaces.Box(-bound, bound, dtype=np.float32)

    def __call__(self, actions: ArrayLike) -> F32:
        """Return (N, A) actions of the environment, as a new array.

        Args:
            actions: (N, A), in [-1, 1]; values outside are scaled, not clipped.

        Raises:
            ValueError: If the shape is wrong.
        """
        scaled = np.array(actions, np.float32)
        if scaled.ndim != 2 or scaled.shape[1:] != self._low.shape:
            raise ValueError(f"actions must have shape (N, {len(self._low)}), got {scaled.shape}")
        if self._identity:
            return scaled
        # low + (a + 1) * (high - low) / 2 would miss `high` by a rounding error.
        half = np.float32(0.5)
        bounded = half * ((1 - scaled) * self._low + (1 + scaled) * self._high)
        if self._is_bounded:
            return bounded
        return np.where(self.unbounded, scaled, bounded)

    def inverse(self, actions: ArrayLike) -> F32:
        """Return (N, A) learner's actions of actions of the environment, clipped to its space.

        Raises:
            ValueError: If the shape is wrong.
        """
        scaled: NDArray[Any] = np.array(actions, np.float32)
        if scaled.ndim != 2 or scaled.shape[1:] != self._low.shape:
            raise ValueError(f"actions {scaled.shape[1:]} instead of {self._low.shape}")
        if not self._identity:
            width = self._high - self._low
            scaled = (2 * scaled - (self._low + self._high)) / np.where(width > 0, width, 1)
        return np.clip(scaled, self.space.low, self.space.high)


def require_bounds(env: BaseEnv, learner: str) -> None:
    """Check that every column of the actions has bounds.

    Args:
        env: The environment.
        learner: The name of what needs them, for the message.

    Raises:
        ConfigError: If a column has none; names the keys to write.
    """
    unbounded = ActionScale(env.single_action_space).unbounded
    if not unbounded.any():
        return
    terms = [
        name for name, columns in env.action_manager.slices.items() if unbounded[columns].any()
    ]
    keys = ", ".join(f"task.actions.{name}.params: {{clip: [-1, 1]}}" for name in terms)
    message = f"{learner} needs bounds of the actions, and there are none (bounds: null)"
    hint = f"Write {keys or 'an action space with bounds'} instead, or take algo=ppo"
    raise ConfigError([Problem("algo.name", message, hint)])


def observation_box(env: BaseEnv, group: str) -> spaces.Box:
    """Return the space of one environment's flat observation: (K,), unbounded.

    Raises:
        ConfigError: If no observation is in the group (lists the groups), or one is an image.
    """
    entries = observation_dict(env, group)
    images = env.observation_manager.image_terms(group)
    if images:
        raise ConfigError(no_vector(group, images))
    width = sum(math.prod(space.shape or ()) for space in entries.values())
    return spaces.Box(-np.inf, np.inf, (width,), np.float32)


def observation_dict(env: BaseEnv, *groups: str) -> spaces.Dict:
    """Return the spaces of one environment's observations in some groups, by name.

    Raises:
        ConfigError: If no observation is in a group; lists the groups.
    """
    try:
        names = [name for group in groups for name in env.observation_manager.group_terms(group)]
    except ValueError as error:
        raise ConfigError(str(error)) from error
    return entry_spaces(env.single_observation_space, names)


class LearnerView:
    """The observation that a learner receives: a vector, an image, or a dict.

    Args:
        env: The environment.
        group: The observation group.
        flatten: Whether it is one array: the flat vector of the group, or its only entry if that
            is an image.
        others: Further groups, whose entries are in the dict.

    Attributes:
        space: Space of one environment.

    Raises:
        ConfigError: If no observation is in a group, or `flatten` is set and the group has images
            and further entries (names the terms) or there are other groups.
    """

    def __init__(
        self, env: BaseEnv, group: str, flatten: bool = True, others: Sequence[str] = ()
    ) -> None:
        self._env = env
        self._group = group
        entries = observation_dict(env, group, *others)
        if flatten and others:
            raise ConfigError("the observation of several groups is a dict: use flatten=False")
        # The spaces by entry; None if the observation is the flat vector.
        self._entries: spaces.Dict | None = entries
        # The entry that is the observation, if it is one image; else "".
        self._image = ""
        self.space: spaces.Space[Any] = entries
        if flatten and len(entries) == 1 and env.observation_manager.image_terms(group):
            self._image = next(iter(entries))
            self.space = entries[self._image]
        elif flatten:
            self._entries = None
            self.space = observation_box(env, group)

    def __call__(self, obs: Any) -> NDArray[Any] | dict[str, NDArray[Any]]:
        """Return new arrays (N, ...) of an observation of the environment."""
        if self._entries is None:
            return flat_observation(self._env, obs, self._group)
        arrays = named_obs(obs, self._entries)
        if self._image:
            return arrays[self._image]
        return arrays

    def tensors(self, obs: Any) -> dict[Any, torch.Tensor]:
        """Return the entries of an observation by name, (N, ...); the name of a vector is "".

        They may share memory with the observation.
        """
        if self._entries is None:
            return {"": self._env.observation_manager.flatten(obs, self._group)}
        return {name: obs[tuple(name.split("/"))] for name in self._entries}

    def named(self, arrays: Mapping[Any, Any]) -> NDArray[Any] | dict[str, NDArray[Any]]:
        """Return the observation of entries as `tensors` names them."""
        if self._entries is None or self._image:
            return arrays[self._image]
        return {name: arrays[name] for name in self._entries}

    def recorded(self, entries: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return recorded observations as the learner would have received them.

        Args:
            entries: Name of an entry of the environment's observation -> (T, ...).

        Returns:
            Name -> (T, ...); the name of an observation that is one array is "".

        Raises:
            ValueError: If an entry is missing or has another shape.
        """
        arrays: dict[str, NDArray[Any]] = {}
        needed_spaces = self._entries or observation_dict(self._env, self._group)
        for name, space in needed_spaces.items():
            if name not in entries:
                raise ValueError(f"no observation {name!r}, there are: {', '.join(entries)}")
            array = entries[name]
            if array.shape[1:] != space.shape:
                raise ValueError(
                    f"observation {name!r} is {array.shape[1:]} instead of {space.shape}"
                )
            if space.dtype is not None:
                array = array.astype(space.dtype, copy=False)
            arrays[name] = array
        if self._image:
            return {"": arrays[self._image]}
        if self._entries is not None:
            return arrays
        ordered_names = self._env.observation_manager.group_terms(self._group)
        rows = [arrays[name].reshape(len(arrays[name]), -1) for name in ordered_names]
        return {"": np.concatenate(rows, axis=1, dtype=np.float32)}


def observation_columns(env: BaseEnv, group: str) -> tuple[str, ...]:
    """Return a name for each column of a group's flat vector: ``robot/qpos[0]``.

    Raises:
        ValueError: If no observation is in the group.
    """
    columns: list[str] = []
    for name in env.observation_manager.group_terms(group):
        space: Any = env.single_observation_space
        for key in name.split("/"):
            space = space[key]
        for index in itertools.product(*map(range, space.shape)):
            columns.append(f"{name}[{','.join(map(str, index))}]" if index else name)
    return tuple(columns)


def flat_observation(env: BaseEnv, obs: Any, group: str) -> F32:
    """Return a group of an observation as a new (N, K) array, one flat vector per environment."""
    return env.arrays.host(env.observation_manager.flat_rows(obs, group))


def require_torch_batch(env: gym.Env[Any, Any], caller: str) -> None:
    """Check that an environment is a batch with torch tensors that resets in the same step.

    Args:
        env: An environment, wrapped or not.
        caller: The caller's name, for the message.

    Raises:
        TypeError: If it is one of `gymnasium.make` or `gymnasium.make_vec` with numpy arrays.
        ValueError: If its autoreset mode is not SAME_STEP.
    """
    if isinstance(env.unwrapped, (NumpyVectorEnv, SingleEnv)):
        raise TypeError(
            f"{caller} takes the batch of tensors, embodichain.make(NAME, num_envs=N), not {env}"
        )
    mode = env.metadata.get("autoreset_mode")
    if mode is not AutoresetMode.SAME_STEP:
        raise ValueError(f"{caller} needs autoreset_mode SAME_STEP, got an environment with {mode}")
