"""`Attempts`: which episodes a collection needs, independent of the order in which they end.

A collection of W successes consists of the attempts 0 to G-1 with the smallest G for which W of
them succeed. It depends neither on the number of environments nor on how often it was interrupted,
and long episodes are as likely in it as short ones: taking the first W successes to end, of
environments that step together, would favour short ones.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Iterable

__all__ = ["Attempts"]


class Attempts:
    """Numbers of attempts: those running, those finished, and those still needed.

    Args:
        wanted: W, successes.
        succeeded: Attempts that succeeded before, when the collection is resumed.
        failed: Attempts that failed before.
    """

    def __init__(
        self, wanted: int, succeeded: Iterable[int] = (), failed: Iterable[int] = ()
    ) -> None:
        self.wanted = wanted
        self._succeeded = set(succeeded)
        self._begun = self._succeeded | set(failed)
        self._possible = sorted(self._succeeded)  # attempts that succeeded or are running
        self._next = 0

    @property
    def complete(self) -> bool:
        """Whether W attempts succeeded and no attempt with a lower number is running."""
        first = self._possible[: self.wanted]
        return len(first) == self.wanted and self._succeeded.issuperset(first)

    def begin(self) -> int:
        """Return the number of the next attempt, the lowest one that was not begun."""
        while self._next in self._begun:
            self._next += 1
        number = self._next
        self._begun.add(number)
        insort(self._possible, number)
        return number

    def end(self, number: int, success: bool) -> None:
        """Note how a running attempt ended."""
        if success:
            self._succeeded.add(number)
        else:
            del self._possible[bisect_left(self._possible, number)]

    def is_needed(self, number: int) -> bool | None:
        """Whether an attempt that ended belongs to the collection.

        Returns:
            None if that depends on attempts that are running. They decide later: an attempt
            is needed as soon as fewer than W of the lower ones can succeed, and it is not once
            W of them did.
        """
        possible_before = bisect_left(self._possible, number)
        if possible_before < self.wanted:
            return True
        if self.complete:
            return False
        return None
