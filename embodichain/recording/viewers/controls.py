"""`Facts` and `Wishes`: what a run tells the people at a page, and what these ask for.

Plain data, sent between the run's process and the page's. See `web_page.py` and `web_process.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

__all__ = ["SPEEDS", "Facts", "Setup", "Wishes"]

SPEEDS: tuple[float | None, ...] = (None, 2.0, 1.0, 0.5, 0.25, 0.1)
"""Multiples of real time; None is as fast as it goes."""


@dataclass(frozen=True, slots=True)
class Facts:
    """One step of the environment that is shown.

    Attributes:
        step: Number of the control step, from 0.
        seconds: Since the episode began, of simulated time.
        lines: What else is to be read, as name and text.
        rewards: Each term's share of this step's reward: its value times its weight.
        sums: Each term's sum of these over the episode.
    """

    step: int
    seconds: float
    lines: tuple[tuple[str, str], ...] = ()
    rewards: Mapping[str, float] = field(default_factory=dict)
    sums: Mapping[str, float] = field(default_factory=dict)

    def plain(self) -> tuple[Any, ...]:
        """Its values in their order."""
        return self.step, self.seconds, self.lines, self.rewards, self.sums


@dataclass(frozen=True, slots=True)
class Wishes:
    """What people ask for, and whether anybody is there.

    Attributes:
        env_id: The environment to show.
        speed: One of `SPEEDS`.
        paused: Whether to wait.
        watched: Whether a browser has the page open.
        steps: How often a single step was asked for.
        resets: How often a reset was asked for; the last time, of `reset_env`.
        reset_env: See there.
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
    """How a page begins.

    Attributes:
        host: The address to listen on.
        port: The port; None is the first free one from 8080.
        title: Of the page and its panel.
        num_envs: How many environments can be chosen from.
        can_reset: Whether a reset may be asked for.
        wishes: What is asked for at first.
    """

    host: str
    port: int | None
    title: str
    num_envs: int
    can_reset: bool
    wishes: Wishes
