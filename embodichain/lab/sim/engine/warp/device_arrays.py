"""`DeviceArrays`: `Arrays` on a device."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.engine.device.device_array import DeviceArray, EnvMask, constant, on_device
from embodichain.lab.sim.engine.device.device_values import torch_type
from embodichain.utils.arrays import Arrays
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.random import RandomStreams

__all__ = ["DeviceArrays"]

_ON_DEVICE = "on_device"
"""Key of an array of the device in a saved state."""


class DeviceArrays(Arrays):
    """Arrays on a device.

    Args:
        device: The device of torch's tensors.
    """

    on_device = True

    def __init__(self, device: str) -> None:
        if device == "cuda":
            device = f"cuda:{torch.cuda.current_device()}"
        self.device = torch.device(device)

    def full(self, shape: int | Sequence[int], value: Any, dtype: Any = np.float64) -> Any:
        lengths = (shape,) if isinstance(shape, int) else tuple(shape)
        return DeviceArray(torch.full(lengths, value, dtype=torch_type(dtype), device=self.device))

    def put(self, array: Any) -> Any:
        return on_device(array, self.device)

    def constant(self, array: NDArray[Any]) -> Any:
        return constant(array, self.device)

    def host(self, array: Any) -> NDArray[Any]:
        return array.host() if isinstance(array, DeviceArray) else array

    def of(self, values: Any) -> Any:
        if isinstance(values, torch.Tensor):
            return DeviceArray(values.detach())
        if isinstance(values, DeviceArray):
            return values
        return on_device(values, self.device)

    def where(self, mask: Any) -> Any:
        return EnvMask(mask.tensor)

    def every(self, count: int) -> Any:
        return EnvMask(torch.ones(count, dtype=torch.bool, device=self.device), everything=True)

    def environments(self, ids: NDArray[np.int64], count: int) -> Any:
        mask = np.zeros(count, np.bool_)
        mask[ids] = True
        return EnvMask(torch.from_numpy(mask).to(self.device), everything=len(ids) == count)

    def are_all(self, ids: Any, count: int) -> bool:
        return ids.everything

    def streams(self, seed: int, count: int, first: int = 0) -> RandomStreams:
        from embodichain.lab.sim.engine.warp.device_streams import DeviceStreams

        return cast("RandomStreams", DeviceStreams(seed, count, str(self.device), first))

    def require_host(self, what: str, path: str = "") -> None:
        message = f"{what} are not available with arrays on a device: use sim.warp.arrays=host"
        raise ConfigError([Problem(path, message)])

    def saved(self, state: Any) -> Any:
        if isinstance(state, DeviceArray):
            return {_ON_DEVICE: state.host()}
        if isinstance(state, Mapping):
            return {key: self.saved(part) for key, part in state.items()}
        if type(state) in (list, tuple):
            return type(state)(map(self.saved, state))
        return state

    def loaded(self, state: Any) -> Any:
        if isinstance(state, Mapping):
            if state.keys() == {_ON_DEVICE}:
                return DeviceArray(torch.from_numpy(state[_ON_DEVICE].copy()).to(self.device))
            return {key: self.loaded(part) for key, part in state.items()}
        if type(state) in (list, tuple):
            return type(state)(map(self.loaded, state))
        return state
