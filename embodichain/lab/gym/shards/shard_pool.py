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
_MOST_RESTARTS = 6
"""How often a shard that cannot start is started once more."""
_FIRST_PAUSE = 0.5
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
class _Record:
    """A running shard, and what it is rebuilt from.

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
        self.steps = 0
        self.rebuilt: list[dict[str, Any]] = []
        self._source = source
        self._save_every = save_every
        self._saved_at_step = 0
        self._log_of: Callable[[int, int], Any] | None = None
        self._records = [_Record(self._start(k)) for k in range(len(self.counts))]

    @property
    def nodes(self) -> list[str]:
        """Where each shard runs."""
        return [record.handle.node for record in self._records]

    def record(self, log_of: Callable[[int, int], Any]) -> None:
        """Record every shard from now on.

        Args:
            log_of: Function from the index of a shard, and how often it was rebuilt, to its
                `ShardLog`.
        """
        pending_calls = [
            record.handle.call("record", log_of(k, 0)) for k, record in enumerate(self._records)
        ]
        self._log_of = log_of
        for k, pending in enumerate(pending_calls):
            try:
                pending.result()
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
        # All shards begin before the first result is waited for.
        pending_calls: list[Pending] = []
        for record, shard_args in zip(self._records, args, strict=True):
            record.calls.append(_Call(method, shard_args))
            pending_calls.append(record.handle.call(method, *shard_args))
        results: list[Any] = []
        for k, pending in enumerate(pending_calls):
            try:
                results.append(pending.result())
            except ShardLostError as error:
                results.append(self._rebuild(k, error))
        if steps:
            self.passed(steps)
        return results

    def passed(self, steps: int) -> None:
        """Count control steps; save all shards if it is time."""
        self.steps += steps
        if self.steps - self._saved_at_step >= self._save_every:
            self._save()

    def load(self, states: Sequence[Any]) -> None:
        """Let every shard continue from a state."""
        self.call("load", [(state,) for state in states])

    def _save(self) -> None:
        """Store the state of every shard, in place of the one before and the calls since then."""
        pending_calls = [record.handle.call("save") for record in self._records]
        for k, (record, pending) in enumerate(zip(self._records, pending_calls, strict=True)):
            try:
                saved = pending.result()
            except ShardLostError as error:
                self._rebuild(k, error)
                saved = record.handle.call("save").result()
            record.saved = saved
            record.calls = []
        self._saved_at_step = self.steps

    def _rebuild(self, k: int, error: ShardLostError) -> Any:
        """Build a shard again; return the result of its last call."""
        record = self._records[k]
        first_env = self.firsts[k]
        last_env = first_env + self.counts[k] - 1
        name = f"shard {k} (environments {first_env} to {last_env})"
        for _ in range(MOST_LOSSES):
            lost_node = record.handle.node
            _log.warning("%s is lost on node %s: %s", name, lost_node, error)
            record.handle.end()
            record.losses += 1
            try:
                record.handle = self._start(k)
                result = self._repeat(k)
            except ShardLostError as another_error:
                error = another_error
                continue
            start_step = 0 if record.saved is None else self._saved_at_step
            self.rebuilt.append(
                {
                    "shard": k,
                    "lost_on": lost_node,
                    "rebuilt_on": record.handle.node,
                    "lost_at_step": self.steps,
                    "continued_from_step": start_step,
                }
            )
            _log.warning(
                "%s continues on node %s from its state at control step %d; %d steps were repeated",
                name,
                record.handle.node,
                start_step,
                self.steps - start_step,
            )
            return result
        raise ShardLostError(f"shard {k} was lost {MOST_LOSSES} times in one step: {error}")

    def _start(self, k: int) -> ShardHandle:
        """Start a shard; once more if its node dies, which takes Ray seconds to notice."""
        for attempt in range(_MOST_RESTARTS):
            try:
                return self._source.start(k)
            except ShardLostError as error:
                _log.warning("shard %d could not start: %s", k, error)
                time.sleep(_FIRST_PAUSE * 2**attempt)
        return self._source.start(k)

    def _repeat(self, k: int) -> Any:
        """Bring a new shard to where the lost one was."""
        record = self._records[k]
        place = None
        if record.saved is not None:
            place = record.saved["place"]
            record.handle.call("load", record.saved).result()
        if self._log_of is not None:
            record.handle.call("record", self._log_of(k, record.losses), place).result()
        result = None
        for method, args in record.calls:
            result = record.handle.call(method, *args).result()
        return result

    def close(self) -> None:
        """Close every shard and its log, then end its process.

        Raises:
            Exception: The first exception of a shard's `close`, after all were closed.
        """
        pending_calls = [record.handle.call("close") for record in self._records]
        first_error: Exception | None = None
        for k, (record, pending) in enumerate(zip(self._records, pending_calls, strict=True)):
            try:
                self._wait_until_closed(k, pending)
            except Exception as error:  # noqa: BLE001  raised below, when the others are closed
                first_error = first_error or error
            finally:
                record.handle.end()
        if first_error is not None:
            raise first_error

    def _wait_until_closed(self, k: int, pending: Pending) -> None:
        """Wait until a shard is closed; one that is lost and has a log first completes the log."""
        try:
            pending.result()
        except ShardLostError as error:
            if self._log_of is None:
                _log.warning("shard %d was lost when it was closed: %s", k, error)
                return
            self._rebuild(k, error)
            self._records[k].handle.call("close").result()
