"""`DeviceArray`: a torch tensor in numpy's syntax, and `EnvMask`, environments as a mask.

Terms are written in numpy's syntax. On a device their arrays are `DeviceArray`: numpy's functions
call the methods below (NEP 13 and NEP 18), which call torch. Nothing is copied to the host unless
`DeviceArray.host` is called: every other way raises `HostTransferError` with the file and line, so
that a step has no hidden synchronization and can be captured in a CUDA graph.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import EllipsisType
from typing import Any, NoReturn

import numpy as np
import torch
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from embodichain.lab.sim.engine.device.device_functions import (
    BINARY,
    FUNCTIONS,
    REDUCTIONS,
    SAME_TYPE,
    UNARY,
)
from embodichain.lab.sim.engine.device.device_values import (
    NUMPY_TYPES,
    HostTransferError,
    TensorHolder,
    constants,
    of_one_type,
    operand,
    reduced,
    refuse,
    torch_type,
)
from embodichain.utils.arrays import columns_of

__all__ = ["DeviceArray", "EnvMask", "HostTransferError", "constant", "on_device"]


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
        self.mask = mask
        self.everything = everything

    def __len__(self) -> int:
        """Number of rows of reads: N."""
        return len(self.mask)

    def __getitem__(self, key: Any) -> EnvMask:
        """Further environments among these (a mask (N,)), or the same for ``[:, None]``."""
        if isinstance(key, DeviceArray):
            return EnvMask(self.mask & key.tensor)
        if isinstance(key, tuple) and all(k is None or k == slice(None) for k in key):
            return self
        return refuse("environments of a mask were selected by position")

    def __array__(self, *args: Any, **kwargs: Any) -> NoReturn:
        """Refuse: indices of a mask are not known on the host."""
        refuse("a mask of environments was made an array of the host")


def _index(key: Any, device: torch.device) -> tuple[Any, torch.Tensor | None, bool]:
    """An index for torch, the mask of its first axes if there is one, and whether reads copy.

    Indices of the host that ascend evenly become slices, which are three times faster.
    """
    keys = list(key) if isinstance(key, tuple) else [key]
    mask = None
    copies = False
    arrays = sum(isinstance(part, (DeviceArray, np.ndarray, list)) for part in keys)
    for place, part in enumerate(keys):
        if isinstance(part, EnvMask):
            axes_before = sum(not isinstance(k, int) for k in keys[:place])  # an int has no axis
            mask = part.mask.reshape(*[1] * axes_before, -1)
            copies = True
            keys[place] = slice(None)
        elif isinstance(part, (np.ndarray, list)):
            copies = True
            positions = _positions(np.asarray(part))
            columns: Any = positions
            if positions.ndim == 1 and arrays == 1:
                columns = columns_of(positions)
            keys[place] = columns if isinstance(columns, slice) else operand(positions, device)
        elif isinstance(part, (DeviceArray, np.generic)):
            keys[place] = operand(part, device)
    return tuple(keys), mask, copies


def _positions(places: NDArray[Any]) -> NDArray[np.int64]:
    """Indices that an index array of the host selects; those of a mask (n,) are known here."""
    if places.dtype != np.bool_:
        return places.astype(np.int64)
    if places.ndim != 1:
        refuse(f"a mask of the host of shape {places.shape} was an index")
    return np.flatnonzero(places)


def _unreversed(tensor: torch.Tensor, keys: tuple[Any, ...]) -> tuple[torch.Tensor, list[Any]]:
    """A tensor and keys without negative steps, which torch has not."""
    # A key for every axis: those that are not named stand where the ellipsis is, or last.
    places = [place for place, key in enumerate(keys) if isinstance(key, EllipsisType)]
    ellipsis = places[0] if places else len(keys)
    unnamed = tensor.ndim - sum(key is not None and key is not Ellipsis for key in keys)
    all_keys = [*keys[:ellipsis], *[slice(None)] * unnamed, *keys[ellipsis + 1 :]]
    axis = 0
    for place, key in enumerate(all_keys):
        if isinstance(key, slice) and key.step is not None and key.step < 0:
            start, stop, step = key.indices(tensor.shape[axis])
            indices = torch.arange(start, min(stop, start), step, device=tensor.device)
            tensor = tensor.index_select(axis, indices)
            all_keys[place] = slice(None)
        axis += key is not None
    return tensor, all_keys


class DeviceArray(TensorHolder, NDArrayOperatorsMixin):
    """An array on a device, in numpy's syntax.

    Args:
        tensor: Its numbers; shared.
    """

    __slots__ = ()
    __array_priority__ = 1000
    __hash__ = None  # type: ignore[assignment]

    def host(self) -> NDArray[Any]:
        """Copy the numbers to the host; waits for the device."""
        array: NDArray[Any] = self.tensor.detach().cpu().numpy()
        shares_memory = self.tensor.device.type == "cpu"
        return array.copy() if shares_memory else array

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
        return NUMPY_TYPES[self.tensor.dtype]

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

    # -- what would copy to the host -------------------------------------------------------------

    def __array__(self, dtype: Any = None, copy: Any = None) -> NoReturn:
        """Refuse to be copied to the host."""
        refuse("an array of the device was made one of the host")

    def __bool__(self) -> bool:
        refuse("a value of the device decided a branch")

    def __float__(self) -> float:
        refuse("a value of the device was made a Python number")

    __int__ = __index__ = __complex__ = __float__

    def __getattr__(self, name: str) -> NoReturn:
        """Refuse numpy's methods that are not available here."""
        if not name.startswith("_") and hasattr(np.ndarray, name):
            refuse(f"the method {name} of numpy's arrays is not available on a device: used")
        raise AttributeError(f"a DeviceArray has no attribute {name!r}")

    def tobytes(self) -> bytes:
        """Refuse to be copied to the host."""
        refuse("an array of the device was made bytes")

    def tolist(self) -> list[Any]:
        """Refuse to be copied to the host."""
        refuse("an array of the device was made a list")

    def item(self) -> Any:
        """Refuse to be copied to the host."""
        refuse("a value of the device was made a Python number")

    # -- indexing --------------------------------------------------------------------------------

    def __getitem__(self, key: Any) -> DeviceArray:
        keys, _, copies = _index(key, self.tensor.device)
        if copies and not any(isinstance(k, torch.Tensor) for k in keys):
            return DeviceArray(self.tensor[keys].clone())  # as from numpy's indices
        if any(isinstance(k, torch.Tensor) and k.dtype == torch.bool for k in keys):
            refuse("rows of the device were selected by a mask")
        if any(isinstance(k, slice) and k.step is not None and k.step < 0 for k in keys):
            tensor, unreversed = _unreversed(self.tensor, keys)
            return DeviceArray(tensor[tuple(unreversed)])
        return DeviceArray(self.tensor[keys])

    def __setitem__(self, key: Any, value: Any) -> None:
        device = self.tensor.device
        keys, mask, _ = _index(key, device)
        new = operand(value, device)
        if len(keys) == 1 and isinstance(keys[0], torch.Tensor) and keys[0].dtype == torch.bool:
            mask = keys[0]
            keys = (slice(None),)
        if isinstance(new, torch.Tensor):
            new = new.to(self.tensor.dtype)
            if new.untyped_storage().data_ptr() == self.tensor.untyped_storage().data_ptr():
                new = new.clone()  # numpy allows that both overlap
        if mask is None:
            self.tensor[keys] = new
            return
        old = self.tensor[keys]
        rows = mask.reshape(*mask.shape, *[1] * (old.ndim - mask.ndim))
        if any(isinstance(k, torch.Tensor) for k in keys):
            self.tensor[keys] = torch.where(rows, new, old)
        elif isinstance(new, torch.Tensor):  # `old` is a view
            torch.where(rows, new, old, out=old)
        else:
            old.masked_fill_(rows.expand(old.shape), new)

    # -- methods of numpy's arrays ---------------------------------------------------------------

    def copy(self) -> DeviceArray:
        """A copy on the device."""
        return DeviceArray(self.tensor.clone())

    def astype(self, dtype: Any, copy: bool = True) -> DeviceArray:
        """Convert; to float64 stays in the present type of floating point numbers."""
        kind = torch_type(dtype)
        if np.dtype(dtype) == np.float64 and self.tensor.is_floating_point():
            kind = self.tensor.dtype
        return DeviceArray(self.tensor.to(kind, copy=copy))

    def reshape(self, *shape: Any) -> DeviceArray:
        """With other lengths of axes."""
        lengths = shape[0] if len(shape) == 1 and isinstance(shape[0], (tuple, list)) else shape
        return DeviceArray(self.tensor.reshape(tuple(lengths)))

    def take(self, indices: Any, axis: int) -> DeviceArray:
        """Numbers at indices (any shape) along an axis."""
        if not isinstance(indices, DeviceArray):
            indices = np.asarray(indices, np.int64)
        places = operand(indices, self.tensor.device)
        return DeviceArray(self.tensor[(*[slice(None)] * (axis % self.ndim), places)])

    def rows_of(self, table: NDArray[Any]) -> DeviceArray:
        """Rows of an array of the host at these indices."""
        return DeviceArray(operand(table, self.tensor.device)[self.tensor])

    def swapaxes(self, first: int, second: int) -> DeviceArray:
        """With two axes exchanged; a view."""
        return DeviceArray(self.tensor.transpose(first, second))

    def any(self, axis: Any = None, keepdims: bool = False) -> DeviceArray:
        """Whether any is set."""
        return DeviceArray(reduced(torch.any, self.tensor, axis, keepdims))

    def all(self, axis: Any = None, keepdims: bool = False) -> DeviceArray:
        """Whether all are set."""
        return DeviceArray(reduced(torch.all, self.tensor, axis, keepdims))

    def sum(self, axis: Any = None, keepdims: bool = False) -> DeviceArray:
        """The sum."""
        return DeviceArray(reduced(torch.sum, self.tensor, axis, keepdims))

    def mean(self, axis: Any = None, keepdims: bool = False) -> DeviceArray:
        """The mean."""
        return DeviceArray(reduced(torch.mean, self.tensor, axis, keepdims))

    def min(self, axis: Any = None, keepdims: bool = False) -> DeviceArray:
        """The smallest number."""
        return DeviceArray(reduced(torch.amin, self.tensor, axis, keepdims))

    def max(self, axis: Any = None, keepdims: bool = False) -> DeviceArray:
        """The largest number."""
        return DeviceArray(reduced(torch.amax, self.tensor, axis, keepdims))

    def argmin(self, axis: int) -> DeviceArray:
        """Index of the smallest number along an axis."""
        return DeviceArray(self.tensor.argmin(axis))

    def argmax(self, axis: int) -> DeviceArray:
        """Index of the largest number along an axis."""
        return DeviceArray(self.tensor.argmax(axis))

    # -- numpy's protocols -----------------------------------------------------------------------

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """Numpy's elementwise functions, and reductions of some of them."""
        out = options.pop("out", None)
        device = self.tensor.device
        where = options.pop("where", True)
        if where is not True and (out is None or method != "__call__"):
            refuse(
                f"numpy.{ufunc.__name__} with where and without out is not available on a "
                "device: used"
            )
        if method == "reduce" and ufunc in REDUCTIONS:
            axis = options.pop("axis", 0)
            keepdims = options.pop("keepdims", False)
            result = reduced(REDUCTIONS[ufunc], operand(inputs[0], device), axis, keepdims)
        elif method == "accumulate" and ufunc is np.add:
            result = torch.cumsum(operand(inputs[0], device), options.pop("axis", 0))
        elif method == "__call__" and ufunc in UNARY:
            result = UNARY[ufunc](operand(inputs[0], device))
        elif method == "__call__" and ufunc in BINARY:
            a, b = (operand(value, device) for value in inputs)
            if ufunc in SAME_TYPE or not isinstance(a, torch.Tensor):
                a, b = of_one_type(device, a, b)
            result = BINARY[ufunc](a, b)
        else:
            refuse(f"numpy.{ufunc.__name__} ({method}) is not available on a device: used")
        if options:
            refuse(
                f"options {sorted(options)} of numpy.{ufunc.__name__} "
                "are not available on a device: used"
            )
        if out is None:
            return DeviceArray(result)
        target = out[0]
        if not isinstance(target, DeviceArray):
            refuse("a result of the device was written into an array of the host")
        if where is not True:
            result = torch.where(operand(where, device), result, target.tensor)
        if not torch.can_cast(result.dtype, target.tensor.dtype):
            raise TypeError(f"cannot write {result.dtype} into an array of {target.tensor.dtype}")
        target.tensor.copy_(result)
        return target

    def __array_function__(
        self, func: Callable[..., Any], types: Any, args: Any, kwargs: Any
    ) -> Any:
        """Numpy's other functions."""
        function = FUNCTIONS.get(func)
        if function is None:
            refuse(f"numpy.{func.__name__} is not available on a device: used")
        try:
            return DeviceArray(function(self.tensor.device, *args, **kwargs))
        except HostTransferError:
            raise
        except TypeError as error:
            refuse(
                f"numpy.{func.__name__} with these arguments is not available "
                f"on a device ({error}): used"
            )


def on_device(array: Any, device: torch.device) -> DeviceArray:
    """Copy an array of the host to a device: floating point numbers as float32."""
    values = np.asarray(array)
    return DeviceArray(torch.from_numpy(np.array(values)).to(device, torch_type(values.dtype)))


def constant(array: NDArray[Any], device: torch.device) -> DeviceArray:
    """Copy an array of the host to a device, once for each content: do not write to the result."""
    return DeviceArray(constants.get(array, device))
