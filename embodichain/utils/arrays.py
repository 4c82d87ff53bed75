"""Arrays of numpy and arrays on a device (`DeviceArray`), used alike.

`Arrays` makes those that are kept between steps: code that uses it runs with numpy's arrays on the
host and with arrays on a device. `as_env_ids` and `as_rows` check what users give: indices, shapes,
devices, finiteness.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from embodichain.utils.array_types import EnvIndex, Floats
from embodichain.utils.random import RandomStreams
from embodichain.utils.short_repr import short_repr

if TYPE_CHECKING:
    import torch

__all__ = [
    "Arrays",
    "all_finite",
    "as_env_ids",
    "as_rows",
    "as_tensor",
    "columns_of",
    "contiguous",
    "field_values",
    "is_host",
    "may_be_set",
    "precise",
    "rows_at",
    "tensor_of",
    "to_tensor",
    "zeros",
]


class Arrays:
    """Arrays of numpy, on the host.

    Attributes:
        device: Device of the tensors.
        on_device: Whether arrays are `DeviceArray`, and environments `EnvMask`.
    """

    on_device = False

    def __init__(self) -> None:
        import torch

        self.device = torch.device("cpu")

    def __repr__(self) -> str:
        """Return class and device."""
        return short_repr(self, device=str(self.device))

    def full(self, shape: int | Sequence[int], value: Any, dtype: Any = np.float64) -> Any:
        """Make an array with one value everywhere."""
        if value is False or (type(value) in (int, float) and value == 0):  # eight times faster
            return np.zeros(shape, dtype)
        return np.full(shape, value, dtype)

    def put(self, array: Any) -> Any:
        """Return a copy of an array of the host."""
        return np.array(array)

    def constant(self, array: NDArray[Any]) -> Any:
        """Return an array of the host, which seldom changes, where arrays are: do not write."""
        return array

    def host(self, array: Any) -> NDArray[Any]:
        """Return an array on the host; from a device it is a copy, which waits for the device."""
        return array

    def of(self, values: Any) -> Any:
        """Return an array that shares memory with a tensor or an array, if its type allows."""
        if isinstance(values, np.ndarray):
            return values
        return values.numpy(force=True) if hasattr(values, "numpy") else np.asarray(values)

    def where(self, mask: Any) -> Any:
        """Return the environments where a mask (N,) is set: sorted indices."""
        return mask.nonzero()[0]

    def every(self, count: int) -> Any:
        """Return all environments, of `count`."""
        return np.arange(count)

    def environments(self, ids: NDArray[np.int64], count: int) -> Any:
        """Return environments, of `count`, from their sorted indices."""
        return ids

    def are_all(self, ids: Any, count: int) -> bool:
        """Whether environments are known to be all, of `count`."""
        return len(ids) == count

    def streams(self, seed: int, count: int, first: int = 0) -> RandomStreams:
        """Make random streams whose draws are arrays of this kind."""
        return RandomStreams(seed, count, first)

    def require_host(self, what: str, path: str = "") -> None:
        """Refuse something that is not available with arrays on a device.

        Args:
            what: What needs arrays on the host.
            path: Key path of the parameter that asks for it, for the message.

        Raises:
            ConfigError: If arrays are on a device.
        """

    def saved(self, state: Any) -> Any:
        """Return a state of maps and lists in which every array is on the host."""
        return state

    def loaded(self, state: Any) -> Any:
        """Return a state with its arrays where they were before `saved`."""
        return state


def is_host(array: Any) -> bool:
    """Whether an array, or anything else, is not on a device."""
    kind = type(array)
    return kind is np.ndarray or not hasattr(kind, "tensor")


def may_be_set(mask: Any) -> bool:
    """Whether a flag of a mask, or a number, is set; True on a device, where it is not known."""
    if not is_host(mask):
        return True
    if mask.dtype == np.bool_:
        # Searching for a byte takes a tenth of the time of a reduction on small arrays.
        return b"\1" in mask.tobytes()
    return bool(mask.any())


def tensor_of(array: Any) -> torch.Tensor:
    """Return a tensor that shares memory with an array, where the array is."""
    if not isinstance(array, np.ndarray):
        return array.tensor
    # Scenes are checked without torch. A statement to import it would take twice as long here.
    module: Any = sys.modules.get("torch") or import_module("torch")
    return module.from_numpy(array)


def as_tensor(values: Any) -> torch.Tensor:
    """Return numbers, an array or a tensor as a tensor, where they are."""
    module: Any = sys.modules.get("torch") or import_module("torch")
    return module.as_tensor(values)


def zeros(shape: tuple[int, ...], like: Any) -> Floats:
    """Return zeros, where an array is: float64, on a device in the type of its numbers."""
    if is_host(like):
        return np.zeros(shape)
    return type(like)(like.tensor.new_zeros(shape))


def contiguous(array: Any, dtype: Any = None) -> NDArray[Any]:
    """Return numbers in order of their indices, on the host as `numpy.ascontiguousarray`.

    Rounding of numpy's functions depends on the order in memory; that of a device does not.
    """
    if is_host(array):
        return np.ascontiguousarray(array, dtype)
    return array if dtype is None else array.astype(dtype, copy=False)


def precise(array: Any) -> NDArray[Any]:
    """Return numbers as float64 on a device too, where arrays are float32 otherwise."""
    return array if is_host(array) else type(array)(array.tensor.double())


def rows_at(table: NDArray[Any], indices: Any) -> NDArray[Any]:
    """Return rows of an array of the host at indices (n,), where these are."""
    return table[indices] if is_host(indices) else indices.rows_of(table)


def all_finite(values: NDArray[np.floating[Any]]) -> bool:
    """Whether all numbers are finite."""
    # Searching for a zero byte takes half the time of a reduction on small arrays.
    return b"\0" not in np.isfinite(values).tobytes()


def to_tensor(array: NDArray[Any]) -> torch.Tensor:
    """Return a float32 tensor that shares no memory with ``array``."""
    return tensor_of(array.astype(np.float32))


def columns_of(ids: Sequence[int] | NDArray[Any]) -> slice | NDArray[np.int64]:
    """Return a slice if indices ascend evenly (gives views, not copies), else the indices."""
    return _columns(np.asarray(ids, np.int64).tobytes())


@lru_cache(maxsize=1024)
def _columns(ids: bytes) -> slice | NDArray[np.int64]:
    array = np.frombuffer(ids, np.int64)
    if not len(array):
        return array
    step = int(array[1] - array[0]) if len(array) > 1 else 1
    if step > 0 and (np.diff(array) == step).all():
        return slice(int(array[0]), int(array[-1]) + 1, step if step > 1 else None)
    return array


def field_values(
    model: Any, fields: Mapping[str, NDArray[Any]], name: str, columns: slice | NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return columns (k,) of a flattened model field: current values and compiled values.

    Args:
        model: The compiled model.
        fields: Name -> (size,) current values; other fields are as compiled.
        name: The field.
        columns: Its k columns.
    """
    compiled = getattr(model, name)
    now, before = (
        np.asarray(values, np.float64).reshape(-1)[columns]
        for values in (fields.get(name, compiled), compiled)
    )
    return now, before


