"""`Outbox`: messages that wait for a viewer; a slow one loses the oldest, not the run its time."""

from __future__ import annotations

import threading
from collections import Counter, deque

__all__ = ["Outbox"]


class Outbox:
    """Messages for one viewer, in order; one thread puts them in, another takes them out.

    A message has a key, such as its topic. Beyond the limits, the oldest message is dropped that a
    later one with the same key replaces: the newest of each key is always sent.

    Args:
        most: Number of messages that may wait.
        most_bytes: Their size together.

    Attributes:
        dropped: Number of messages that were dropped.
    """

    def __init__(self, most: int = 1024, most_bytes: int = 32 << 20) -> None:
        self._most = most
        self._most_bytes = most_bytes
        self._waiting: deque[tuple[object, str | bytes]] = deque()
        self._counts: Counter[object] = Counter()
        self._bytes = 0
        self._lock = threading.Lock()
        self.dropped = 0

    def put(self, key: object, message: str | bytes) -> None:
        """Add a message; drop older ones if there are too many.

        Args:
            key: Its subject, such as a topic; a message without one (None) is never dropped.
            message: Text or bytes.
        """
        with self._lock:
            self._waiting.append((key, message))
            self._counts[key] += 1
            self._bytes += len(message)
            while len(self._waiting) > self._most or self._bytes > self._most_bytes:
                if not self._drop():
                    break

    def take(self) -> str | bytes | None:
        """Remove and return the oldest message; None if there is none."""
        with self._lock:
            if not self._waiting:
                return None
            key, message = self._waiting.popleft()
            self._counts[key] -= 1
            self._bytes -= len(message)
            return message

    def forget(self, key: object) -> None:
        """Drop all messages with a key, to which nothing is subscribed any more."""
        with self._lock:
            self._waiting = deque(pair for pair in self._waiting if pair[0] != key)
            self._counts[key] = 0
            self._bytes = sum(len(message) for _, message in self._waiting)

    def _drop(self) -> bool:
        """Drop the oldest message that a later one replaces; return whether there was one."""
        for index, (key, message) in enumerate(self._waiting):
            if key is not None and self._counts[key] > 1:
                del self._waiting[index]
                self._counts[key] -= 1
                self._bytes -= len(message)
                self.dropped += 1
                return True
        return False
