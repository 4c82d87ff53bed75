"""Conversion between users' tensors and the engine's numpy rows.

Environment indices, shapes, devices and finiteness are checked here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.engine.device_array import DeviceArray, EnvMask
from embodichain.utils.arrays import tensor_of

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.engine.api import F64, Columns, EnvIndex

__all__ = [
    "all_finite",
    "as_env_ids",
    "as_rows",
    "field_values",
    "to_tensor",
]


def all_finite(values: NDArray[np.floating[Any]]) -> bool:
    """Whether all numbers are finite."""
    # Searching for a zero byte takes half the time of a reduction on small arrays.
    return b"\0" not in np.isfinite(values).tobytes()


def to_tensor(array: NDArray[Any]) -> torch.Tensor:
    """Return a float32 tensor that shares no memory with ``array``."""
    return tensor_of(array.astype(np.float32))


def field_values(
    model: mujoco.MjModel, fields: Mapping[str, NDArray[Any]], name: str, columns: Columns
) -> tuple[F64, F64]:
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
    """Return sorted unique int64 environment indices, or None for all of them.

    Args:
        env_ids: None, a boolean mask (N,), or sorted unique indices in [0, N).
        num_envs: N.

    Raises:
        ValueError: If indices are unsorted, repeated, out of range or of the wrong kind.
    """
    if env_ids is None or isinstance(env_ids, EnvMask):
        return cast("EnvIndex | None", env_ids)
    if isinstance(env_ids, torch.Tensor):
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
) -> F64:
    """Return values as (rows, width) float64.

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
    if isinstance(values, DeviceArray):
        return cast("F64", _device_rows(values, rows, width, what))
    if isinstance(values, torch.Tensor):
        if values.device.type != "cpu":
            raise ValueError(f"{what} is on {values.device}; this simulation is on cpu")
        values = values.detach().numpy()
    array = np.asarray(values, np.float64)
    if array.shape != (rows, width):
        if shared and array.shape == (width,):
            array = np.broadcast_to(array, (rows, width))
        else:
            wanted = f"({rows}, {width})" + (f" or ({width},)" if shared else "")
            raise ValueError(f"{what} must have shape {wanted}, got {array.shape}")
    if finite and not all_finite(array):
        bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
        raise ValueError(f"{what} is not finite in rows {bad[:8].tolist()}")
    return array


def _device_rows(values: DeviceArray, rows: int, width: int, what: str) -> Any:
    """Check shapes only: whether numbers are finite is not known without waiting."""
    if values.shape not in ((rows, width), (width,)):
        raise ValueError(f"{what} must have shape ({rows}, {width}), got {values.shape}")
    found: Any = np.broadcast_to(cast("F64", values), (rows, width))
    return found
