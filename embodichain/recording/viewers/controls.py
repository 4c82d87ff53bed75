"""`Facts` of a step for the page, and the page's `Controls`: plain data between two processes.

See `web_page.py` and `web_process.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

__all__ = ["SPEEDS", "Controls", "Facts", "Setup"]

SPEEDS: tuple[float | None, ...] = (None, 2.0, 1.0, 0.5, 0.25, 0.1)
"""Multiples of real time; None is without limit."""


@dataclass(frozen=True, slots=True)
class Facts:
    """One step of the environment that is shown.

    Attributes:
        step: Number of the control step, from 0.
        seconds: Simulated time since the episode began.
        lines: Further lines, as name and text.
        rewards: Each term's share of this step's reward: its value times its weight.
        sums: Each term's sum of these over the episode.
    """

    step: int
    seconds: float
    lines: tuple[tuple[str, str], ...] = ()
    rewards: Mapping[str, float] = field(default_factory=dict)
    sums: Mapping[str, float] = field(default_factory=dict)

    def plain(self) -> tuple[Any, ...]:
        """Return the values in order."""
        return self.step, self.seconds, self.lines, self.rewards, self.sums


@dataclass(frozen=True, slots=True)
class Controls:
    """The state of the page's controls.

    Attributes:
        env_id: The environment to show.
        speed: One of `SPEEDS`.
        paused: Whether the run waits.
        watched: Whether a browser has the page open.
        steps: How often a single step was requested.
        resets: How often a reset was requested.
        reset_env: The environment of the last reset.
    """

    env_id: int = 0
    speed: float | None = 1.0
    paused: bool = False
    watched: bool = False
    steps: int = 0
    resets: int = 0
    reset_env: int = 0


@dataclass(frozen=True, slots=True)
class Setup:
    """The initial state of a page.

    Attributes:
        host: The address to listen on.
        port: The port; None is the first free one from 8080.
        title: Of the page and its panel.
        num_envs: How many environments can be chosen from.
        can_reset: Whether resets may be requested.
        controls: The initial controls.
    """

    host: str
    port: int | None
    title: str
    num_envs: int
    can_reset: bool
    controls: Controls
