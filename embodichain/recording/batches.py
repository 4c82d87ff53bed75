"""`Batches`: carries out calls that were handed over (`placing`), in the process that writes.

Control steps made of the same calls, one after another, are found here and offered together; what
calls mean is not known here.
"""

from __future__ import annotations

import marshal
import mmap
import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.handover import PICKLED

__all__ = ["AlikeCalls", "AlikeSteps", "Aside", "Batches", "unpickled"]

_MOST_BYTES = 2**20
"""Of arrays of steps that are offered together: they should stay in the cache."""
_LARGE_BYTES = 2**17
"""Steps with more cost what their bytes cost, together or not, and stay in it one by one."""


@dataclass(frozen=True, slots=True, eq=False)
class AlikeCalls:
    """Calls that differ in nothing but numbers in arrays.

    Attributes:
        name: The method's name.
        method: The method.
        args: Its arguments before the arrays.
        fields: Type, shape and offset of each array.
    """

    name: str
    method: Callable[..., None]
    args: tuple[Any, ...]
    fields: tuple[tuple[np.dtype[Any], tuple[int, ...], int], ...]

    def arrays(self, memory: mmap.mmap, at: int) -> list[NDArray[Any]]:
        """The arrays of the call at an offset."""
        return [np.ndarray(s, kind, memory, at + a) for kind, s, a in self.fields]


@dataclass(frozen=True, slots=True)
class Aside:
    """A call among those of a step that other calls do not depend on.

    Attributes:
        step: Number of the step, among those that are alike.
        after: How many of the step's own calls come before it.
        method: The method.
        args: Its arguments.
    """

    step: int
    after: int
    method: Callable[..., None]
    args: Sequence[Any]

    def carry_out(self) -> None:
        """Do it."""
        self.method(*self.args)


@dataclass(frozen=True, slots=True)
class AlikeSteps:
    """Control steps that are made of the same calls.

    Attributes:
        calls: Those of a step.
        count: How many steps there are.
        at: Where the arrays of the first step's calls lie.
        stride: Bytes from a step's arrays to the next one's.
        memory: Where they lie.
        asides: What came between, in order.
    """

    calls: tuple[AlikeCalls, ...]
    count: int
    at: tuple[int, ...]
    stride: int
    memory: mmap.mmap
    asides: Sequence[Aside]

    def arrays(self, index: int, count: int) -> list[NDArray[Any]]:
        """(count, ...) arrays of a call, of the first so many steps."""
        found = []
        for kind, shape, offset in self.calls[index].fields:
            one = np.ndarray(shape, kind, self.memory, self.at[index] + offset)
            steps = (count, *shape), one.dtype, self.memory, self.at[index] + offset
            found.append(np.ndarray(*steps, (self.stride, *one.strides)))
        return found


@dataclass(slots=True)
class _Step:
    """Calls of a batch up to one that ends a step.

    Attributes:
        end: Index of the first call after them.
        at: Where their arrays lie.
        calls: Number of each one's form, and how far behind the first one's its arrays lie; None if
            some have no form.
        asides: How many of them come before a call that stands aside, and that one's index.
    """

    end: int
    at: list[int]
    calls: list[tuple[int, int]] | None
    asides: list[tuple[int, int]]


