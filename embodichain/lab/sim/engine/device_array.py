"""`DeviceArray`: a torch tensor that answers numpy's protocols, and `EnvMask`, environments as a mask.

Terms are written in numpy's syntax. On a device their arrays are `DeviceArray`: numpy's functions
call the methods below (NEP 13 and NEP 18), which call torch. Nothing is copied to the host unless
`DeviceArray.host` is called: every other way raises `HostTransferError` with the file and line, so
that a step has no hidden synchronization and can be captured in a CUDA graph.
"""

from __future__ import annotations

import sys
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NoReturn

import numpy as np
import torch
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

__all__ = ["DeviceArray", "EnvMask", "HostTransferError", "on_device"]

_TORCH_TYPES: dict[np.dtype[Any], torch.dtype] = {
    np.dtype(np.float64): torch.float32,  # physics is float32 on a device
    np.dtype(np.float32): torch.float32,
    np.dtype(np.int64): torch.int64,
    np.dtype(np.int32): torch.int32,
    np.dtype(np.uint8): torch.uint8,
    np.dtype(np.bool_): torch.bool,
}
_NUMPY_TYPES = {
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


class HostTransferError(TypeError):
    """Code would copy an array from a device to the host, or from it, without saying so."""


def _refuse(what: str) -> NoReturn:
    frame = sys._getframe(1)
    here = (__file__, np.__file__.rpartition("/")[0])
    while frame.f_back is not None and frame.f_code.co_filename.startswith(here):
        frame = frame.f_back
    raise HostTransferError(
        f"{what} at {frame.f_code.co_filename}:{frame.f_lineno}: arrays of this simulation are on "
        "its device; use sim.warp.arrays=host"
    )


class EnvMask:
    """Environments on a device: those where a mask is set, used as an index of the first axis.

    Reading ``x[env_mask]`` gives all rows of ``x``, and ``x[env_mask] = v`` changes only rows where
    the mask is set. So code for (n,) indices of environments computes all N rows here, without
    knowing on the host which of them count.

    Args:
        mask: (N,) bool.
        everything: Whether it is known that all are set.
    """

    __slots__ = ("everything", "mask")

    def __init__(self, mask: torch.Tensor, everything: bool = False) -> None:
        self.mask, self.everything = mask, everything

    def __len__(self) -> int:
        """Number of rows of reads: N."""
        return len(self.mask)

    def __getitem__(self, key: Any) -> EnvMask:
        """Further environments among these (a mask (N,)), or the same for ``[:, None]``."""
        if isinstance(key, DeviceArray):
            return EnvMask(self.mask & key.tensor)
        if isinstance(key, tuple) and all(k is None or k == slice(None) for k in key):
            return self
        return _refuse("environments of a mask were selected by position")

    def __array__(self, *args: Any, **kwargs: Any) -> NoReturn:
        """Refuse: indices of a mask are not known on the host."""
        _refuse("a mask of environments was made an array of the host")


class _Constants:
    """Copies on devices of small arrays of the host, by their contents."""

    def __init__(self) -> None:
        self._known: OrderedDict[tuple[Any, ...], torch.Tensor] = OrderedDict()

    def get(self, array: NDArray[Any], device: torch.device) -> torch.Tensor:
        if array.nbytes > _LARGEST_CONSTANT:
            _refuse(f"an array of the host of shape {array.shape} met one of the device")
        key = (array.tobytes(), array.shape, array.dtype, device)
        found = self._known.get(key)
        if found is None:
            kept = _TORCH_TYPES.get(array.dtype)
            if kept is None:
                _refuse(f"numbers of type {array.dtype} have no form on a device: used")
            found = torch.from_numpy(np.array(array)).to(device, kept)
            self._known[key] = found
            if len(self._known) > _MOST_CONSTANTS:
                self._known.popitem(last=False)
        return found


_constants = _Constants()


def on_device(array: Any, device: torch.device) -> DeviceArray:
    """Copy an array of the host to a device: floating point numbers as float32."""
    values = np.asarray(array)
    return DeviceArray(torch.from_numpy(np.array(values)).to(device, _TORCH_TYPES[values.dtype]))


def _operand(value: Any, device: torch.device) -> Any:
    """A tensor on the device, or a Python number."""
    if isinstance(value, DeviceArray):
        return value.tensor
    if isinstance(value, torch.Tensor):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.item() if value.ndim == 0 else _constants.get(value, device)
    if isinstance(value, (list, tuple)):
        return _operand(np.asarray(value), device)
    return value


def _tensors(device: torch.device, *values: Any) -> list[torch.Tensor]:
    """Operands as tensors of one type; Python numbers do not widen it."""
    found = [_operand(value, device) for value in values]
    kept = next(v.dtype for v in found if isinstance(v, torch.Tensor))
    for value in found:
        if isinstance(value, torch.Tensor):
            kept = torch.promote_types(kept, value.dtype)
    if not kept.is_floating_point and any(isinstance(v, float) for v in found):
        kept = torch.float32
    return [
        v.to(kept) if isinstance(v, torch.Tensor) else torch.full((), v, dtype=kept, device=device)
        for v in found
    ]


def _index(key: Any, device: torch.device) -> tuple[Any, torch.Tensor | None]:
    """An index for torch, and the mask of its first axes if there is one."""
    keys = list(key) if isinstance(key, tuple) else [key]
    mask = None
    for place, part in enumerate(keys):
        if isinstance(part, EnvMask):
            mask = part.mask.reshape(*[1] * place, -1)
            keys[place] = slice(None)
        elif isinstance(part, (DeviceArray, np.ndarray, np.generic, list)):
            keys[place] = _operand(part, device)
    return tuple(keys), mask


def _reversed_step(keys: tuple[Any, ...]) -> bool:
    return any(isinstance(k, slice) and k.step is not None and k.step < 0 for k in keys)


class DeviceArray(NDArrayOperatorsMixin):
    """An array on a device, in numpy's syntax.

    Args:
        tensor: Its numbers; shared.
    """

    __slots__ = ("tensor",)
    __array_priority__ = 1000
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, tensor: torch.Tensor) -> None:
        self.tensor = tensor

    def host(self) -> NDArray[Any]:
        """Copy the numbers to the host; waits for the device."""
        array: NDArray[Any] = self.tensor.detach().cpu().numpy()
        return array.copy() if self.tensor.device.type == "cpu" else array

    # -- shape and type --------------------------------------------------------------------------

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the axes."""
        return tuple(self.tensor.shape)

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return self.tensor.ndim

    @property
    def size(self) -> int:
        """Count of numbers."""
        return self.tensor.numel()

    @property
    def dtype(self) -> np.dtype[Any]:
        """Numpy's type of the numbers."""
        return _NUMPY_TYPES[self.tensor.dtype]

    @property
    def T(self) -> DeviceArray:
        """The axes in reverse order; a view."""
        return DeviceArray(self.tensor.permute(*reversed(range(self.ndim))))

    def __len__(self) -> int:
        return len(self.tensor)

    def __iter__(self) -> Iterator[DeviceArray]:
        return (DeviceArray(part) for part in self.tensor.unbind(0))

    def __repr__(self) -> str:
        return f"DeviceArray({self.shape}, {self.dtype}, {self.tensor.device})"

    # -- what would copy to the host ---------------------------------------------------------------

    def __array__(self, dtype: Any = None, copy: Any = None) -> NoReturn:
        """Refuse to be copied to the host."""
        _refuse("an array of the device was made one of the host")

    def __bool__(self) -> bool:
        _refuse("a value of the device decided a branch")

    def __float__(self) -> float:
        _refuse("a value of the device was made a Python number")

    __int__ = __index__ = __complex__ = __float__  # type: ignore[assignment]

    def tobytes(self) -> bytes:
        """Refuse to be copied to the host."""
        _refuse("an array of the device was made bytes")

    def tolist(self) -> list[Any]:
        """Refuse to be copied to the host."""
        _refuse("an array of the device was made a list")

    def item(self) -> Any:
        """Refuse to be copied to the host."""
        _refuse("a value of the device was made a Python number")

    # -- indexing ----------------------------------------------------------------------------------

    def __getitem__(self, key: Any) -> DeviceArray:
        keys, mask = _index(key, self.tensor.device)
        if not _reversed_step(keys):
            if any(isinstance(k, torch.Tensor) and k.dtype == torch.bool for k in keys):
                _refuse("rows of the device were selected by a mask")
            found = self.tensor[keys]
            # As numpy's selection by indices it is a copy: `x[env_ids] -= 1` changes it in place.
            return DeviceArray(found if mask is None else found.clone())
        places = [
            torch.arange(self.tensor.shape[axis], device=self.tensor.device)[
                range(*k.indices(self.tensor.shape[axis]))
            ]
            if isinstance(k, slice) and k.step is not None and k.step < 0
            else k
            for axis, k in enumerate(keys)
        ]
        return DeviceArray(self.tensor[tuple(places)])

    def __setitem__(self, key: Any, value: Any) -> None:
        device = self.tensor.device
        keys, mask = _index(key, device)
        new = _operand(value, device)
        if len(keys) == 1 and isinstance(keys[0], torch.Tensor) and keys[0].dtype == torch.bool:
            mask, keys = keys[0], (slice(None),)
        if isinstance(new, torch.Tensor):
            new = new.to(self.tensor.dtype)
        if mask is None:
            self.tensor[keys] = new
            return
        old = self.tensor[keys]
        rows = mask.reshape(*mask.shape, *[1] * (old.ndim - mask.ndim))
        self.tensor[keys] = torch.where(rows, new, old)

    # -- methods of numpy's arrays -------------------------------------------------------------------

    def copy(self) -> DeviceArray:
        """A copy on the device."""
        return DeviceArray(self.tensor.clone())

    def astype(self, dtype: Any, copy: bool = True) -> DeviceArray:
        """Convert; to float64 stays in the present type of floating point numbers."""
        wanted = np.dtype(dtype)
        kept = _TORCH_TYPES[wanted]
        if wanted == np.float64 and self.tensor.is_floating_point():
            kept = self.tensor.dtype
        return DeviceArray(self.tensor.to(kept, copy=copy))

    def reshape(self, *shape: Any) -> DeviceArray:
        """With other lengths of axes."""
        lengths = shape[0] if len(shape) == 1 and isinstance(shape[0], (tuple, list)) else shape
        return DeviceArray(self.tensor.reshape(tuple(lengths)))

    def take(self, indices: Any, axis: int) -> DeviceArray:
        """Numbers at indices (any shape) along an axis."""
        places = _operand(np.asarray(indices), self.tensor.device)
        axis %= self.ndim
        found = self.tensor.index_select(axis, places.reshape(-1))
        shape = (*self.shape[:axis], *places.shape, *self.shape[axis + 1 :])
        return DeviceArray(found.reshape(shape))

    def rows_of(self, table: NDArray[Any]) -> DeviceArray:
        """Rows of an array of the host at these indices."""
        return DeviceArray(_operand(table, self.tensor.device)[self.tensor])

    def swapaxes(self, first: int, second: int) -> DeviceArray:
        """With two axes exchanged; a view."""
        return DeviceArray(self.tensor.transpose(first, second))

    def any(self, axis: Any = None, keepdims: bool = False) -> DeviceArray:
        """Whether any is set."""
        return DeviceArray(_reduced(torch.any, self.tensor, axis, keepdims))

    def all(self, axis: Any = None, keepdims: bool = False) -> DeviceArray:
        """Whether all are set."""
        return DeviceArray(_reduced(torch.all, self.tensor, axis, keepdims))

    def sum(self, axis: Any = None, keepdims: bool = False) -> DeviceArray:
        """The sum."""
        return DeviceArray(_reduced(torch.sum, self.tensor, axis, keepdims))

    def mean(self, axis: Any = None, keepdims: bool = False) -> DeviceArray:
        """The mean."""
        return DeviceArray(_reduced(torch.mean, self.tensor, axis, keepdims))

    def min(self, axis: Any = None, keepdims: bool = False) -> DeviceArray:
        """The smallest number."""
        return DeviceArray(_reduced(torch.amin, self.tensor, axis, keepdims))

    def max(self, axis: Any = None, keepdims: bool = False) -> DeviceArray:
        """The largest number."""
        return DeviceArray(_reduced(torch.amax, self.tensor, axis, keepdims))

    def argmin(self, axis: int) -> DeviceArray:
        """Index of the smallest number along an axis."""
        return DeviceArray(self.tensor.argmin(axis))

    def argmax(self, axis: int) -> DeviceArray:
        """Index of the largest number along an axis."""
        return DeviceArray(self.tensor.argmax(axis))

    # -- numpy's protocols -----------------------------------------------------------------------------

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """Numpy's elementwise functions, and reductions of some of them."""
        out = options.pop("out", None)
        device = self.tensor.device
        if method == "reduce" and ufunc in _REDUCTIONS:
            axis, keepdims = options.pop("axis", 0), options.pop("keepdims", False)
            found = _reduced(_REDUCTIONS[ufunc], _operand(inputs[0], device), axis, keepdims)
        elif method == "accumulate" and ufunc is np.add:
            found = torch.cumsum(_operand(inputs[0], device), options.pop("axis", 0))
        elif method == "__call__" and ufunc in _UNARY:
            value = _operand(inputs[0], device)
            found = _UNARY[ufunc](value)
        elif method == "__call__" and ufunc in _BINARY:
            a, b = (_operand(value, device) for value in inputs)
            if ufunc in _SAME_TYPE or not isinstance(a, torch.Tensor):
                a, b = _tensors(device, a, b)
            found = _BINARY[ufunc](a, b)
        else:
            _refuse(f"numpy.{ufunc.__name__} ({method}) has no form on a device: used")
        chosen = options.pop("where", True)
        if options:
            _refuse(f"options {sorted(options)} of numpy.{ufunc.__name__} have no form: used")
        if out is None:
            return DeviceArray(found)
        target = out[0]
        if not isinstance(target, DeviceArray):
            _refuse("a result of the device was written into an array of the host")
        if chosen is not True:
            found = torch.where(_operand(chosen, device), found, target.tensor)
        target.tensor.copy_(found)
        return target

    def __array_function__(
        self, func: Callable[..., Any], types: Any, args: Any, kwargs: Any
    ) -> Any:
        """Numpy's other functions."""
        found = _FUNCTIONS.get(func)
        if found is None:
            _refuse(f"numpy.{func.__name__} has no form on a device: used")
        return DeviceArray(found(self.tensor.device, *args, **kwargs))


