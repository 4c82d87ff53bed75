"""`ArrayPacker` and `HostBuffers`: many arrays of a device in one copy to the host.

Importing this module imports torch.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.engine.device.device_values import NUMPY_TYPES

__all__ = ["ArrayPacker", "HostBuffers", "Slot"]

T = TypeVar("T")
_WORD = np.dtype(np.int32)
_MOST_WAITING = 2
"""Copies on their way: while one is read, the device writes the other."""


class Slot(NamedTuple):
    """Where an array is in packed words of 4 bytes.

    Attributes:
        offset: Its first word.
        shape: Lengths of its axes.
        dtype: Type of its numbers; flags and bytes take a word each.
    """

    offset: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @property
    def words(self) -> int:
        """Number of words."""
        return math.prod(self.shape) * max(1, self.dtype.itemsize // _WORD.itemsize)

    def read(self, words: NDArray[np.int32]) -> NDArray[Any]:
        """Return a copy of the array.

        Args:
            words: All packed words.
        """
        part = words[self.offset : self.offset + self.words].copy()
        is_widened = self.dtype.itemsize < _WORD.itemsize
        array: NDArray[Any] = part.astype(self.dtype) if is_widened else part.view(self.dtype)
        return array.reshape(self.shape)


class ArrayPacker:
    """Gathers arrays of a device; it launches kernels, and never waits for the device.

    Which kernels depends on shapes and types only, so that they can be part of a CUDA graph.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget what was added."""
        self._parts: list[torch.Tensor] = []
        self._size = 0

    def add(self, tensor: torch.Tensor, *, live: bool = False) -> Slot:
        """Add an array.

        Args:
            tensor: Its numbers: float32, float64, int32, int64, uint8 or bool.
            live: Whether they may change before `pack`: they are copied now.
        """
        slot = Slot(self._size, tuple(tensor.shape), NUMPY_TYPES[tensor.dtype])
        words = tensor.detach()
        if words.element_size() < _WORD.itemsize:
            words = words.to(torch.int32)
        elif live or not words.is_contiguous():
            words = words.clone(memory_format=torch.contiguous_format)
        if slot.words:
            self._parts.append(words.reshape(-1).view(torch.int32))
        self._size += slot.words
        return slot

    def pack(self) -> torch.Tensor:
        """Return the arrays as words (n,) in new memory, and forget them.

        Raises:
            ValueError: If there are none.
        """
        if not self._parts:
            raise ValueError("there are no arrays to pack")
        packed = torch.cat(self._parts)
        self.clear()
        return packed


class _Sent(NamedTuple, Generic[T]):
    """Words on their way, and what is done with them."""

    about: T
    buffer: torch.Tensor
    size: int
    arrived: Any  # an event of CUDA; None if they are there


class HostBuffers(Generic[T]):
    """Copies packed words to the host, into pinned memory, without waiting for the device.

    Copies are launched on torch's current stream, after what has computed the words. At most two
    are on their way.

    Args:
        device: Where the words are.
    """

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._pinned = device.type == "cuda"
        none = torch.empty(0, dtype=torch.int32)
        self._free = [none] * _MOST_WAITING
        self._sent: deque[_Sent[T]] = deque()

    @property
    def full(self) -> bool:
        """Whether the next copy needs that the oldest one has been read."""
        return not self._free

    def send(self, packed: torch.Tensor, about: T) -> None:
        """Launch a copy.

        Args:
            packed: (n,) words.
            about: Returned by `receive` with the words.

        Raises:
            ValueError: If two copies are on their way.
        """
        if self.full:
            raise ValueError("both buffers are in use: receive a copy first")
        buffer = self._free.pop()
        size = packed.numel()
        if buffer.numel() < size:
            buffer = torch.empty(size, dtype=torch.int32, pin_memory=self._pinned)
        buffer[:size].copy_(packed, non_blocking=True)
        arrived = None
        if self._pinned:
            arrived = torch.cuda.Event()  # type: ignore[no-untyped-call]
            arrived.record(torch.cuda.current_stream(self._device))
        self._sent.append(_Sent(about, buffer, size, arrived))

    def receive(self, slots: Sequence[Slot], *, wait: bool) -> list[NDArray[Any]] | None:
        """Return arrays of the oldest copy as copies, and free its buffer.

        Args:
            slots: Where the arrays are.
            wait: Whether to wait for the device; else None is returned if the words are not there.
        """
        oldest = self._sent[0]
        if oldest.arrived is not None:
            if not wait and not oldest.arrived.query():
                return None
            oldest.arrived.synchronize()
        words = oldest.buffer[: oldest.size].numpy()
        arrays = [slot.read(words) for slot in slots]
        self._sent.popleft()
        self._free.append(oldest.buffer)
        return arrays

    @property
    def oldest(self) -> T | None:
        """What the oldest copy on its way is about; None if there is none."""
        return self._sent[0].about if self._sent else None
