"""`Observation`: one (N, W) float32 array with named columns, read as a nested mapping.

`ObservationLayout` maps entries and groups to columns. Images, and entries that are not floating
point, are separate tensors outside the array. Functions at the end make spaces of observations.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Mapping
from typing import Any, TypeVar

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray

from embodichain.utils.arrays import Arrays, tensor_of
from embodichain.utils.tensor_mapping import TensorMapping, leaves_of

__all__ = [
    "Columns",
    "Observation",
    "ObservationLayout",
    "as_array",
    "entry_spaces",
    "flat_space",
    "named_obs",
    "new_tensor",
    "numpy_obs",
    "observation_space",
    "on_host",
]

F32 = NDArray[np.float32]
Path = tuple[str, ...]
Columns = slice | NDArray[np.int64]
_Key = TypeVar("_Key", bound=Hashable)


def as_array(value: Any) -> NDArray[Any]:
    """Return a tensor or an array as an array that shares its memory."""
    if isinstance(value, np.ndarray) or not isinstance(value, torch.Tensor):
        return value
    return value.numpy(force=True)


class ObservationLayout:
    """The columns of the entries of an observation in its array.

    Entries of a group are adjacent, in declared order, so that a group is a slice of columns
    (unless an entry is in several groups).

    Args:
        first: The first observation; later ones have the same entries.
        groups: Name -> paths of its entries, in order.
        num_envs: N.
        images: Paths of the entries that are images.
        arrays: Makes its arrays; None makes them on the host.

    Attributes:
        batch_size: (N,) as torch has it.
        width: W, the columns of all floating point entries but images.
        paths: Paths of these entries, in the observation's order.
        columns: Path -> columns of the entry.
        shapes: Path -> shape of the entry of one environment, of entries in the array.
        widths: Path -> numbers of the entry of one environment.
        groups: Name -> columns of the group; None if an entry is not in the array.
    """

    def __init__(
        self,
        first: Mapping[str, Any],
        groups: Mapping[str, Iterable[Path]],
        num_envs: int,
        images: Collection[Path] = (),
        arrays: Arrays | None = None,
    ) -> None:
        self.num_envs = num_envs
        self.batch_size = torch.Size((num_envs,))
        self._arrays = Arrays() if arrays is None else arrays
        leaves = dict(leaves_of(first))
        self._order = list(leaves)
        self.paths = [
            path for path, leaf in leaves.items() if leaf.is_floating_point() and path not in images
        ]
        grouped = dict.fromkeys(path for paths in groups.values() for path in paths)
        placed = [path for path in self.paths if path not in grouped]
        placed += [path for path in grouped if path in self.paths]
        self.shapes = {path: tuple(leaves[path].shape[1:]) for path in self.paths}
        self.columns: dict[Path, slice] = {}
        start = 0
        for path in placed:
            stop = start + int(np.prod(self.shapes[path], dtype=np.int64))
            self.columns[path] = slice(start, stop)
            start = stop
        self.width = start
        self.widths = {
            path: int(np.prod(leaf.shape[1:], dtype=np.int64)) for path, leaf in leaves.items()
        }
        self.groups = {name: self._columns_of(list(paths)) for name, paths in groups.items()}

    def _columns_of(self, paths: list[Path]) -> Columns | None:
        """Return the columns of a group; None if an entry is not in the array."""
        if any(path not in self.columns for path in paths):
            return None
        slices = [self.columns[path] for path in paths]
        indices = np.concatenate([np.arange(part.start, part.stop) for part in slices])
        if len(indices) and (np.diff(indices) == 1).all():
            return slice(int(indices[0]), int(indices[-1]) + 1)
        return indices

    def empty(self) -> F32:
        """Return an array (N, W) to be filled."""
        return self._arrays.full((self.num_envs, self.width), 0.0, np.float32)

    def pack(self, obs: Mapping[Any, Any]) -> Observation:
        """Return nested entries as one array.

        Args:
            obs: The entries of the first observation; further entries are passed on unchanged.

        Raises:
            KeyError: If an entry is missing.
            ValueError: If an entry has another shape than in the first observation.
        """
        if isinstance(obs, Observation) and obs.layout is self and obs.packed:
            return obs
        packed = Observation(self, self.empty())
        leaves = dict(leaves_of(obs))
        for path in self.paths:
            self.write(packed, path, leaves.pop(path))
        packed.others.update(leaves)
        return packed

    def write(self, obs: Observation, path: Path, value: Any) -> None:
        """Set an entry of an observation.

        Args:
            obs: An observation of this layout.
            path: The entry.
            value: (N, ...) tensor or array.

        Raises:
            ValueError: If its shape is not that of the first observation.
        """
        columns = self.columns.get(path)
        if columns is None:
            if not isinstance(value, torch.Tensor):
                value = new_tensor(value)
            obs.set_other(path, value)
            return
        array = self._arrays.of(value)
        if array.shape[1:] != self.shapes[path]:
            name = "/".join(path)
            first_shape = (self.num_envs, *self.shapes[path])
            raise ValueError(f"observation {name!r} was {first_shape}, is now {tuple(array.shape)}")
        obs.rows[:, columns] = array if array.ndim == 2 else array.reshape(self.num_envs, -1)

    def entry(self, rows: F32, path: Path) -> NDArray[np.float32]:
        """(N, ...) view of an entry's columns."""
        return rows[:, self.columns[path]].reshape(self.num_envs, *self.shapes[path])

    def tree(self, obs: Observation) -> dict[str, Any]:
        """Return the nested entries of an observation: views of its array, and `others`."""
        top: dict[str, Any] = {}
        extra = [path for path in obs.others if path not in self._order]
        for path in (*self._order, *extra):
            if path in self.columns:
                leaf = tensor_of(self.entry(obs.rows, path))
            elif path in obs.others:
                leaf = obs.others[path]
            else:
                continue
            _insert(top, path, leaf, obs.batch_size)
        return top