def _reduced(
    function: Callable[..., Any], values: torch.Tensor, axis: Any, keepdims: bool
) -> torch.Tensor:
    if axis is None:
        axis = tuple(range(values.ndim))
    if function in (torch.any, torch.all) and isinstance(axis, tuple) and len(axis) == 1:
        axis = axis[0]
    found: torch.Tensor = function(values, dim=axis, keepdim=keepdims)
    return found


_UNARY: dict[np.ufunc, Callable[[Any], torch.Tensor]] = {
    np.sqrt: torch.sqrt, np.exp: torch.exp, np.tanh: torch.tanh, np.cos: torch.cos,
    np.sin: torch.sin, np.absolute: torch.abs, np.negative: torch.neg, np.log: torch.log,
    np.logical_not: torch.logical_not, np.invert: torch.bitwise_not, np.isfinite: torch.isfinite,
    np.isnan: torch.isnan, np.isinf: torch.isinf, np.floor: torch.floor, np.ceil: torch.ceil,
    np.rint: torch.round, np.square: torch.square, np.cosh: torch.cosh, np.log1p: torch.log1p,
    np.arccos: torch.acos, np.arcsin: torch.asin, np.sign: torch.sign, np.tan: torch.tan,
    np.positive: torch.clone, np.cbrt: lambda x: torch.sign(x) * torch.abs(x) ** (1.0 / 3.0), np.deg2rad: torch.deg2rad, np.radians: torch.deg2rad,
}  # fmt: skip
_BINARY: dict[np.ufunc, Callable[[Any, Any], torch.Tensor]] = {
    np.add: torch.add, np.subtract: torch.sub, np.multiply: torch.mul, np.divide: torch.div,
    np.maximum: torch.maximum, np.minimum: torch.minimum, np.greater: torch.gt, np.less: torch.lt,
    np.greater_equal: torch.ge, np.less_equal: torch.le, np.equal: torch.eq,
    np.not_equal: torch.ne, np.logical_and: torch.logical_and, np.logical_or: torch.logical_or,
    np.bitwise_or: torch.bitwise_or, np.bitwise_and: torch.bitwise_and,
    np.bitwise_xor: torch.bitwise_xor, np.vecdot: torch.linalg.vecdot, np.arctan2: torch.atan2, np.power: torch.pow,
    np.remainder: torch.remainder, np.floor_divide: torch.floor_divide, np.hypot: torch.hypot,
}  # fmt: skip
_SAME_TYPE = {
    np.vecdot,
    np.maximum,
    np.minimum,
    np.arctan2,
    np.hypot,
    np.logical_and,
    np.logical_or,
}
_REDUCTIONS: dict[np.ufunc, Callable[..., Any]] = {
    np.add: torch.sum,
    np.logical_or: torch.any,
    np.logical_and: torch.all,
    np.maximum: torch.amax,
    np.minimum: torch.amin,
    np.multiply: torch.prod,
}


