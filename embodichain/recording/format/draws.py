"""`EpisodeDraws`: what was drawn for the running episode of each environment.

The recorder gives it every event. When episodes end, it returns their numbers as `Drawn`, which
is in their message on the channel `/episode`.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.observers import EventRecord
from embodichain.utils.array_types import EnvIds, Floats

__all__ = ["Drawn", "EpisodeDraws"]

_MODES = ("startup", "reset", "delay")
"""Modes of events whose draws hold for an episode; the others fire within episodes."""


class Drawn(NamedTuple):
    """The draws of n episodes, as copies.

    Attributes:
        names: ``TERM.NAME`` of each of the K draws.
        widths: How many numbers each of them has.
        values: (n, sum of widths) numbers; 0 where a draw was not made.
        was_made: (n, K) whether the draw was made for the episode.
    """

    names: list[str]
    widths: list[int]
    values: Floats
    was_made: NDArray[np.bool_]

    @classmethod
    def none(cls, count: int) -> Drawn:
        """No draws, of `count` episodes."""
        return cls([], [], np.zeros((count, 0)), np.zeros((count, 0), np.bool_))


@dataclass(frozen=True, slots=True)
class _Draw:
    """A draw of an event, and its place in the tables of all draws.

    Attributes:
        name: ``TERM.NAME``.
        index: Its column in the table of flags.
        columns: Its columns in the table of numbers.
    """

    name: str
    index: int
    columns: slice

    @property
    def width(self) -> int:
        """How many numbers it has."""
        return self.columns.stop - self.columns.start


class EpisodeDraws:
    """The last draws of each environment by events that act when an episode begins.

    An environment is reset in the step that ends its episode, before observers are told of the
    step. So the events of the last reset wait until then: `of_ended` is asked first.

    Args:
        num_envs: Number of environments N.
        startup: Event to the draws (N, ...) by name that it made before there were observers.
    """

    def __init__(
        self, num_envs: int, startup: Mapping[str, Mapping[str, NDArray[Any]]] | None = None
    ) -> None:
        self._draws: dict[tuple[str, int], _Draw] = {}  # by name and width
        self._of_term: dict[str, list[int]] = {}  # columns of flags
        self._values: Floats = np.zeros((num_envs, 0))
        self._was_made: NDArray[np.bool_] = np.zeros((num_envs, 0), np.bool_)
        self._events: list[EventRecord] = []  # of the reset that goes on
        self._last_reset: list[EventRecord] = []
        for term, drawn in (startup or {}).items():
            self._put(_copy_of(EventRecord(term, "startup", None, drawn)))

    def add(self, event: EventRecord) -> None:
        """Take the draws of an event, if they hold for an episode."""
        if event.mode in _MODES:
            self._events.append(_copy_of(event))

    def end_reset(self) -> None:
        """Note that a reset is complete: the events since the last one belong to it."""
        self.settle()
        self._last_reset = self._events
        self._events = []

    def settle(self) -> None:
        """Put the draws of the last reset into the tables: no step that it ended is open."""
        for event in self._last_reset:
            self._put(event)
        self._last_reset = []

    def copy(self) -> EpisodeDraws:
        """A copy, for a recorder that continues between two steps."""
        self.settle()
        return copy.deepcopy(self)

    def of_ended(self, env_ids: EnvIds, *, were_reset: bool) -> Drawn:
        """The draws of the episodes that a step ended.

        Args:
            env_ids: (n,) their environments.
            were_reset: Whether the last reset has begun the episodes that follow.
        """
        if not were_reset:
            self.settle()
        drawn = Drawn(
            names=[draw.name for draw in self._draws.values()],
            widths=[draw.width for draw in self._draws.values()],
            values=self._values[env_ids],
            was_made=self._was_made[env_ids],
        )
        self.settle()
        return drawn

    def _put(self, event: EventRecord) -> None:
        rows: Any = slice(None) if event.env_ids is None else event.env_ids
        # A draw that the event has not made this time is not one of this episode.
        for index in self._of_term.get(event.term, ()):
            self._was_made[rows, index] = False
        for name, values in event.drawn.items():
            draw = self._draw_of(event.term, name, width=values.shape[1])
            self._values[rows, draw.columns] = values
            self._was_made[rows, draw.index] = True

    def _draw_of(self, term: str, name: str, width: int) -> _Draw:
        """The place of a draw; the first time, a new one."""
        key = (f"{term}.{name}", width)
        draw = self._draws.get(key)
        if draw is None:
            num_envs, start = self._values.shape
            draw = _Draw(key[0], index=len(self._draws), columns=slice(start, start + width))
            self._draws[key] = draw
            self._of_term.setdefault(term, []).append(draw.index)
            self._values = np.hstack([self._values, np.zeros((num_envs, width))])
            self._was_made = np.hstack([self._was_made, np.zeros((num_envs, 1), np.bool_)])
        return draw


def _copy_of(event: EventRecord) -> EventRecord:
    """A copy of an event, with draws (n, k) of float64."""
    drawn: dict[str, Floats] = {}
    for name, values in event.drawn.items():
        copied = np.array(values, np.float64)
        width = math.prod(copied.shape[1:])
        drawn[name] = copied.reshape(len(copied), width)
    ids = None if event.env_ids is None else event.env_ids.copy()
    return event._replace(env_ids=ids, drawn=drawn)
