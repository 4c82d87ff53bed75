"""`Arrays`: where the arrays of a simulation are, and how they are made: host or device.

Code that keeps an array between steps makes it here, so that the same code runs with numpy's arrays
on the host and with `DeviceArray` on a device.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.engine.device_array import DeviceArray, EnvMask, on_device
from embodichain.lab.sim.engine.device_values import torch_type
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.random import RandomStreams

__all__ = ["Arrays", "DeviceArrays"]


class Arrays:
    """Arrays of numpy, on the host.

    Attributes:
        device: Device of the tensors.
        on_device: Whether arrays are `DeviceArray`, and environments `EnvMask`.
    """

    on_device = False

    def __init__(self) -> None:
        self.device = torch.device("cpu")

    def full(self, shape: int | Sequence[int], value: Any, dtype: Any = np.float64) -> Any:
        """Make an array with one value everywhere."""
        return np.full(shape, value, dtype)

    def put(self, array: Any) -> Any:
        """Return a copy of an array of the host."""
        return np.array(array)

    def host(self, array: Any) -> NDArray[Any]:
        """Return an array on the host; from a device it is a copy, which waits for the device."""
        found: NDArray[Any] = array
        return found

    def of(self, values: Any) -> Any:
        """Return an array that shares memory with a tensor or an array, if its type allows."""
        if isinstance(values, np.ndarray):
            return values
        return values.numpy(force=True) if isinstance(values, torch.Tensor) else np.asarray(values)

    def where(self, mask: Any) -> Any:
        """Return the environments where a mask (N,) is set: sorted indices."""
        return np.flatnonzero(mask)

    def every(self, count: int) -> Any:
        """Return all environments, of `count`."""
        return np.arange(count)

    def environments(self, ids: NDArray[np.int64], count: int) -> Any:
        """Return environments, of `count`, from their sorted indices."""
        return ids

    def are_all(self, ids: Any, count: int) -> bool:
        """Whether environments are known to be all, of `count`."""
        return len(ids) == count

    def streams(self, seed: int, count: int) -> RandomStreams:
        """Make random streams whose draws are arrays of this kind."""
        return RandomStreams(seed, count)

    def require_host(self, what: str, path: str = "") -> None:
        """Refuse something that has no form with arrays on a device.

        Args:
            what: What needs arrays on the host.
            path: Key path of the parameter that asks for it, for the message.

        Raises:
            ConfigError: If arrays are on a device.
        """


class DeviceArrays(Arrays):
    """Arrays on a device.

    Args:
        device: The device of torch's tensors.
    """

    on_device = True

    def __init__(self, device: str) -> None:
        current = f"cuda:{torch.cuda.current_device()}" if device == "cuda" else device
        self.device = torch.device(current)

    def full(self, shape: int | Sequence[int], value: Any, dtype: Any = np.float64) -> Any:
        lengths = (shape,) if isinstance(shape, int) else tuple(shape)
        return DeviceArray(torch.full(lengths, value, dtype=torch_type(dtype), device=self.device))

    def put(self, array: Any) -> Any:
        return on_device(array, self.device)

    def host(self, array: Any) -> NDArray[Any]:
        found: NDArray[Any] = array.host() if isinstance(array, DeviceArray) else array
        return found

    def of(self, values: Any) -> Any:
        if isinstance(values, torch.Tensor):
            return DeviceArray(values.detach())
        return values if isinstance(values, DeviceArray) else on_device(values, self.device)

    def where(self, mask: Any) -> Any:
        return EnvMask(mask.tensor)

    def every(self, count: int) -> Any:
        return EnvMask(torch.ones(count, dtype=torch.bool, device=self.device), everything=True)

    def environments(self, ids: NDArray[np.int64], count: int) -> Any:
        mask = np.zeros(count, np.bool_)
        mask[ids] = True
        return EnvMask(torch.from_numpy(mask).to(self.device), everything=len(ids) == count)

    def are_all(self, ids: Any, count: int) -> bool:
        everything: bool = ids.everything
        return everything

    def streams(self, seed: int, count: int) -> RandomStreams:
        from embodichain.lab.sim.engine.device_streams import DeviceStreams

        return cast("RandomStreams", DeviceStreams(seed, count, str(self.device)))

    def require_host(self, what: str, path: str = "") -> None:
        message = f"{what} have no form with arrays on a device: use sim.warp.arrays=host"
        raise ConfigError([Problem(path, message)])
