"""`TensorMapping`: a nested mapping of tensors with the batch as first dimension.

It is indexed like a `TensorDict` (``obs["robot"]["qpos"]``, ``obs["robot", "qpos"]``, rows by
index) but avoids importing tensordict, which takes as long as importing torch; see `to_tensordict`.
"""

from __future__ import annotations

from collections.abc import Callable, ItemsView, Iterator, KeysView, Mapping, MutableMapping
from typing import TYPE_CHECKING, Any

import torch

from embodichain.utils.named import unknown_name

if TYPE_CHECKING:
    from collections.abc import Collection

    from tensordict import TensorDict

__all__ = ["TensorMapping", "leaves_of"]


class TensorMapping(MutableMapping[Any, Any]):
    """Maps names to tensors (N, ...) or nested mappings, in order of insertion.

    Keys are names, or paths (tuples of names) through nested levels; `get`, ``in``, ``del`` and
    assignment accept both. Anything else in brackets (an integer, a slice, indices, a mask) selects
    rows of every tensor. The length is the number of names, not of rows.

    Args:
        entries: The entries; nested mappings become `TensorMapping`s, tensors are shared.
        batch_size: (N,); None takes that of the first tensor.

    Raises:
        ValueError: If an entry is neither a mapping nor a tensor with N rows.
    """

    def __init__(self, entries: Mapping[str, Any] | None = None, batch_size: Any = None) -> None:
        entries = {} if entries is None else entries
        if batch_size is None:
            first = next((leaf for _, leaf in leaves_of(entries)), None)
            batch_size = () if first is None else first.shape[:1]
        self.batch_size = torch.Size(batch_size)
        self._entries: dict[str, Any] = {}
        for key, value in entries.items():
            self[key] = value

    @property
    def entries(self) -> dict[str, Any]:
        """The entries of this level."""
        return self._entries

    # -- as a mapping --------------------------------------------------------------------------

    def __getitem__(self, key: Any) -> Any:
        """Return an entry, or a `TensorMapping` of rows."""
        if isinstance(key, str):
            try:
                return self.entries[key]
            except KeyError:
                raise unknown_name("entry", key, self.entries) from None
        if isinstance(key, tuple) and key and isinstance(key[0], str):
            entry: Any = self
            for name in key:
                entry = entry[name]
            return entry
        return self._each(lambda tensor: tensor[key])

    def __setitem__(self, key: Any, value: Any) -> None:
        """Set an entry; missing levels are created."""
        if isinstance(key, tuple):
            *path, key = key
            owner = self
            for name in path:
                if name not in owner:
                    owner.entries[name] = TensorMapping(batch_size=self.batch_size)
                owner = owner.entries[name]
            if owner is not self:
                owner[key] = value
                return
        if isinstance(value, Mapping):
            if not isinstance(value, TensorMapping):
                value = TensorMapping(value, self.batch_size)
        elif not isinstance(value, torch.Tensor):
            raise ValueError(f"entry {key!r} must be a tensor, got {type(value).__name__}")
        elif value.shape[: len(self.batch_size)] != self.batch_size:
            rows = self.batch_size[0]
            shape = tuple(value.shape)
            raise ValueError(f"entry {key!r} must have shape ({rows}, ...), got {shape}")
        self.entries[key] = value

    def __delitem__(self, key: Any) -> None:
        """Remove an entry."""
        path = key if isinstance(key, tuple) else (key,)
        owner = self[path[:-1]] if len(path) > 1 else self
        del owner.entries[path[-1]]

    def __contains__(self, key: object) -> bool:
        """Whether there is an entry of this name or path."""
        path = key if isinstance(key, tuple) else (key,)
        entry: Any = self
        for name in path:
            if not isinstance(entry, TensorMapping) or name not in entry.entries:
                return False
            entry = entry.entries[name]
        return True

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of this level."""
        return iter(self.entries)

    def __len__(self) -> int:
        """Return the number of names of this level."""
        return len(self.entries)

    def keys(  # type: ignore[override]
        self, include_nested: bool = False, leaves_only: bool = False
    ) -> KeysView[str] | Collection[str | tuple[str, ...]]:
        """Return names; with `include_nested` also paths, as tuples, of all levels.

        Args:
            include_nested: Whether to include entries of nested mappings, after each mapping.
            leaves_only: Whether to leave out nested mappings themselves.
        """
        if not include_nested and not leaves_only:
            return self.entries.keys()
        return [key for key, _ in self._walk(include_nested, leaves_only)]

    def items(  # type: ignore[override]
        self, include_nested: bool = False, leaves_only: bool = False
    ) -> ItemsView[str, Any] | list[tuple[Any, Any]]:
        """Return (name, entry) pairs; see `keys`."""
        if not include_nested and not leaves_only:
            return self.entries.items()
        return list(self._walk(include_nested, leaves_only))

    def values(  # type: ignore[override]
        self, include_nested: bool = False, leaves_only: bool = False
    ) -> Collection[Any]:
        """Return the entries; see `keys`."""
        if not include_nested and not leaves_only:
            return self.entries.values()
        return [value for _, value in self._walk(include_nested, leaves_only)]

    def _walk(self, nested: bool, leaves: bool) -> Iterator[tuple[Any, Any]]:
        for name, value in self.entries.items():
            is_mapping = isinstance(value, TensorMapping)
            if not (is_mapping and leaves):
                yield name, value
            if is_mapping and nested:
                for key, leaf in value.items(True, leaves):
                    path = key if isinstance(key, tuple) else (key,)
                    yield (name, *path), leaf

    def set(self, key: Any, value: Any) -> TensorMapping:
        """Set an entry by name or path; returns this mapping."""
        self[key] = value
        return self

    # -- as a tensor ---------------------------------------------------------------------------

    @property
    def shape(self) -> torch.Size:
        """The batch size."""
        return self.batch_size

    @property
    def device(self) -> torch.device | None:
        """Device of the first tensor, or None without tensors."""
        return next((leaf.device for _, leaf in leaves_of(self)), None)

    def _each(self, change: Callable[[Any], Any]) -> TensorMapping:
        """Apply a function to every tensor; returns a mapping with the same names."""
        changed = {
            name: value._each(change) if isinstance(value, TensorMapping) else change(value)
            for name, value in self.entries.items()
        }
        result = TensorMapping(batch_size=self.batch_size)
        result.batch_size = torch.Size(
            next((tuple(leaf.shape[:1]) for _, leaf in leaves_of(changed)), self.batch_size)
        )
        result._entries = changed
        return result

    def to(self, *args: Any, **kwargs: Any) -> TensorMapping:
        """Apply `torch.Tensor.to` to every tensor."""
        return self._each(lambda tensor: tensor.to(*args, **kwargs))

    def cpu(self) -> TensorMapping:
        """Return the tensors on the CPU."""
        return self._each(lambda tensor: tensor.cpu())

    def detach(self) -> TensorMapping:
        """Apply `torch.Tensor.detach` to every tensor."""
        return self._each(lambda tensor: tensor.detach())

    def clone(self, recurse: bool = True) -> TensorMapping:
        """Return a copy; without `recurse` its levels are new and its tensors shared."""
        if recurse:
            return self._each(lambda tensor: tensor.clone())
        return self._each(lambda tensor: tensor)

    def to_dict(self) -> dict[str, Any]:
        """Return nested dicts of the same tensors."""
        return {
            name: value.to_dict() if isinstance(value, TensorMapping) else value
            for name, value in self.entries.items()
        }

    def to_tensordict(self) -> TensorDict:
        """Return a `TensorDict` of the same tensors; imports tensordict."""
        from tensordict import TensorDict

        return TensorDict(self.to_dict(), batch_size=self.batch_size)

    def __repr__(self) -> str:
        """Return names, shapes and types."""
        parts = [
            f"{'/'.join(path)}: {tuple(leaf.shape)} {leaf.dtype}" for path, leaf in leaves_of(self)
        ]
        return f"{type(self).__name__}({', '.join(parts)})"


def leaves_of(entries: Mapping[Any, Any]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield path and value of all leaves of nested mappings."""
    for name, value in entries.items():
        if isinstance(value, Mapping):
            for path, leaf in leaves_of(value):
                yield (name, *path), leaf
        else:
            yield (name,), value
