"""`TermRows`: values of terms by name, as tensors that are made when they are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.utils.arrays import tensor_of

if TYPE_CHECKING:
    import torch

__all__ = ["TermRows"]


class TermRows(Mapping[str, "torch.Tensor"]):
    """Name -> (N,) tensor, a copy of a row.

    Args:
        names: Names of the T terms.
        rows: (T, N), or T arrays (N,); never written to afterwards.

    Attributes:
        names: Names of the terms.
        rows: Values of the terms; writing to returned tensors does not change them.
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
            found = self._tensors[name] = tensor_of(self.rows[row].copy())
        return found

    def zeroed(self, rows: NDArray[np.bool_]) -> TermRows:
        """Return the values with those of some environments, (N,) bool, set to 0."""
        if isinstance(self.rows, (list, tuple)):
            return TermRows(
                self.names, [np.where(rows, row.dtype.type(0), row) for row in self.rows]
            )
        return TermRows(self.names, np.where(rows, np.float32(0.0), self.rows))

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names."""
        return iter(self.names)

    def __len__(self) -> int:
        """Return the number of terms."""
        return len(self.names)

    def __repr__(self) -> str:
        """Return names and values."""
        return f"TermRows({dict(self)})"