def _insert(tree: dict[str, Any], path: Path, leaf: torch.Tensor, batch_size: torch.Size) -> None:
    for name in path[:-1]:
        tree = tree.setdefault(name, TensorMapping(batch_size=batch_size)).entries
    tree[path[-1]] = leaf


def new_tensor(value: Any) -> torch.Tensor:
    """Return a copy of an array or a tensor as a tensor, float32 if it is floating point."""
    if not isinstance(value, (np.ndarray, torch.Tensor)):  # on a device
        value = tensor_of(value)
    if isinstance(value, torch.Tensor) and value.device.type != "cpu":
        return value.to(torch.float32 if value.is_floating_point() else value.dtype, copy=True)
    array = as_array(value)
    dtype = np.float32 if np.issubdtype(array.dtype, np.floating) else None
    return torch.from_numpy(np.array(array, dtype))


class Observation(TensorMapping):
    """An observation of N environments; see `TensorMapping` for its access.

    Tensors of floating point entries are views of `rows`, made at the first access.

    Args:
        layout: The columns of the entries.
        rows: (N, W) float32.

    Attributes:
        layout: The columns of the entries.
        rows: (N, W) float32.
        others: Path -> entry that is not in the array.
    """

    def __init__(self, layout: ObservationLayout, rows: F32) -> None:
        self.batch_size = layout.batch_size
        self.layout = layout
        self.rows = rows
        self.others: dict[Path, torch.Tensor] = {}
        self._tree: dict[str, Any] | None = None
        self._views: list[Any] = []

    def with_rows(self, rows: F32) -> Observation:
        """Return an observation with another array; entries outside the array are shared."""
        if rows is self.rows:
            return self
        other = Observation(self.layout, rows)
        other.others.update(self.others)
        return other

    def copy(self) -> Observation:
        """Return an observation that shares no memory with this one."""
        other = Observation(self.layout, self.rows.copy())
        for path, value in self.others.items():
            other.others[path] = value.clone()
        return other

    def set_other(self, path: Path, value: torch.Tensor) -> None:
        """Set an entry that is not in the array; terms may have read `others` already."""
        packed = self.packed
        self.others[path] = value
        if self._tree is not None:
            _insert(self._tree, path, value, self.batch_size)
            if packed:
                self._views = [leaf for _, leaf in leaves_of(self._tree)]

    @property
    def entries(self) -> dict[str, Any]:
        """The entries of the first level."""
        if self._tree is None:
            self._tree = self.layout.tree(self)
            self._views = [leaf for _, leaf in leaves_of(self._tree)]
        return self._tree

    @property
    def packed(self) -> bool:
        """Whether `rows` and `others` are complete: no entry was replaced, added or removed."""
        if self._tree is None:
            return True
        leaves = [leaf for _, leaf in leaves_of(self._tree)]
        return len(leaves) == len(self._views) and all(
            leaf is view for leaf, view in zip(leaves, self._views, strict=True)
        )