class Batches:
    """The calls of a log.

    Args:
        methods: What may be called, by name.
        ends_step: Name of the method that ends a control step.
        aside: What names begin with of methods that others do not depend on.
        together: Called with steps that are alike; says how many of them it has carried out, or
            None if it does not carry out any such steps.
        give_way: Called before every call that is carried out, or every such steps.
    """

    def __init__(
        self,
        methods: Mapping[str, Callable[..., None]],
        ends_step: str,
        aside: str,
        together: Callable[[AlikeSteps], int | None],
        give_way: Callable[[], None],
    ) -> None:
        self._methods = methods
        self._ends_step, self._aside, self._together = ends_step, aside, together
        self._give_way = give_way
        self._forms: dict[int, AlikeCalls] = {}

    def carry_out(self, content: bytes, memory: mmap.mmap) -> None:
        """Carry out a batch, whose arrays lie in memory."""
        forms, calls = marshal.loads(content)
        for number, name, args, fields in forms:
            kept = tuple((np.dtype(kind), shape, at) for kind, shape, at in fields)
            self._forms[number] = AlikeCalls(name, self._methods[name], args, kept)
        steps = [] if self._are_large(calls) else self._steps(calls)
        index = done = 0
        while index < len(steps):
            alike = _alike(steps, index)
            count: int | None = 0
            if alike > 1:
                self._give_way()
                found = self._offered(steps[index : index + alike], calls, memory)
                count = self._together(found)
            if not count:
                count = alike if count is None else 1
                for call in calls[done : steps[index + count - 1].end]:
                    self._carry_out(call, memory)
            index += count
            done = steps[index - 1].end
        for call in calls[done:]:
            self._carry_out(call, memory)

    def _carry_out(self, call: tuple[Any, ...], memory: mmap.mmap) -> None:
        self._give_way()
        if type(call[0]) is int:
            number, at = call
            form = self._forms[number]
            form.method(*form.args, *form.arrays(memory, at))
        else:
            name, args, places = call
            self._methods[name](*(_found(memory, args, places) if places else args))

    def _are_large(self, calls: list[Any]) -> bool:
        """Whether steps have so many bytes that they are not taken together."""
        ends = (
            at
            for name, at, *_ in calls
            if type(name) is int and self._forms[name].name == self._ends_step
        )
        first = next(ends, 0)
        return next(ends, first) - first >= _LARGE_BYTES

    def _steps(self, calls: list[Any]) -> list[_Step]:
        """The control steps that end in a batch."""
        steps: list[_Step] = []
        numbers, at, asides, known = list[int](), list[int](), list[tuple[int, int]](), True
        for index, call in enumerate(calls):
            name = call[0]
            if type(name) is int:
                numbers.append(name)
                at.append(call[1])
                name = self._forms[name].name
            elif name.startswith(self._aside):
                asides.append((len(at), index))
            else:
                known = False
            if name == self._ends_step:
                found = [(n, a - at[0]) for n, a in zip(numbers, at, strict=True)]
                steps.append(_Step(index + 1, at, found if known else None, asides))
                numbers, at, asides, known = [], [], [], True
        return steps

    def _offered(self, steps: list[_Step], calls: list[Any], memory: mmap.mmap) -> AlikeSteps:
        """Steps that are alike as they are offered: two at least."""
        asides = []
        for k, step in enumerate(steps):
            for after, index in step.asides:
                name, args, places = calls[index]
                found = _found(memory, args, places) if places else args
                asides.append(Aside(k, after, self._methods[name], found))
        first = steps[0]
        forms = tuple(self._forms[number] for number, _ in first.calls or ())
        stride = steps[1].at[0] - first.at[0]
        return AlikeSteps(forms, len(steps), tuple(first.at), stride, memory, asides)


def _alike(steps: list[_Step], index: int) -> int:
    """How many steps from this one on are alike, and their arrays equally far apart."""
    first = steps[index]
    if first.calls is None or index + 1 == len(steps) or not steps[index + 1].at:
        return 1
    begin = first.at[0]
    stride = steps[index + 1].at[0] - begin
    most = _MOST_BYTES // stride if 0 < stride < _LARGE_BYTES else 1
    most = min(most, len(steps) - index)
    count = 1
    while count < most:
        step = steps[index + count]
        if step.calls != first.calls or step.at[0] != begin + count * stride:
            break
        count += 1
    return count


def _found(memory: mmap.mmap, args: tuple[object, ...], places: tuple[Any, ...]) -> list[object]:
    """Arguments of a call with those that lie in memory, or are pickled."""
    values = list(args)
    for k in range(0, len(places), 4):
        index, at, kind, shape = places[k : k + 4]
        if kind == PICKLED:
            values[index] = unpickled(shape)
        else:
            values[index] = np.ndarray(shape, kind, memory, at)
    return values


def unpickled(data: bytes) -> Any:
    """Content of an order: it comes from the process that started this one, from nowhere else."""
    return pickle.loads(data)  # noqa: S301