def _where(device: torch.device, condition: Any, a: Any, b: Any) -> torch.Tensor:
    chosen = _operand(condition, device)
    if not isinstance(a, (DeviceArray, np.ndarray)) and not isinstance(
        b, (DeviceArray, np.ndarray)
    ):
        kept = torch.bool if isinstance(a, (bool, np.bool_)) else torch.float32
        a, b = (torch.full((), float(x), device=device).to(kept) for x in (a, b))
        return torch.where(chosen, a, b)
    return torch.where(chosen, *_tensors(device, a, b))


def _stack(device: torch.device, arrays: Sequence[Any], axis: int = 0) -> torch.Tensor:
    return torch.stack(torch.broadcast_tensors(*_tensors(device, *arrays)), dim=axis)


def _concatenate(device: torch.device, arrays: Sequence[Any], axis: int | None = 0) -> torch.Tensor:
    parts = _tensors(device, *arrays)
    if axis is None:
        return torch.cat([part.reshape(-1) for part in parts])
    return torch.cat(parts, dim=axis)


def _clip(device: torch.device, a: Any, a_min: Any, a_max: Any) -> torch.Tensor:
    values, low, high = _tensors(device, a, a_min, a_max)
    return torch.minimum(torch.maximum(values, low), high)


def _like(value: float) -> Callable[..., torch.Tensor]:
    def make(
        device: torch.device, a: Any, dtype: Any = None, shape: Any = None, order: str = "K"
    ) -> torch.Tensor:
        values = _operand(a, device)
        kept = values.dtype if dtype is None else _TORCH_TYPES[np.dtype(dtype)]
        lengths = values.shape if shape is None else shape
        return torch.full(lengths, value, dtype=kept, device=device)

    return make


