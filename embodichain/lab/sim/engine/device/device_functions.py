"""Numpy's functions in torch, for `DeviceArray`: tables from numpy's function to its form."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

from embodichain.lab.sim.engine.device.device_values import (
    of_one_type,
    operand,
    reduced,
    refuse,
    torch_type,
)

__all__ = ["BINARY", "FUNCTIONS", "REDUCTIONS", "SAME_TYPE", "UNARY"]


def _cbrt(x: torch.Tensor) -> torch.Tensor:
    return torch.sign(x) * torch.abs(x) ** (1.0 / 3.0)


def _sign(x: torch.Tensor) -> torch.Tensor:
    return torch.where(torch.isnan(x), x, torch.sign(x))


UNARY: dict[np.ufunc, Callable[[Any], torch.Tensor]] = {
    np.absolute: torch.abs,
    np.arccos: torch.acos,
    np.arcsin: torch.asin,
    np.cbrt: _cbrt,
    np.ceil: torch.ceil,
    np.cos: torch.cos,
    np.cosh: torch.cosh,
    np.deg2rad: torch.deg2rad,
    np.exp: torch.exp,
    np.floor: torch.floor,
    np.invert: torch.bitwise_not,
    np.isfinite: torch.isfinite,
    np.isinf: torch.isinf,
    np.isnan: torch.isnan,
    np.log: torch.log,
    np.log1p: torch.log1p,
    np.logical_not: torch.logical_not,
    np.negative: torch.neg,
    np.positive: torch.clone,
    np.radians: torch.deg2rad,
    np.rint: torch.round,
    np.sign: _sign,
    np.sin: torch.sin,
    np.sqrt: torch.sqrt,
    np.square: torch.square,
    np.tan: torch.tan,
    np.tanh: torch.tanh,
}
"""Of one array."""
BINARY: dict[np.ufunc, Callable[[Any, Any], torch.Tensor]] = {
    np.add: torch.add,
    np.arctan2: torch.atan2,
    np.bitwise_and: torch.bitwise_and,
    np.bitwise_or: torch.bitwise_or,
    np.bitwise_xor: torch.bitwise_xor,
    np.divide: torch.div,
    np.equal: torch.eq,
    np.floor_divide: torch.floor_divide,
    np.greater: torch.gt,
    np.greater_equal: torch.ge,
    np.hypot: torch.hypot,
    np.less: torch.lt,
    np.less_equal: torch.le,
    np.logical_and: torch.logical_and,
    np.logical_or: torch.logical_or,
    np.maximum: torch.maximum,
    np.minimum: torch.minimum,
    np.multiply: torch.mul,
    np.not_equal: torch.ne,
    np.power: torch.pow,
    np.remainder: torch.remainder,
    np.subtract: torch.sub,
    np.vecdot: torch.linalg.vecdot,
}
"""Of two arrays, or of an array and a number."""
SAME_TYPE: set[np.ufunc] = {
    np.arctan2,
    np.hypot,
    np.logical_and,
    np.logical_or,
    np.maximum,
    np.minimum,
    np.vecdot,
}
"""Those whose form in torch takes tensors of one type only."""
REDUCTIONS: dict[np.ufunc, Callable[..., torch.Tensor]] = {
    np.add: torch.sum,
    np.logical_and: torch.all,
    np.logical_or: torch.any,
    np.maximum: torch.amax,
    np.minimum: torch.amin,
    np.multiply: torch.prod,
}
"""``ufunc.reduce`` along axes."""


def _where(device: torch.device, condition: Any, x: Any, y: Any) -> torch.Tensor:
    first, second = of_one_type(device, x, y)
    return torch.where(operand(condition, device), first, second)


def _broadcast(device: torch.device, *values: Any) -> list[torch.Tensor]:
    """Operands as tensors of one type and shape."""
    parts = of_one_type(device, *values)
    shape = np.broadcast_shapes(*(tuple(part.shape) for part in parts))
    return [part.expand(shape) for part in parts]


def _stack(device: torch.device, arrays: Sequence[Any], axis: int = 0) -> torch.Tensor:
    return torch.stack(_broadcast(device, *arrays), dim=axis)


def _concatenate(device: torch.device, arrays: Sequence[Any], axis: int | None = 0) -> torch.Tensor:
    parts = of_one_type(device, *arrays)
    if axis is None:
        return torch.cat([part.reshape(-1) for part in parts])
    return torch.cat(parts, dim=axis)


def _clip(device: torch.device, a: Any, a_min: Any = None, a_max: Any = None) -> torch.Tensor:
    clipped: torch.Tensor = operand(a, device)
    if a_min is not None:
        clipped, low = of_one_type(device, clipped, a_min)
        clipped = torch.maximum(clipped, low)
    if a_max is not None:
        clipped, high = of_one_type(device, clipped, a_max)
        clipped = torch.minimum(clipped, high)
    return clipped


def _full_like(
    device: torch.device, a: Any, fill_value: Any, dtype: Any = None, *, shape: Any = None
) -> torch.Tensor:
    like = operand(a, device)
    fill = operand(fill_value, device)
    kind = like.dtype if dtype is None else torch_type(dtype)
    lengths = like.shape if shape is None else shape
    if isinstance(fill, torch.Tensor):
        return fill.to(kind).expand(lengths).clone()
    return torch.full(lengths, fill, dtype=kind, device=device)


def _like(value: float) -> Callable[..., torch.Tensor]:
    def make(device: torch.device, a: Any, dtype: Any = None, *, shape: Any = None) -> torch.Tensor:
        return _full_like(device, a, value, dtype, shape=shape)

    return make


def _norm(
    device: torch.device, x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False
) -> torch.Tensor:
    values = operand(x, device)
    if ord is not None:
        refuse("numpy.linalg.norm with ord is not available on a device: used")
    return torch.linalg.vector_norm(values, dim=axis, keepdim=keepdims)


def _cross(device: torch.device, a: Any, b: Any, axis: int = -1) -> torch.Tensor:
    return torch.linalg.cross(*_broadcast(device, a, b), dim=axis)


def _reduction(function: Callable[..., torch.Tensor]) -> Callable[..., torch.Tensor]:
    def reduce(
        device: torch.device, a: Any, axis: Any = None, keepdims: bool = False
    ) -> torch.Tensor:
        return reduced(function, operand(a, device), axis, keepdims)

    return reduce


def _moveaxis(device: torch.device, a: Any, source: Any, destination: Any) -> torch.Tensor:
    return torch.movedim(operand(a, device), source, destination)


def _broadcast_to(device: torch.device, array: Any, shape: Any) -> torch.Tensor:
    return operand(array, device).expand(shape)


def _expand_dims(device: torch.device, a: Any, axis: int) -> torch.Tensor:
    return torch.unsqueeze(operand(a, device), axis)


def _swapaxes(device: torch.device, a: Any, axis1: int, axis2: int) -> torch.Tensor:
    return torch.transpose(operand(a, device), axis1, axis2)


def _reshape(device: torch.device, a: Any, shape: Any) -> torch.Tensor:
    lengths = (shape,) if isinstance(shape, int) else tuple(shape)
    return torch.reshape(operand(a, device), lengths)


def _tile(device: torch.device, A: Any, reps: Any) -> torch.Tensor:
    return torch.tile(operand(A, device), (reps,) if isinstance(reps, int) else tuple(reps))


def _repeat(device: torch.device, a: Any, repeats: int, axis: int | None = None) -> torch.Tensor:
    return torch.repeat_interleave(operand(a, device), repeats, axis)


def _take_along_axis(device: torch.device, arr: Any, indices: Any, axis: int) -> torch.Tensor:
    return torch.take_along_dim(operand(arr, device), operand(indices, device), axis)


def _argsort(device: torch.device, a: Any, axis: int = -1, kind: str | None = None) -> torch.Tensor:
    return torch.argsort(operand(a, device), dim=axis, stable=True)


def _searchsorted(device: torch.device, a: Any, v: Any, side: str = "left") -> torch.Tensor:
    return torch.searchsorted(*of_one_type(device, a, v), side=side)


FUNCTIONS: dict[Callable[..., Any], Callable[..., torch.Tensor]] = {
    np.all: _reduction(torch.all),
    np.amax: _reduction(torch.amax),
    np.amin: _reduction(torch.amin),
    np.any: _reduction(torch.any),
    np.argsort: _argsort,
    np.broadcast_to: _broadcast_to,
    np.clip: _clip,
    np.concatenate: _concatenate,
    np.cross: _cross,
    np.empty_like: _like(0),
    np.expand_dims: _expand_dims,
    np.full_like: _full_like,
    np.linalg.norm: _norm,
    np.mean: _reduction(torch.mean),
    np.moveaxis: _moveaxis,
    np.ones_like: _like(1),
    np.repeat: _repeat,
    np.reshape: _reshape,
    np.searchsorted: _searchsorted,
    np.stack: _stack,
    np.sum: _reduction(torch.sum),
    np.swapaxes: _swapaxes,
    np.take_along_axis: _take_along_axis,
    np.tile: _tile,
    np.where: _where,
    np.zeros_like: _like(0),
}
"""Of arrays, as numpy takes them, after the device."""
