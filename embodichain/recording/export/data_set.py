"""`DataSet`: the episodes that a format writes, with the task's observations."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.observed_images import camera_uids, observed_images, rgb
from embodichain.recording.demos.demonstrations import Episode
from embodichain.recording.read.recorded_log import RecordedLog

__all__ = ["DataSet"]

_log = logging.getLogger(__name__)


class DataSet:
    """The episodes that a format writes, one after another, in one pass.

    Args:
        episodes: At least one.
        group: The observation group.

    Attributes:
        first: The first episode, which has the entries and shapes of all.
        group: The observation group.
        vectors: Names of the entries of the group that are not images, in order.
        images: Names of those that are images; of the group ``policy`` also of the pictures of
            sensors with ``observe: true``.

    Raises:
        ConfigError: If there is no such group.
    """

    def __init__(self, episodes: Iterator[Episode], group: str) -> None:
        self.first = next(episodes)
        self._episodes = chain([self.first], episodes)
        self.group = group
        entries = self.first.entries(group)
        self.images = [name for name, values in entries.items() if values.ndim > 3]
        self.vectors = [name for name in entries if name not in self.images]
        self._observed: dict[str, str] = {}
        self._add_observed()

    def _add_observed(self) -> None:
        """Add the pictures that sensors put into the observation; name what is left out."""
        grouped: set[str] = set()
        for names in self.first.groups.values():
            grouped.update(names)
        ungrouped = [
            name
            for name in self.first.observations
            if name.startswith("sensor/") and name not in grouped
        ]
        if ungrouped and self.group == "policy":
            with self.log() as log:
                cameras = camera_uids(log.config["task"])
            self._observed = observed_images(ungrouped, cameras, [*self.images, *self.vectors])
            self.images += self._observed
            used = self._observed.values()
            ungrouped = [name for name in ungrouped if name not in used]
        if ungrouped:
            _log.warning(
                "left out: %s (observe: true); only observation terms are in a group, and pictures "
                "of sensors go with the group policy",
                ", ".join(ungrouped),
            )

    def __iter__(self) -> Iterator[Episode]:
        """Yield the episodes. Can be called once."""
        return self._episodes

    def log(self) -> RecordedLog:
        """Open the log of the first episode."""
        return RecordedLog(self.first.path)

    def vector(self, episode: Episode, name: str) -> NDArray[Any]:
        """(T+1, K) values of an entry."""
        values = episode.observations[name]
        return values.reshape(len(values), -1)

    def pictures(self, episode: Episode, name: str) -> NDArray[Any]:
        """(T+1, H, W, C) values of an image; a term's channels come first, a sensor's last."""
        if name in self._observed:
            return rgb(episode.observations[self._observed[name]])
        return np.moveaxis(episode.observations[name], 1, -1)

    def columns(self, name: str) -> list[str]:
        """Names of an entry's columns: ``to_cube[0]``, or the entry's name if it has one column."""
        width = self.vector(self.first, name).shape[1]
        if width == 1:
            return [name]
        return [f"{name}[{i}]" for i in range(width)]
