"""`ActionCheck`: what `BaseEnv.step` accepts, checked before anything is written."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import torch
from tensordict import TensorDict

from embodichain.lab.sim.objects._arrays import all_finite

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.base import F64
    from embodichain.lab.sim.types import EnvAction

__all__ = ["ActionCheck"]


class ActionCheck:
    """Checks actions against a space.

    Args:
        space: Action space of one environment; shapes are checked if it is a Box.
        num_envs: N.
        device: Where actions must live.
    """

    def __init__(self, space: gym.Space[Any], num_envs: int, device: torch.device) -> None:
        box = isinstance(space, gym.spaces.Box)
        self._shape = torch.Size((num_envs, *space.shape)) if box else None  # type: ignore[misc]
        self._num_envs = num_envs
        self._device = device
        self._on_cpu = device.type == "cpu"

    def __call__(self, action: Any) -> tuple[EnvAction, F64]:
        """Check an action.

        Args:
            action: (N, A) floating tensor on the device, or a numpy array (converted to a float32
                tensor), or a TensorDict of such tensors with batch size N.

        Returns:
            The action, and its numbers as (N, A) float64 that share nothing with it.

        Raises:
            TypeError: If it is no floating tensor, array or TensorDict.
            ValueError: If its shape or device is wrong or a number is not finite.
        """
        # The usual case first, asking torch nothing but for the numbers.
        plain = type(action) is torch.Tensor and self._on_cpu and action.is_cpu
        if plain and not action.requires_grad:
            numbers = action.numpy()
            fits = numbers.ndim == 2 and numbers.shape == self._shape
            if fits and numbers.dtype.kind == "f":
                return action, self._finite(numbers.astype(np.float64))
        if not isinstance(action, torch.Tensor):
            if isinstance(action, TensorDict):
                return action, self._finite(self._flatten(action))
            action = self._tensor(action)
        if action.shape != self._shape and (
            self._shape is not None or action.shape[:1] != (self._num_envs,)
        ):
            raise ValueError(f"action must have shape {self._wanted()}, got {tuple(action.shape)}")
        if not action.dtype.is_floating_point:
            raise TypeError(
                f"an action is a floating point tensor {self._wanted()}, got {action.dtype}"
            )
        if action.device != self._device:
            raise ValueError(f"action is on {action.device}; this environment is on {self._device}")
        if action.requires_grad:
            action = action.detach()
        given = action.numpy().astype(np.float64)
        return action, self._finite(given if given.ndim == 2 else given.reshape(len(given), -1))

    def _tensor(self, action: Any) -> torch.Tensor:
        if not isinstance(action, np.ndarray):
            raise TypeError(f"an action is a tensor {self._wanted()}, got {type(action).__name__}")
        if not np.issubdtype(action.dtype, np.floating):
            raise TypeError(f"actions are floating point numbers, got {action.dtype}")
        return torch.from_numpy(action.astype(np.float32))

    def _wanted(self) -> str:
        return f"({self._num_envs}, ...)" if self._shape is None else f"{tuple(self._shape)}"

    def _flatten(self, action: TensorDict) -> F64:
        if action.batch_size[:1] != (self._num_envs,):
            raise ValueError(
                f"action must have batch size ({self._num_envs},), got {tuple(action.batch_size)}"
            )
        leaves: list[Any] = [leaf for _, leaf in action.items(True, True)]
        if not leaves:
            raise ValueError("the action is an empty TensorDict")
        rows = [leaf.detach().cpu().reshape(self._num_envs, -1) for leaf in leaves]
        return torch.cat(rows, dim=1).numpy().astype(np.float64)

    @staticmethod
    def _finite(values: F64) -> F64:
        if not all_finite(values):
            rows = np.flatnonzero(~np.isfinite(values).all(axis=1))
            raise ValueError(f"action is not finite in environments {rows[:8].tolist()}")
        return values
