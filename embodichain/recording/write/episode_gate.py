"""`EpisodeGate`: which control steps are recorded (`record.every`)."""

from __future__ import annotations

from embodichain.lab.gym.envs.observers import EventRecord
from embodichain.utils.array_types import EnvIds

__all__ = ["EpisodeGate"]


class EpisodeGate:
    """Open during every k-th episode of one environment, beginning with the first.

    A reset opens the gate, and the reset's events belong to the new episode. So the events of a
    step are deferred until it is known whether they are recorded.

    Args:
        every: k; 1 keeps the gate open.
        counted_env: The environment whose episodes are counted.

    Attributes:
        open: Whether calls are currently recorded.
        in_step: Whether physics of the current control step has begun.
    """

    def __init__(self, every: int, counted_env: int) -> None:
        self._every = every
        self._counted_env = counted_env
        self.open = True
        self.in_step = False
        self._episodes = 0
        self._steps = 0  # of the current episode
        self._deferred: list[EventRecord] = []

    def on_physics(self) -> None:
        """Count a control step; its physics begins."""
        self._steps += 1
        self.in_step = True

    def defer(self, event: EventRecord) -> None:
        """Keep an event that fired while the gate was closed."""
        self._deferred.append(event)

    def on_reset(self, env_ids: EnvIds) -> list[EventRecord] | None:
        """Count an episode if the counted environment was reset; outside a step, call `switch`."""
        if (env_ids == self._counted_env).any():
            self._episodes += self._steps > 0  # an episode without steps does not count
            self._steps = 0
        if self.in_step:
            return None
        return self.switch()

    def switch(self) -> list[EventRecord] | None:
        """Between two steps: open or close the gate; if it opens, return the deferred events."""
        deferred = self._deferred
        self._deferred = []
        self.in_step = False
        was_open = self.open
        self.open = self._episodes % self._every == 0
        if was_open or not self.open:
            return None
        return deferred
