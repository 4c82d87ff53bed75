"""Operands of arrays on a device: types, constants of the host, and what is refused.

What a `DeviceArray` meets is made a tensor on its device here, or refused with the place.
"""

from __future__ import annotations

import sys
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import torch
from numpy.typing import NDArray

__all__ = [
    "NUMPY_TYPES",
    "HostTransferError",
    "TensorHolder",
    "constants",
    "of_one_type",
    "operand",
    "reduced",
    "refuse",
    "torch_type",
]

_TORCH_TYPES: dict[np.dtype[Any], torch.dtype] = {
    np.dtype(np.float64): torch.float32,  # physics is float32 on a device
    np.dtype(np.float32): torch.float32,
    np.dtype(np.int64): torch.int64,
    np.dtype(np.int32): torch.int32,
    np.dtype(np.uint8): torch.uint8,
    np.dtype(np.bool_): torch.bool,
}
NUMPY_TYPES: dict[torch.dtype, np.dtype[Any]] = {
    torch.float64: np.dtype(np.float64),
    torch.float32: np.dtype(np.float32),
    torch.int64: np.dtype(np.int64),
    torch.int32: np.dtype(np.int32),
    torch.uint8: np.dtype(np.uint8),
    torch.bool: np.dtype(np.bool_),
}
_LARGEST_CONSTANT = 65536
"""Bytes: larger arrays of the host are data, which must be moved by name."""
_MOST_CONSTANTS = 4096
_ENGINES = Path(__file__).parents[1]
_OWN_FILES = (
    str(_ENGINES / "device" / "device_"),
    str(_ENGINES / "warp" / "device_"),
    str(Path(np.__file__).parent),
)
"""Beginnings of file names that no message names: the caller's line is the one to change."""


class HostTransferError(TypeError):
    """Code would copy an array from a device to the host, or from it, without saying so."""


class TensorHolder:
    """What is made of a tensor on a device.

    Args:
        tensor: Shared.
    """

    __slots__ = ("tensor",)

    def __init__(self, tensor: torch.Tensor) -> None:
        self.tensor = tensor


def refuse(what: str) -> NoReturn:
    """Raise `HostTransferError` with what happened and the line of the caller's caller."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_OWN_FILES):
        frame = frame.f_back
    raise HostTransferError(
        f"{what} at {frame.f_code.co_filename}:{frame.f_lineno}: arrays of this simulation are on "
        "its device; use sim.warp.arrays=host"
    )


def torch_type(dtype: Any) -> torch.dtype:
    """Torch's type for one of numpy's: float32 for float64."""
    kind = _TORCH_TYPES.get(np.dtype(dtype))
    if kind is None:
        refuse(f"numbers of type {np.dtype(dtype)} are not available on a device: used")
    return kind


class Constants:
    """Copies on devices of small arrays of the host, by their contents.

    Those that a CUDA graph reads are never freed.
    """

    def __init__(self) -> None:
        self._recent: OrderedDict[tuple[Any, ...], torch.Tensor] = OrderedDict()
        self._captured: dict[tuple[Any, ...], torch.Tensor] = {}

    def get(self, array: NDArray[Any], device: torch.device) -> torch.Tensor:
        """Return the copy of an array; do not write to it.

        Raises:
            HostTransferError: If there is none yet, and a CUDA graph is being captured.
        """
        key = (array.tobytes(), array.shape, array.dtype, device)
        copy = self._captured.get(key)
        if copy is not None:
            return copy
        copy = self._recent.get(key)
        if _capturing():
            if copy is None:
                refuse(
                    f"an array of the host of shape {array.shape} is new in a captured step: used"
                )
            self._captured[key] = copy
            return copy
        if copy is not None:
            self._recent.move_to_end(key)
            return copy
        copy = torch.from_numpy(np.array(array)).to(device, torch_type(array.dtype))
        self._recent[key] = copy
        if len(self._recent) > _MOST_CONSTANTS:
            self._recent.popitem(last=False)
        return copy

    def number(self, value: float, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
        """Return a Python number as a tensor without axes; do not write to it."""
        return self.get(np.array(value, NUMPY_TYPES[dtype]), device).to(dtype)


def _capturing() -> bool:
    """Whether a CUDA graph is being captured."""
    return torch.cuda.is_available() and torch.cuda.is_current_stream_capturing()


constants = Constants()
"""Of this process."""


def operand(value: Any, device: torch.device) -> Any:
    """Return a value as a tensor on a device, or as a Python number."""
    if isinstance(value, TensorHolder):
        return value.tensor
    if isinstance(value, torch.Tensor):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        if value.nbytes > _LARGEST_CONSTANT:
            refuse(f"an array of the host of shape {value.shape} met one of the device")
        return value.item() if value.ndim == 0 else constants.get(value, device)
    if isinstance(value, (list, tuple)):
        return operand(np.asarray(value), device)
    return value


def of_one_type(device: torch.device, *values: Any) -> list[torch.Tensor]:
    """Return operands as tensors of one type; Python numbers do not widen it."""
    operands = [operand(value, device) for value in values]
    types = [value.dtype for value in operands if isinstance(value, torch.Tensor)]
    numbers = [value for value in operands if not isinstance(value, torch.Tensor)]
    common = types[0] if types else torch_type(np.result_type(*operands))
    for other in types[1:]:
        common = torch.promote_types(common, other)
    if not common.is_floating_point and any(isinstance(number, float) for number in numbers):
        common = torch.float32
    elif common == torch.bool and any(type(number) is int for number in numbers):
        common = torch.int64
    tensors = []
    for value in operands:
        if isinstance(value, torch.Tensor):
            tensors.append(value.to(common))
        else:
            tensors.append(constants.number(value, common, device))
    return tensors


def reduced(
    function: Callable[..., torch.Tensor], values: torch.Tensor, axis: Any, keepdims: bool
) -> torch.Tensor:
    """Return a reduction of torch along axes; None is all of them."""
    if axis is None:
        axis = tuple(range(values.ndim))
    if function is torch.mean and not values.is_floating_point():
        values = values.to(torch.float32)
    if function is torch.prod:  # along one axis at a time, the last first: others keep their places
        axes = axis if isinstance(axis, tuple) else (axis,)
        for number in sorted({number % values.ndim for number in axes}, reverse=True):
            values = torch.prod(values, dim=number, keepdim=keepdims)
        return values
    return function(values, dim=axis, keepdim=keepdims)
