"""`SlabPool`: the slabs of a log, used again and again, and how many there may be.

Who is told of a new one is not known here.
"""

from __future__ import annotations

from collections.abc import Callable

from embodichain.recording.handover import Slab

__all__ = ["SlabPool", "slab_bytes_for"]

_LEAST_BYTES = 4 * 2**20
_STEPS, _MANY_BYTES = 16, 16 * 2**20
"""A slab is larger, but no larger than that, to hold some steps: handing one over takes 0.15 ms."""


def slab_bytes_for(step_bytes: int) -> int:
    """How large slabs should be where a step takes so much at most."""
    return max(_LEAST_BYTES, step_bytes, min(_STEPS * step_bytes, _MANY_BYTES))


class SlabPool:
    """Slabs of one size, and larger ones for what does not fit.

    Args:
        slab_bytes: How large a slab is.
        budget: Bytes of all that may wait for the disk; one slab is had in any case.
        new_number: Returns a name for a slab.

    Attributes:
        away: Bytes that the other process has.
        slab_bytes: How large a slab is.
    """

    def __init__(self, slab_bytes: int, budget: int, new_number: Callable[[], int]) -> None:
        self.slab_bytes = _pages(slab_bytes)
        self.away = 0
        self._budget = max(budget, 4 * self.slab_bytes)
        self._new_number = new_number
        self._made_bytes = 0
        self._made: dict[int, Slab] = {}
        self._free: list[Slab] = []

    @property
    def any_free(self) -> bool:
        """Whether there is one of the usual size that nobody uses."""
        return bool(self._free)

    def take(self, nbytes: int, held: bool) -> Slab | None:
        """A slab that nobody uses; None if there are too many on their way.

        Args:
            nbytes: How much it has to hold.
            held: Whether the caller has another one.
        """
        size = self.slab_bytes if nbytes <= self.slab_bytes else _pages(nbytes)
        if size == self.slab_bytes and self._free:
            slab = self._free.pop()
            slab.at = 0
            return slab
        used = len(self._made) - len(self._free) - held
        return self.make(size) if self._made_bytes + size <= self._budget or not used else None

    def make(self, nbytes: int) -> Slab:
        """A new slab, however many there are."""
        slab = Slab(self._new_number(), _pages(nbytes))
        self._made_bytes += slab.size
        self._made[slab.number] = slab
        return slab

    def take_back(self, number: int) -> None:
        """The other process is done with a slab."""
        slab = self._made[number]
        self.away -= slab.at
        self.put_back(slab)

    def put_back(self, slab: Slab) -> None:
        """Nobody uses a slab any more."""
        if slab.size == self.slab_bytes:
            self._free.append(slab)
        else:
            del self._made[slab.number]
            self._made_bytes -= slab.size

    def clear(self) -> None:
        """Let go of all memory."""
        self._free.clear()
        self._made.clear()


def _pages(nbytes: int) -> int:
    return -(-nbytes // 4096) * 4096
