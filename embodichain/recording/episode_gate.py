"""`EpisodeGate`: which episodes are recorded (`record.every`). Knows nothing of messages."""

from __future__ import annotations

from embodichain.lab.gym.envs.observers import EventRecord
from embodichain.lab.sim.engine.api import EnvIndex

__all__ = ["EpisodeGate"]


class EpisodeGate:
    """Open while the leading environment is in every k-th of its episodes, the first included.

    What opens the gate is a reset, and what happened in it belongs to the episode: events of a
    step are held until it is known whether they are wanted.

    Args:
        every: k; 1 keeps the gate open.
        lead: The leading environment.

    Attributes:
        open: Whether what happens now is recorded.
    """

    def __init__(self, every: int, lead: int) -> None:
        self._every, self._lead = every, lead
        self.open = True
        self._episodes = self._steps = 0
        self._in_step = False
        self._held: list[EventRecord] = []

    def on_physics(self) -> None:
        """A control step's own physics begins."""
        self._steps += 1
        self._in_step = True

    def hold(self, event: EventRecord) -> None:
        """An event fired while the gate was closed."""
        self._held.append(event)

    def on_reset(self, env_ids: EnvIndex) -> list[EventRecord] | None:
        """Environments were reset; returns what `switch` does, unless a step is under way."""
        if (env_ids == self._lead).any():
            self._episodes += self._steps > 0  # an episode without steps is none
            self._steps = 0
        return None if self._in_step else self.switch()

    def switch(self) -> list[EventRecord] | None:
        """Between two steps: open or close; returns the events that were held if it opens."""
        held, self._held, self._in_step = self._held, [], False
        before, self.open = self.open, self._episodes % self._every == 0
        return held if self.open and not before else None
