"""`TermRows`: values of several terms by name, made tensors when they are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np

if TYPE_CHECKING:
    import torch
else:
    torch = lazy_loader.load("torch")

__all__ = ["TermRows"]


class TermRows(Mapping[str, "torch.Tensor"]):
    """Name -> (N,) tensor, a copy of a row.

    Args:
        names: Of the terms, T of them.
        rows: (T, N), or T arrays (N,); never written to afterwards.

    Attributes:
        names: Those.
        rows: Those; tensors that were read and changed since do not change them.
    """

    __slots__ = ("_tensors", "names", "rows")

    def __init__(self, names: Sequence[str], rows: Any = ()) -> None:
        self.names, self.rows = names, rows
        self._tensors: dict[str, torch.Tensor] = {}

    def __getitem__(self, name: str) -> torch.Tensor:
        """Return a term's values; the same tensor at every call."""
        found = self._tensors.get(name)
        if found is None:
            try:
                row = self.names.index(name)
            except ValueError:
                raise KeyError(name) from None
            found = self._tensors[name] = torch.from_numpy(np.array(self.rows[row]))
        return found

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names."""
        return iter(self.names)

    def __len__(self) -> int:
        """Return the number of terms."""
        return len(self.names)

    def __repr__(self) -> str:
        """Return names and values."""
        return f"TermRows({dict(self)})"
