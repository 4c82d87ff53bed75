"""Puts the arguments of calls where another process finds them: in a slab, or pickled."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np

from embodichain.recording.handover import PICKLED, Call, Slab

__all__ = ["placed", "put"]

_PLAIN = frozenset({int, float, bool, str, type(None)})
_NUMBERS = frozenset("?bBhHiIlLqQefd")
"""Kinds of arrays whose bytes are all there is to them."""


def placed(
    slab: Slab, limit: int, method: str, args: tuple[object, ...], places: tuple[object, ...]
) -> Call:
    """A call as it is handed over: what is no number and no text lies in the slab, or is pickled.

    Args:
        slab: Where arrays go.
        limit: Bytes of it that may be used; arrays that do not fit are pickled.
        method: The method.
        args: Its arguments.
        places: Of arguments that lie in the slab already.
    """
    kept: list[object] | None = None
    found: list[object] = []
    at = slab.at
    for index, arg in enumerate(args):
        if type(arg) in _PLAIN:
            continue
        if kept is None:
            kept, found = list(args), list(places)
        kept[index] = None
        if type(arg) is np.ndarray and (kind := arg.dtype.char) in _NUMBERS:
            end = at + arg.nbytes
            if end <= limit:
                buffer: Any = arg if arg.flags.c_contiguous else np.ascontiguousarray(arg)
                slab.memory[at:end] = buffer
                found += (index, at, kind, arg.shape)
                at = end + 7 & ~7
                continue
        found += (index, 0, PICKLED, pickle.dumps(arg, 5))
    slab.at = at
    return (method, args, places) if kept is None else (method, tuple(kept), tuple(found))


def put(slab: Slab, content: bytes) -> int:
    """Copy bytes behind what is in a slab; where they begin."""
    at = slab.at
    slab.memory[at : at + len(content)] = content
    slab.at = at + len(content)
    return at