def as_env_ids(env_ids: Any, num_envs: int) -> EnvIndex | None:
    """Return sorted unique int64 environment indices, a mask on a device, or None for all of them.

    Args:
        env_ids: None, a boolean mask (N,), sorted unique indices in [0, N), or an `EnvMask`, which
            is returned.
        num_envs: N.

    Raises:
        ValueError: If indices are unsorted, repeated, out of range or of the wrong kind.
    """
    if env_ids is None:
        return None
    if hasattr(type(env_ids), "mask"):
        return cast("EnvIndex", env_ids)
    if hasattr(env_ids, "detach"):
        env_ids = env_ids.detach().cpu().numpy()
    ids = np.asarray(env_ids)
    if ids.dtype == np.bool_:
        if ids.shape != (num_envs,):
            raise ValueError(f"a mask of environments has shape ({num_envs},), got {ids.shape}")
        return np.flatnonzero(ids)
    if ids.size == 0:
        return np.zeros(0, np.int64)
    if ids.ndim != 1 or not np.issubdtype(ids.dtype, np.integer):
        raise ValueError(
            f"env_ids must be one-dimensional integers or a boolean mask, got {ids.dtype} "
            f"of shape {ids.shape}"
        )
    ids = ids.astype(np.int64)
    if ids[0] < 0 or ids[-1] >= num_envs or np.any(np.diff(ids) <= 0):
        raise ValueError(
            f"env_ids must be sorted, unique and in [0, {num_envs}), got {ids[:8].tolist()}"
        )
    return ids


def as_rows(
    values: Any, rows: int, width: int, what: str, *, shared: bool = False, finite: bool = True
) -> Floats:
    """Return values as (rows, width) float64; those on a device as they are.

    Args:
        values: A tensor, array or nested sequence of shape (rows, width).
        rows: Environments addressed.
        width: Values per environment.
        what: Name for messages.
        shared: Whether one row (width,) may stand for all environments.
        finite: Whether NaN and infinities are refused.

    Raises:
        ValueError: If the shape, the device or a value is wrong; says what is expected.
    """
    if not is_host(values):
        return _device_rows(values, rows, width, what)
    if hasattr(values, "detach"):
        if values.device.type != "cpu":
            raise ValueError(f"{what} is on {values.device}; this simulation is on cpu")
        values = values.detach().numpy()
    array = np.asarray(values, np.float64)
    if array.shape != (rows, width):
        if shared and array.shape == (width,):
            array = np.broadcast_to(array, (rows, width))
        else:
            shapes = f"({rows}, {width})"
            if shared:
                shapes += f" or ({width},)"
            raise ValueError(f"{what} must have shape {shapes}, got {array.shape}")
    if finite and not all_finite(array):
        bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
        raise ValueError(f"{what} is not finite in rows {bad[:8].tolist()}")
    return array


def _device_rows(values: Any, rows: int, width: int, what: str) -> Floats:
    """Check shapes only: whether numbers are finite is not known without waiting."""
    if values.shape not in ((rows, width), (width,)):
        raise ValueError(f"{what} must have shape ({rows}, {width}), got {values.shape}")
    return np.broadcast_to(values, (rows, width))
