"""Which episodes of a log become demonstrations: what `hdf5` and `lerobot` write one by one."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.api import Log
from embodichain.recording.episodes import LogEpisode
from embodichain.recording.export.formats import Part
from embodichain.utils.errors import ConfigError

__all__ = ["demonstrations"]

_log = logging.getLogger(__name__)


def demonstrations(log: Log, part: Part) -> list[tuple[LogEpisode, range]]:
    """Return episodes and the steps of them that are meant, by environment, then in time.

    With `record.every` a log tells of episodes whose steps it has in part or not at all. They are
    left out, since a demonstration has no gaps, and their number is logged.

    Raises:
        ConfigError: There is none.
    """
    chosen = [(episode, steps) for episode in log.episodes if (steps := part.steps_of(episode))]
    if log.header.every > 1 and chosen:
        recorded = log.read(()).steps
        count = len(chosen)
        chosen = [(episode, steps) for episode, steps in chosen if _has_all(recorded, steps)]
        why = f"record.every={log.header.every} did not record all of their steps"
        if not chosen:
            raise ConfigError(f"none of {count} episodes is whole: {why}")
        if len(chosen) < count:
            _log.warning("%d of %d episodes are left out: %s", count - len(chosen), count, why)
    if not chosen:
        raise ConfigError("no episode lies in what was asked for")
    return chosen


def _has_all(recorded: NDArray[np.int64], steps: range) -> bool:
    first, end = np.searchsorted(recorded, [steps.start, steps.stop]).tolist()
    return bool(end - first == len(steps))
