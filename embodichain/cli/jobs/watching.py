"""`Watching`: a run waits for the first person who looks, and stays until the last one is gone."""

from __future__ import annotations

import logging
import math
import sys
import time
from typing import TYPE_CHECKING

from embodichain.cli.terminal.keys import has_person, pressed_keys
from embodichain.cli.terminal.process import StopFlag

if TYPE_CHECKING:
    from embodichain.recording.viewers.showing import Audience

__all__ = ["Watching"]

_log = logging.getLogger(__name__)
_POLL_SECONDS = 0.05
_RELOAD_SECONDS = 5.0
"""A page that is loaded again is back by then; only after it somebody counts as gone."""


class Watching:
    """Waits for those who look at a run.

    Args:
        audience: Those who look, as the viewer knows them.
        wait_s: Seconds to wait for the first person where nobody sits at a terminal; 0 waits
            nowhere.
        stop: Set by a signal, which ends all waiting.
        quiet: Whether only what somebody at the terminal has to know is printed.
        only_shows: Whether there is nothing to do unless somebody looks.

    Attributes:
        has_person: Whether somebody sits at the terminal of this command.
    """

    def __init__(
        self,
        audience: Audience,
        *,
        wait_s: float,
        stop: StopFlag,
        quiet: bool = False,
        only_shows: bool = False,
    ) -> None:
        self._audience = audience
        self._wait_s = wait_s
        self._stop = stop
        self.has_person = has_person()
        self._quiet = quiet and not self.has_person
        self._only_shows = only_shows
        self._was_watched = False
        self._last_seen = 0.0

    def wait(self) -> bool:
        """Wait for the first person; return whether somebody looks.

        In a terminal it waits until somebody looks or a key is pressed, elsewhere for `wait_s`.
        """
        if not self._is_watched() and self._wait_s > 0:
            if self.has_person:
                self._wait_for_key()
            else:
                self._wait_for_time()
        if self._was_watched:
            self._audience.refresh()
        return self._was_watched

    def has_lost_all(self) -> bool:
        """Whether those who looked are gone. Cheap; False if nobody ever looked."""
        if self._is_watched() or not self._was_watched:
            return False
        is_back_soon = time.monotonic() - self._last_seen < _RELOAD_SECONDS
        return not (self._audience.may_return and is_back_soon)

    def hold(self, consequence: str = "the run goes on without it") -> bool:
        """Wait while a page is loaded again; say once that those who looked are gone.

        Args:
            consequence: What follows if they are gone, for the message.

        Returns:
            False if those who looked have just gone. Cheap while they look, or if nobody ever did.
        """
        if self._is_watched() or not self._was_watched:
            return True
        while not self._is_watched() and not self._stop.is_stopped():
            if self.has_lost_all():
                self._say(f"{self._audience.what} was closed: {consequence}")
                self._was_watched = False
                return False
            time.sleep(_POLL_SECONDS)
        return True

    def stay(self) -> None:
        """Say that the run is over; in a terminal, stay until those who look are gone.

        Ctrl-C ends it too: the run is over, so it is not interrupted.
        """
        if not self._is_watched():
            return
        self._audience.finish()
        if not self.has_person or self._stop.is_stopped():
            return
        with StopFlag() as closing:
            self._say(f"the run is over: close {self._audience.what}, or press Ctrl-C, to end")
            while not self.has_lost_all() and not closing.is_stopped():
                if self._is_watched():
                    self._audience.refresh()
                time.sleep(_POLL_SECONDS)

    def _is_watched(self) -> bool:
        if not self._audience.is_watched():
            return False
        self._was_watched = True
        self._last_seen = time.monotonic()
        return True

    def _wait_for_key(self) -> None:
        """Wait until somebody looks, a key is pressed, or the run is stopped."""
        ends = "any key or Ctrl-C ends it"
        if not self._only_shows:
            ends = "any key goes on without it, Ctrl-C ends the run"
        with pressed_keys() as was_pressed:
            self._say(f"waiting until {self._audience.what} is opened; {ends}")
            while not self._is_watched() and not self._stop.is_stopped():
                if was_pressed():
                    self._say_unwatched(f"{self._audience.what} was not waited for")
                    return
                time.sleep(_POLL_SECONDS)

    def _wait_for_time(self) -> None:
        """Wait until somebody looks, the time is up, or the run is stopped."""
        limit = "" if math.isinf(self._wait_s) else f"{self._wait_s:g} s "
        self._say(f"waiting {limit}for {self._audience.what} to be opened")
        end = time.monotonic() + self._wait_s
        while not self._is_watched() and not self._stop.is_stopped():
            if time.monotonic() > end:
                self._say_unwatched(f"{self._audience.what} was not opened")
                return
            time.sleep(_POLL_SECONDS)

    def _say_unwatched(self, reason: str) -> None:
        consequence = "nothing was played" if self._only_shows else "the run goes on without it"
        self._say(f"{reason}: {consequence}")

    def _say(self, sentence: str) -> None:
        _log.info("viewer: %s", sentence)
        if not self._quiet:
            sys.stderr.write(f"viewer: {sentence}\n")
            sys.stderr.flush()
