"""`kept_arrays`: every place in an environment that has an array of the device between steps."""

from __future__ import annotations

import types
import weakref
from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch

from embodichain.lab.sim.engine.device.device_array import DeviceArray

__all__ = ["HostValue", "Path", "Place", "kept_arrays"]

Path = tuple[Any, ...]
HostValue = int | float | bool | bytes

_LEAVES = (
    str,
    bytes,
    complex,
    type(None),
    np.generic,
    type,
    types.ModuleType,
    types.BuiltinFunctionType,
    torch.dtype,
    torch.device,
    torch.nn.Module,
    torch.Generator,
    *weakref.ProxyTypes,  # what they refer to is kept, and found, elsewhere
)
"""Classes whose objects are not looked into."""
_FOREIGN = (
    "mujoco",
    "warp",
    "gymnasium",
    "logging",
    "threading",
    "pathlib",
    "omegaconf",
    "numpy.random",
)
"""Packages whose objects are not looked into."""
_LARGEST = 1 << 20
"""Bytes: larger arrays of the host are not compared."""


class Place(NamedTuple):
    """An attribute, or an entry of a list, a tuple or a dictionary.

    Attributes:
        owner: The object, list or dictionary; of an entry of a tuple, the tuple's own place.
        key: The attribute's name, the index or the key.
    """

    owner: Any
    key: Any

    def get(self) -> Any:
        """Return its value."""
        owner = self.owner.get() if isinstance(self.owner, Place) else self.owner
        if isinstance(owner, (dict, list, tuple)):
            return owner[self.key]
        return getattr(owner, self.key)

    def set(self, value: Any) -> None:
        """Replace its value."""
        if isinstance(self.owner, Place):
            parts = list(self.owner.get())
            parts[self.key] = value
            self.owner.set(tuple(parts))
        elif isinstance(self.owner, (dict, list)):
            self.owner[self.key] = value
        else:
            object.__setattr__(self.owner, self.key, value)


def kept_arrays(
    root: object, skipped: tuple[type, ...] = ()
) -> tuple[dict[Path, Place], dict[Path, HostValue]]:
    """Find all arrays of the device in an object and in everything that it refers to.

    Args:
        root: The object; objects of MuJoCo, Warp and Gymnasium are not looked into.
        skipped: Classes whose objects are not looked into either.

    Returns:
        Path from the root -> place of an array or a tensor; path -> a number of the host, or the
        bytes of an array of the host.
    """
    arrays: dict[Path, Place] = {}
    numbers: dict[Path, HostValue] = {}
    seen: set[int] = set()
    waiting: list[tuple[Path, Any, Place | None]] = [((), root, None)]
    while waiting:
        path, owner, place = waiting.pop()
        if id(owner) in seen or isinstance(owner, skipped):
            continue
        seen.add(id(owner))
        for key, value, part_place in _parts(owner, place):
            part_path = (*path, key)
            if isinstance(value, (DeviceArray, torch.Tensor)):
                if part_place is not None:
                    arrays[part_path] = part_place
            elif isinstance(value, (int, float)):
                numbers[part_path] = value
            elif isinstance(value, np.ndarray):
                if value.nbytes <= _LARGEST:
                    numbers[part_path] = value.tobytes()
            elif not isinstance(value, _LEAVES):
                waiting.append((part_path, value, part_place))
    return arrays, numbers


def _parts(owner: Any, place: Place | None) -> Iterator[tuple[Any, Any, Place | None]]:
    """Yield key, value and place (None if it cannot be changed) of everything in an object."""
    if isinstance(owner, dict):
        yield from ((key, value, Place(owner, key)) for key, value in owner.items())
    elif isinstance(owner, list):
        yield from ((i, value, Place(owner, i)) for i, value in enumerate(owner))
    elif type(owner) is tuple:
        for i, value in enumerate(owner):
            yield i, value, None if place is None else Place(place, i)
    elif isinstance(owner, (tuple, set, frozenset)):
        yield from ((i, value, None) for i, value in enumerate(owner))
    elif isinstance(owner, types.MappingProxyType):
        yield from ((key, value, None) for key, value in owner.items())
    elif isinstance(owner, partial):
        yield "func", owner.func, None
        yield "keywords", owner.keywords, None
        yield from ((i, value, None) for i, value in enumerate(owner.args))
    elif isinstance(owner, types.MethodType):
        yield "self", owner.__self__, None
    elif isinstance(owner, types.FunctionType):
        for i, cell in enumerate(owner.__closure__ or ()):
            if cell != types.CellType():
                yield i, cell.cell_contents, None
    elif not type(owner).__module__.startswith(_FOREIGN):
        for key, value in getattr(owner, "__dict__", {}).items():
            yield key, value, Place(owner, key)
        for cls in type(owner).__mro__:
            for key in getattr(cls, "__slots__", ()):
                if hasattr(owner, key):
                    yield key, getattr(owner, key), Place(owner, key)
