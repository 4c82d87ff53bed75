"""Calls that wait to be handed over, and where their arguments are found: in a slab, or pickled."""

from __future__ import annotations

import marshal
import pickle
from collections.abc import Hashable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.handover import PICKLED, Call, FormFields, FormTold, Slab

__all__ = ["Form", "WaitingCalls", "put"]

_PLAIN = frozenset({int, float, bool, str, type(None)})
_NUMBERS = frozenset("?bBhHiIlLqQefd")
"""Kinds of arrays whose bytes are all there is to them."""

CallKey = tuple[str, tuple[Hashable, ...]] | tuple[str, tuple[Hashable, ...], Hashable]


class Form:
    """What calls have in common that differ in nothing but numbers in arrays, and how those lie.

    Arguments of which bytes are not all there is to them have no form: nothing fits it.

    Args:
        number: Its name in batches.
        arrays: Those of any such call.

    Attributes:
        nbytes: What they take in a slab.
        fields: What the other process is told of them.
    """

    __slots__ = ("_spans", "fields", "nbytes", "number")

    def __init__(self, number: int, arrays: tuple[NDArray[Any], ...]) -> None:
        spans: list[tuple[np.dtype[Any], tuple[int, ...], int, int]] = []
        fields: list[tuple[str, tuple[int, ...], int]] = []
        at = 0
        for array in arrays:
            if type(array) is not np.ndarray or array.dtype.char not in _NUMBERS:
                spans, fields, at = [], [], 0
                break
            end = at + array.nbytes
            spans.append((array.dtype, array.shape, at, end))
            fields.append((array.dtype.char, array.shape, at))
            at = end + 7 & ~7
        self.number, self.nbytes = number, at
        self._spans = tuple(spans)
        self.fields: FormFields = tuple(fields)

    def fill(self, slab: Slab, arrays: tuple[NDArray[Any], ...]) -> bool:
        """Put arrays into a slab that has room for them; False if they are others."""
        at, memory = slab.at, slab.memory
        if len(arrays) != len(self._spans):
            return False
        for array, (dtype, shape, start, end) in zip(arrays, self._spans, strict=True):
            alike = type(array) is np.ndarray and array.dtype is dtype and array.shape == shape
            if not alike:
                return False
            if array.flags.c_contiguous:
                memory[at + start : at + end] = array  # type: ignore[call-overload]  # a buffer
            else:
                np.ndarray(shape, dtype, memory, at + start)[...] = array
        slab.at = at + self.nbytes
        return True


class WaitingCalls:
    """Calls that wait, most of them with arguments that are not placed yet.

    Attributes:
        waiting: The calls.
        new_forms: What the other process was not told of.
    """

    def __init__(self) -> None:
        self.waiting: list[Any] = []
        self.new_forms: list[FormTold] = []
        self._forms: dict[CallKey, Form] = {}

    def form(self, key: CallKey, arrays: tuple[NDArray[Any], ...]) -> Form:
        """The form of calls of a method with these arguments before the arrays.

        Args:
            key: The method, the arguments, and whatever else tells such calls apart.
            arrays: Those of one of them: what the form is made for if it is the first.
        """
        form = self._forms.get(key)
        if form is None:
            form = Form(len(self._forms), arrays)
            told = form.number, key[0], key[1], form.fields
            self.new_forms.append(told)  # twice does no harm
            self._forms[key] = form
        return form

    def add(self, method: str, args: tuple[object, ...], places: tuple[object, ...] = ()) -> None:
        """Have a call wait; `places` are those of arguments that lie in the slab already."""
        self.waiting.append((method, args, places))

    def packed(self, slab: Slab, limit: int) -> bytes:
        """A batch as it is handed over, of everything that waits.

        Args:
            slab: Where arrays go.
            limit: Bytes of it that may be used; arrays that do not fit are pickled.
        """
        calls = [
            call if type(call[0]) is int else _placed(slab, limit, *call) for call in self.waiting
        ]
        return marshal.dumps((self.new_forms, calls))


def _placed(
    slab: Slab, limit: int, method: str, args: tuple[object, ...], places: tuple[object, ...]
) -> Call:
    """A call as it is handed over: what is no number or text lies in the slab, or is pickled."""
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
