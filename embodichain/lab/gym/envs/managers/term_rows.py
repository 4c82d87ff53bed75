"""`TermRows`: values of terms by name that lie together, so that all can be read at once."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import lazy_loader
from numpy.typing import NDArray

if TYPE_CHECKING:
    import torch
else:
    torch = lazy_loader.load("torch")

__all__ = ["TermRows"]


class TermRows(dict[str, "torch.Tensor"]):
    """Name -> (N,) tensor: a row of one array.

    Args:
        names: Of the terms, T of them.
        rows: (T, N), whose memory the tensors share.

    Attributes:
        names: Those, the same object.
        rows: That array. Do not write; it knows nothing of tensors put in later.
    """

    def __init__(self, names: Iterable[str], rows: NDArray[Any]) -> None:
        super().__init__(zip(names, torch.from_numpy(rows).unbind(), strict=True))
        self.names, self.rows = names, rows
