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
    if isinstance(value, (np.ndarray, np.generic, torch.Tensor)):
        name = f"a{len(arrays)}"
        if isinstance(value, torch.Tensor):
            kind, arrays[name] = "tensor", value.numpy(force=True)
        else:
            kind = "scalar" if isinstance(value, np.generic) else "array"
            arrays[name] = np.asarray(value)
        if arrays[name].dtype.hasobject:
            raise TypeError(f"{path} contains objects: they cannot be written")
        return {_KIND: kind, "name": name}
    if isinstance(value, Mapping):
        items = [(k, _pack(v, f"{path}.{k}", arrays)) for k, v in value.items()]
        if items and all(type(k) is int for k, _ in items):
            return {_KIND: "int_map", "items": {str(k): v for k, v in items}}
        if not all(isinstance(k, str) for k, _ in items):
            raise TypeError(f"{path} has keys that are no text: {[k for k, _ in items]}")
        return {_KIND: "map", "items": dict(items)}
    if isinstance(value, (list, tuple)):
        items = [_pack(v, f"{path}[{i}]", arrays) for i, v in enumerate(value)]
        return {_KIND: "tuple", "items": items} if isinstance(value, tuple) else items
    raise TypeError(f"{path} is {type(value).__name__}: it cannot be written")


def _unpack(value: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    if isinstance(value, list):
        return [_unpack(v, arrays) for v in value]
    if not isinstance(value, dict):
        return value
    kind = value[_KIND]
    if kind == "map":
        return {k: _unpack(v, arrays) for k, v in value["items"].items()}
    if kind == "int_map":
        return {int(k): _unpack(v, arrays) for k, v in value["items"].items()}
    if kind == "tuple":
        return tuple(_unpack(v, arrays) for v in value["items"])
    array = arrays[value["name"]]
    if kind == "tensor":
        return torch.from_numpy(np.array(array))
    return array[()] if kind == "scalar" else array
