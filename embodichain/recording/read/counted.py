"""Which episodes of a log count: those that make up the results of its run.

`run` and `eval` count the first episodes of each environment: the header says how many (`quota`).
`collect` decides later, so the channel `/counted` lists them (`Header.lists_counted`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from google.protobuf.message import DecodeError

from embodichain.recording.format.header import Header
from embodichain.recording.format.log_error import DamageError
from embodichain.recording.format.messages.schema import message_class
from embodichain.recording.read.episodes import LogEpisode

__all__ = ["Counting"]


class Counting:
    """Marks which episodes of a log count.

    Args:
        header: The log's header.
    """

    def __init__(self, header: Header) -> None:
        self._quota = header.quota
        self._lists_counted = header.lists_counted
        self._listed: set[tuple[int, int]] = set()

    def add(self, data: bytes | memoryview) -> None:
        """Read a message of `COUNTED_TOPIC`.

        Raises:
            DamageError: If the message is damaged.
        """
        message = message_class("Counted")()
        try:
            message.ParseFromString(bytes(data))
            self._listed |= set(zip(message.env_ids, message.episode_id, strict=True))
        except (DecodeError, ValueError) as error:
            raise DamageError(f"a list of counted episodes is damaged: {error}") from error

    def marked(self, episodes: Iterable[LogEpisode]) -> list[LogEpisode]:
        """The episodes with `LogEpisode.counted`; call it after all messages were added."""
        return [replace(episode, counted=self._counts(episode)) for episode in episodes]

    def _counts(self, episode: LogEpisode) -> bool | None:
        if self._lists_counted:
            return (episode.env, episode.episode) in self._listed
        if not self._quota or episode.env >= len(self._quota):
            return None
        ended = episode.terminated or episode.truncated
        return ended and episode.episode < self._quota[episode.env]
