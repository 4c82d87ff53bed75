"""`Controls` and `Facts`: what the people at a page ask for, and what a run tells them.

Two threads share them: the page's writes what is asked for, the run's reads it. Each attribute is
replaced as a whole.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

__all__ = ["SPEEDS", "Controls", "Facts"]

SPEEDS: tuple[float | None, ...] = (None, 2.0, 1.0, 0.5, 0.25, 0.1)
"""Multiples of real time; None is as fast as it goes."""

_KEPT = 400


@dataclass(frozen=True, slots=True)
class Facts:
    """One step of the environment that is shown.

    Attributes:
        step: Control steps since the beginning.
        seconds: Since the episode began, of simulated time.
        lines: What else is to be read, as name and text.
        rewards: Each term's share of this step's reward.
        sums: Each term's sum over the episode.
    """

    step: int
    seconds: float
    lines: tuple[tuple[str, str], ...] = ()
    rewards: Mapping[str, float] = field(default_factory=dict)
    sums: Mapping[str, float] = field(default_factory=dict)


class Controls:
    """What is asked for.

    Args:
        num_envs: How many environments can be chosen from.
        env_id: The one that is shown first.
        realtime: Whether the speed is real time first, else as fast as it goes.
        resets: Whether an episode may be ended.

    Attributes:
        env_id: The environment to show.
        speed: One of `SPEEDS`.
        paused: Whether to wait.
        facts: The last ones.
        history: The last few.
    """

    def __init__(self, num_envs: int, env_id: int, realtime: bool, resets: bool) -> None:
        self.num_envs = num_envs
        self.resets = resets
        self.env_id = env_id
        self.speed = 1.0 if realtime else None
        self.paused = False
        self.facts: Facts | None = None
        self.history: deque[Facts] = deque(maxlen=_KEPT)
        self._steps: deque[None] = deque()
        self._resets: deque[int] = deque()

    # -- asked for, by the page's thread ---------------------------------------------------------

    def choose(self, env_id: int) -> None:
        """Show another environment."""
        chosen = min(max(env_id, 0), self.num_envs - 1)
        if chosen != self.env_id:
            self.env_id = chosen
            self.facts = None
            self.history.clear()

    def toggle_pause(self) -> None:
        """Wait, or go on."""
        self.paused = not self.paused

    def ask_step(self) -> None:
        """Take one step, and wait."""
        if self.paused:
            self._steps.append(None)
        self.paused = True

    def ask_reset(self) -> None:
        """End the episode of the environment that is shown."""
        if self.resets:
            self._resets.append(self.env_id)

    # -- read, by the run's thread ---------------------------------------------------------------

    def tell(self, facts: Facts) -> None:
        """Show a step."""
        self.facts = facts
        self.history.append(facts)

    def take_step(self) -> bool:
        """Whether one step was asked for; it is no longer then."""
        if not self._steps:
            return False
        self._steps.popleft()
        return True

    def take_reset(self) -> int | None:
        """Whose episode is to end, once for each time it was asked for."""
        return self._resets.popleft() if self._resets else None

    def leave(self) -> None:
        """Nobody looks: nothing is waited for."""
        self.paused = False
        self._steps.clear()
