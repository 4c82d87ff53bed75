"""`ShardPool`: calls all shards of a batch, and rebuilds those that are lost.

The pool keeps the last saved state of every shard and the calls since then. A shard that is lost,
with its node or alone, is built again elsewhere: it loads that state and repeats those calls. As a
shard depends on nothing else, its next results are those that the lost one would have given.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

__all__ = ["Pending", "ShardHandle", "ShardLostError", "ShardPool", "ShardSource"]

_log = logging.getLogger(__name__)
_STARTS = 6
"""How often a shard that cannot start is started once more."""
_PAUSE = 0.5
"""Seconds before a shard is started once more; twice as long each time."""
MOST_LOSSES = 5
"""Losses of a shard in one call after which the run fails: its own code ends its process."""


class ShardLostError(Exception):
    """A shard is gone; its node or its process ended."""


class Pending(Protocol):
    """A call that is under way."""

    def result(self) -> Any:
        """Wait for the result.

        Raises:
            ShardLostError: If the shard is gone.
            Exception: Any exception of the called method.
        """


class ShardHandle(Protocol):
    """A `Shard` that runs elsewhere."""

    @property
    def node(self) -> str:
        """Where it runs, for messages."""
        ...

    def call(self, method: str, *args: Any) -> Pending:
        """Begin to call a method of the shard; calls run in their order."""
        ...

    def end(self) -> None:
        """End its process; may be called for a shard that is gone."""


class ShardSource(Protocol):
    """Starts shards."""

    def start(self, index: int) -> ShardHandle:
        """Start the shard of this index, anew if it ran before."""
        ...


class _Call(NamedTuple):
    method: str
    args: tuple[Any, ...]


@dataclass(slots=True)
class _Kept:
    """What a shard is rebuilt from.

    Attributes:
        handle: The running shard.
        saved: Its last saved state; None before the first.
        calls: The calls since then.
        losses: How often it was rebuilt.
    """

    handle: ShardHandle
    saved: Any = None
    calls: list[_Call] = field(default_factory=list)
    losses: int = 0


class ShardPool:
    """The running shards of a batch.

    Args:
        source: Starts them.
        counts: Environments of each shard, in order.
        save_every: Control steps between two saved states.

    Attributes:
        counts: Environments of each shard.
        firsts: First environment of each shard.
        steps: Control steps taken.
        rebuilt: For each rebuilt shard, a record of what was lost and repeated, in order.
    """

    def __init__(self, source: ShardSource, counts: Sequence[int], save_every: int) -> None:
        self.counts = tuple(counts)
        self.firsts = tuple(sum(self.counts[:k]) for k in range(len(self.counts)))
        self.steps = self._saved_at = 0
        self.rebuilt: list[dict[str, Any]] = []
        self._source, self._every = source, save_every
        self._log_of: Callable[[int, int], Any] | None = None
        self._kept = [_Kept(self._start(k)) for k in range(len(self.counts))]

    @property
    def nodes(self) -> list[str]:
        """Where each shard runs."""
        return [kept.handle.node for kept in self._kept]

    def record(self, log_of: Callable[[int, int], Any]) -> None:
        """Record every shard from now on.

        Args:
            log_of: Function from the index of a shard, and how often it was rebuilt, to its
                `ShardLog`.
        """
        pending = [kept.handle.call("record", log_of(k, 0)) for k, kept in enumerate(self._kept)]
        self._log_of = log_of
        for k, one in enumerate(pending):
            try:
                one.result()
            except ShardLostError as error:
                self._rebuild(k, error)

    def call(self, method: str, args: Sequence[tuple[Any, ...]], steps: int = 0) -> list[Any]:
        """Call a method of every shard; return the results in the order of the shards.

        Args:
            method: Its name.
            args: The arguments for each shard.
            steps: Control steps that the call takes.

        Raises:
            Exception: Any exception of the method.
            ShardLostError: If a shard is lost again and again.
        """
        pending = []
        for kept, mine in zip(self._kept, args, strict=True):
            kept.calls.append(_Call(method, mine))
            pending.append(kept.handle.call(method, *mine))
        results = []
        for k, one in enumerate(pending):
            try:
                results.append(one.result())
            except ShardLostError as error:
                results.append(self._rebuild(k, error))
        if steps:
            self.passed(steps)
        return results

    def passed(self, steps: int) -> None:
        """Count control steps; save all shards if it is time."""
        self.steps += steps
        if self.steps - self._saved_at >= self._every:
            self._save()

    def load(self, states: Sequence[Any]) -> None:
        """Let every shard continue from a state."""
        self.call("load", [(state,) for state in states])

    def _save(self) -> None:
        pending = [kept.handle.call("save") for kept in self._kept]
        for k, one in enumerate(pending):
            kept = self._kept[k]
            try:
                saved = one.result()
            except ShardLostError as error:
                self._rebuild(k, error)
                saved = kept.handle.call("save").result()
            kept.saved, kept.calls = saved, []
        self._saved_at = self.steps

    def _rebuild(self, k: int, error: ShardLostError) -> Any:
        """Build a shard again; return the result of its last call."""
        kept = self._kept[k]
        for _ in range(MOST_LOSSES):
            first, last = self.firsts[k], self.firsts[k] + self.counts[k] - 1
            what = f"shard {k} (environments {first} to {last})"
            _log.warning("%s is lost on node %s: %s", what, kept.handle.node, error)
            lost = kept.handle.node
            kept.handle.end()
            kept.losses += 1
            try:
                kept.handle = self._start(k)
                result = self._repeat(k)
            except ShardLostError as again:
                error = again
                continue
            since = self._saved_at if kept.saved is not None else 0
            self.rebuilt.append(
                {
                    "shard": k,
                    "lost_on": lost,
                    "rebuilt_on": kept.handle.node,
                    "lost_at_step": self.steps,
                    "continued_from_step": since,
                }
            )
            _log.warning(
                "%s continues on node %s from its state at control step %d; %d steps were repeated",
                *(what, kept.handle.node, since, self.steps - since),
            )
            return result
        raise ShardLostError(f"shard {k} was lost {MOST_LOSSES} times in one step: {error}")

    def _start(self, k: int) -> ShardHandle:
        """Start a shard; once more if its node dies, which takes Ray seconds to notice."""
        for attempt in range(_STARTS):
            try:
                return self._source.start(k)
            except ShardLostError as error:
                _log.warning("shard %d could not start: %s", k, error)
                time.sleep(_PAUSE * 2**attempt)
        return self._source.start(k)

    def _repeat(self, k: int) -> Any:
        """Bring a new shard to where the lost one was."""
        kept, result = self._kept[k], None
        place = None
        if kept.saved is not None:
            place = kept.saved["place"]
            kept.handle.call("load", kept.saved).result()
        if self._log_of is not None:
            kept.handle.call("record", self._log_of(k, kept.losses), place).result()
        for method, args in kept.calls:
            result = kept.handle.call(method, *args).result()
        return result

    def close(self) -> None:
        """Close every shard and its log, then end its process.

        Raises:
            Exception: The first exception of a shard's `close`, after all were closed.
        """
        pending = [kept.handle.call("close") for kept in self._kept]
        first: Exception | None = None
        for k, one in enumerate(pending):
            kept = self._kept[k]
            try:
                self._closed(k, one)
            except Exception as error:  # noqa: BLE001  raised below, when the others are closed
                first = first or error
            finally:
                kept.handle.end()
        if first is not None:
            raise first

    def _closed(self, k: int, pending: Pending) -> None:
        """Wait until a shard is closed; one that is lost and has a log first completes the log."""
        try:
            pending.result()
        except ShardLostError as error:
            if self._log_of is None:
                _log.warning("shard %d was lost when it was closed: %s", k, error)
                return
            self._rebuild(k, error)
            self._kept[k].handle.call("close").result()