def _full_like(device: torch.device, a: Any, fill_value: float, dtype: Any = None) -> torch.Tensor:
    return _like(fill_value)(device, a, dtype)


def _norm(device: torch.device, x: Any, axis: Any = None, keepdims: bool = False) -> torch.Tensor:
    return torch.linalg.vector_norm(_operand(x, device), dim=axis, keepdim=keepdims)


def _cross(device: torch.device, a: Any, b: Any, axis: int = -1) -> torch.Tensor:
    return torch.linalg.cross(*torch.broadcast_tensors(*_tensors(device, a, b)), dim=axis)


def _reduction(function: Callable[..., Any]) -> Callable[..., torch.Tensor]:
    def reduce(device: torch.device, a: Any, axis: Any = None, keepdims: bool = False) -> Any:
        return _reduced(function, _operand(a, device), axis, keepdims)

    return reduce


def _moveaxis(device: torch.device, a: Any, source: Any, destination: Any) -> torch.Tensor:
    return torch.movedim(_operand(a, device), source, destination)


_FUNCTIONS: dict[Callable[..., Any], Callable[..., torch.Tensor]] = {
    np.where: _where,
    np.stack: _stack,
    np.concatenate: _concatenate,
    np.clip: _clip,
    np.zeros_like: _like(0),
    np.ones_like: _like(1),
    np.empty_like: _like(0),
    np.full_like: _full_like,
    np.linalg.norm: _norm,
    np.cross: _cross,
    np.sum: _reduction(torch.sum),
    np.any: _reduction(torch.any),
    np.all: _reduction(torch.all),
    np.amin: _reduction(torch.amin),
    np.amax: _reduction(torch.amax),
    np.mean: _reduction(torch.mean),
    np.moveaxis: _moveaxis,
    np.broadcast_to: lambda device, array, shape: _operand(array, device).expand(shape),
    np.expand_dims: lambda device, a, axis: _operand(a, device).unsqueeze(axis),
    np.swapaxes: lambda device, a, i, j: _operand(a, device).transpose(i, j),
    np.reshape: lambda device, a, shape: _operand(a, device).reshape(shape),
    np.tile: lambda device, a, reps: _operand(a, device).tile(reps),
    np.repeat: lambda device, a, repeats, axis: _operand(a, device).repeat_interleave(
        repeats, axis
    ),
    np.argsort: lambda device, a, axis=-1, kind=None: _operand(a, device).argsort(
        dim=axis, stable=True
    ),
    np.searchsorted: lambda device, a, v, side="left": torch.searchsorted(
        *_tensors(device, a, v), side=side
    ),
    np.take_along_axis: lambda device, a, indices, axis: torch.take_along_dim(
        _operand(a, device), _operand(indices, device), axis
    ),
}