# -- spaces and numpy arrays -----------------------------------------------------------------------


def observation_space(obs: Mapping[str, Any]) -> spaces.Dict:
    """Return the space of one environment's observation.

    Floating point entries are unbounded, integers bounded by their type, booleans by 0 and 1.

    Args:
        obs: An observation of N environments.
    """
    return spaces.Dict(
        {
            key: observation_space(value) if isinstance(value, Mapping) else _leaf_space(value)
            for key, value in obs.items()
        }
    )


def _leaf_space(value: Any) -> spaces.Box:
    shape = tuple(value.shape[1:])
    dtype = value.cpu().numpy().dtype
    if np.issubdtype(dtype, np.floating):
        return spaces.Box(-np.inf, np.inf, shape, np.float32)
    if dtype == np.bool_:
        return spaces.Box(0, 1, shape, np.bool_)  # type: ignore[arg-type]
    info = np.iinfo(dtype)
    return spaces.Box(info.min, info.max, shape, dtype.type)


def flat_space(space: gym.Space[Any], num_envs: int) -> spaces.Box:
    """Return the (N, W) Box of a batched observation space, one vector per row."""
    width = spaces.utils.flatdim(space) // num_envs
    return spaces.Box(-np.inf, np.inf, (num_envs, width), np.float32)


def entry_spaces(space: gym.Space[Any], names: Iterable[str]) -> spaces.Dict:
    """Return the spaces of some entries of one environment's observation, by name, in order.

    Args:
        space: The space of one environment's observation.
        names: The entries; "/" nests.
    """
    entries: dict[str, Any] = {}
    for name in names:
        entry: Any = space
        for key in name.split("/"):
            entry = entry[key]
        entries[name] = entry
    return spaces.Dict(entries)


def named_obs(obs: Any, space: spaces.Dict) -> dict[str, NDArray[Any]]:
    """Return an observation's entries (N, ...) by name, as new arrays.

    Args:
        obs: An observation of N environments.
        space: The result of `entry_spaces`.
    """
    arrays: dict[str, NDArray[Any]] = {}
    for name in space:
        entry = obs[tuple(name.split("/"))]
        arrays[name] = np.array(entry.numpy(force=True), space[name].dtype)
    return arrays


def on_host(tensors: Mapping[_Key, torch.Tensor]) -> dict[_Key, NDArray[Any]]:
    """Return copies of tensors as arrays; those of a device come to the host by one copy.

    Args:
        tensors: Key -> tensor; all on one device.
    """
    # Wide types are first, so that each array's address is a multiple of its type's size.
    order = sorted(tensors, key=lambda key: -tensors[key].element_size())
    parts = [tensors[key].reshape(-1).view(torch.uint8) for key in order]
    all_bytes = torch.cat(parts).numpy(force=True)
    arrays: dict[_Key, NDArray[Any]] = {}
    start = 0
    for key, part in zip(order, parts, strict=True):
        stop = start + len(part)
        dtype = torch.empty(0, dtype=tensors[key].dtype).numpy().dtype
        arrays[key] = all_bytes[start:stop].view(dtype).reshape(tuple(tensors[key].shape))
        start = stop
    return {key: arrays[key] for key in tensors}


def numpy_obs(obs: Mapping[str, Any]) -> dict[str, Any]:
    """Return an observation as nested dicts of numpy arrays (N, ...) that share its memory."""
    return {
        key: numpy_obs(value) if isinstance(value, Mapping) else value.cpu().numpy()
        for key, value in obs.items()
    }
