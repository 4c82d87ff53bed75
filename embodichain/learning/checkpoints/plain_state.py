"""Trees of plain values and arrays in one npz file, without pickle and without loss."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.learning.checkpoints.zip_limits import check_unpacked
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.system.atomic import atomic_file

__all__ = ["read_tree", "write_tree"]

_TREE = "tree"
_KIND = "__kind__"
_UNREADABLE = (OSError, ValueError, KeyError, EOFError, MemoryError)
"""What numpy raises for damaged files, such as one whose arrays are said to be huge."""


def write_tree(path: Path, tree: Mapping[str, Any]) -> None:
    """Write a tree atomically.

    Args:
        path: The file.
        tree: Maps with strings or with integers as keys, lists, tuples, arrays, tensors, numbers,
            strings, None. Numbers are stored exactly: floats as their `repr`, integers of any size.

    Raises:
        TypeError: The tree contains another type; names its path.
        OSError: The file cannot be written; no partial file remains.
    """
    arrays: dict[str, NDArray[Any]] = {}
    text = json.dumps(_pack(tree, "state", arrays))
    entries: dict[str, Any] = {_TREE: np.array(text), **arrays}
    with atomic_file(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **entries)


def read_tree(path: Path, key: str = "resume", what: str = "state of a training") -> dict[str, Any]:
    """Read a file written by `write_tree`; runs no code of the file.

    Args:
        path: The file.
        key: Config key to name in the error about a damaged file.
        what: Name of the content in messages.

    Raises:
        ConfigError: If the file is missing or has another format.
    """
    try:
        check_unpacked(path)
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        tree = _unpack(json.loads(str(arrays[_TREE])), arrays)
    except (*_UNREADABLE, zipfile.BadZipFile) as error:
        raise ConfigError([Problem(key, f"{path} has no {what}: {error}")]) from error
    if not isinstance(tree, dict):
        raise ConfigError([Problem(key, f"{path} has no {what}")])
    return tree


def _pack(value: Any, path: str, arrays: dict[str, NDArray[Any]]) -> Any:
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, torch.Tensor):
        return _pack_array("tensor", value.numpy(force=True), path, arrays)
    if isinstance(value, np.generic):
        return _pack_array("scalar", np.asarray(value), path, arrays)
    if isinstance(value, np.ndarray):
        return _pack_array("array", np.asarray(value), path, arrays)
    if isinstance(value, Mapping):
        packed = {key: _pack(item, f"{path}.{key}", arrays) for key, item in value.items()}
        if packed and all(type(key) is int for key in packed):
            return {_KIND: "int_map", "items": {str(key): item for key, item in packed.items()}}
        if not all(isinstance(key, str) for key in packed):
            raise TypeError(f"{path} has keys that are not text: {list(packed)}")
        return {_KIND: "map", "items": packed}
    if isinstance(value, (list, tuple)):
        items = [_pack(item, f"{path}[{i}]", arrays) for i, item in enumerate(value)]
        if isinstance(value, tuple):
            return {_KIND: "tuple", "items": items}
        return items
    raise TypeError(f"{path} is {type(value).__name__}: it cannot be written")


def _pack_array(
    kind: str, array: NDArray[Any], path: str, arrays: dict[str, NDArray[Any]]
) -> dict[str, str]:
    """Add an array to those of the file, and return what stands for it in the JSON."""
    if array.dtype.hasobject:
        raise TypeError(f"{path} contains objects: they cannot be written")
    name = f"a{len(arrays)}"
    arrays[name] = array
    return {_KIND: kind, "name": name}


def _unpack(value: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    if isinstance(value, list):
        return [_unpack(item, arrays) for item in value]
    if not isinstance(value, dict):
        return value
    kind = value[_KIND]
    if kind == "map":
        return {key: _unpack(item, arrays) for key, item in value["items"].items()}
    if kind == "int_map":
        return {int(key): _unpack(item, arrays) for key, item in value["items"].items()}
    if kind == "tuple":
        return tuple(_unpack(item, arrays) for item in value["items"])
    array = arrays[value["name"]]
    if kind == "tensor":
        return torch.from_numpy(np.array(array))
    if kind == "scalar":
        return array[()]
    return array
