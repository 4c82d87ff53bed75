"""Types of arrays, and of environments that index them, on the host or on a device.

Code that takes an `EnvIndex` only indexes the first axis of arrays by it, passes it on, or asks for
its length: it runs with either. Code that lists environments takes `EnvIds`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import torch

__all__ = ["F64", "EnvIds", "EnvIndex", "EnvMaskLike", "Floats", "host_ids"]

F64 = NDArray[np.float64]
"""An array of float64 on the host."""
Floats = NDArray[Any]
"""Floating point numbers where the simulation has its arrays: float64 on the host, or float32 on a
device, as a `DeviceArray`, which has numpy's syntax.

Type checkers take them for numpy's arrays of an unknown type: the same code runs with either."""

EnvIds = NDArray[np.int64]
"""(n,) sorted unique indices of environments, on the host."""


class EnvMaskLike(Protocol):
    """Environments on a device: those where a mask (N,) is set. `EnvMask` is the class.

    As an index of the first axis it reads all N rows, and writes those where the mask is set.
    """

    mask: torch.Tensor
    everything: bool

    def __len__(self) -> int:
        """Number of rows of reads: N."""

    def __getitem__(self, key: Any) -> EnvMaskLike:
        """Further environments among these, or the same for ``[:, None]``."""

    def __array__(self) -> NoReturn:
        """Refuse to be copied to the host. With this method it may index arrays."""


EnvIndex = EnvIds | EnvMaskLike
"""Environments as an index of the first axis: `EnvIds`, or a mask where arrays are on a device."""


def host_ids(env_ids: EnvIndex) -> EnvIds:
    """Return environments where they must be indices.

    Raises:
        TypeError: If they are a mask on a device.
    """
    if not isinstance(env_ids, np.ndarray):
        raise TypeError(
            f"environments must be indices on the host here, got {type(env_ids).__name__}"
        )
    return env_ids
