"""`EventManager`: what happens to the scene at start, at resets, and at intervals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from embodichain.lab.gym.envs.cfg import EventCfg
from embodichain.lab.gym.envs.managers.base import BuiltTerm
from embodichain.lab.gym.envs.managers.drawing import DrawingManager, Timer

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex

__all__ = ["EventManager"]


class EventManager(DrawingManager[EventCfg]):
    """Runs events and their timers.

    `interval` events count control steps per environment. A reset restarts the environment's
    count, so nothing fires for an environment in the step that reset it. With `is_global` all
    environments share one count that runs on through resets, and the event gets ``env_ids=None``.

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> event.
    """

    def __init__(self, env: TermContext, cfgs: Mapping[str, EventCfg]) -> None:
        self._intervals: list[_Interval] = []
        super().__init__(env, "events", "event", cfgs)
        self._intervals = [_Interval(env, t) for t in self._by_mode["interval"]]
        self._started = False

    def _bind(self) -> None:
        self._by_mode: dict[str, list[BuiltTerm[EventCfg]]] = {
            mode: [t for t in self.terms.values() if t.cfg.mode == mode]
            for mode in ("startup", "reset", "interval")
        }
        for interval in self._intervals:
            interval.term = self.terms[interval.term.name]

    def apply(self, mode: Literal["startup", "reset"], env_ids: EnvIndex | None = None) -> None:
        """Fire every event of a mode; `startup` events fire once, whoever asks again.

        Args:
            mode: Which events.
            env_ids: (n,) sorted unique int64 environments, or None for all.
        """
        if mode == "startup":
            if self._started:
                return
            self._started = True
        for term in self._by_mode[mode]:
            self._run(term, mode, env_ids)

    def step(self, env_ids: EnvIndex | None = None) -> None:
        """Advance the timers by one control step and fire the `interval` events that are due.

        Args:
            env_ids: (n,) environments that took the step, or None for all. Environments that were
                reset instead of stepped are left out by the caller.
        """
        for interval in self._intervals:
            due = interval.advance(env_ids)
            if due is None or len(due):
                self._run(interval.term, "interval", due)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Restart the timers of these environments and reset the terms that are classes."""
        super().reset(env_ids)
        for interval in self._intervals:
            interval.restart(env_ids)

    def restart_global(self) -> None:
        """Start the timers anew that all environments share: for a reset with a seed."""
        for interval in self._intervals:
            if interval.is_global:
                interval.timer.left[:] = 0

    def _run(self, term: BuiltTerm[EventCfg], mode: str, env_ids: EnvIndex | None) -> None:
        self._call(term, mode, env_ids, self.env, env_ids)

    def state_dict(self) -> dict[str, Any]:
        """Timers, and the state of terms that are classes (copies)."""
        timers = {i.term.name: i.timer.left.copy() for i in self._intervals}
        return {**super().state_dict(), "timers": timers, "started": self._started}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        self._started = bool(state["started"])
        for interval in self._intervals:
            interval.timer.left[:] = state["timers"][interval.term.name]


class _Interval:
    """When an event fires next."""

    def __init__(self, env: TermContext, term: BuiltTerm[EventCfg]) -> None:
        self.term = term
        self._streams = env.streams
        cfg = term.cfg
        self.is_global = cfg.is_global
        self.every_step = cfg.interval_range_s is None and cfg.interval_step == 1
        self.timer = Timer(1 if cfg.is_global else env.num_envs, env.step_dt)

    def _start(self, env_ids: EnvIndex | None) -> None:
        """Start the timer anew. A global one draws from environment 0's stream."""
        cfg = self.term.cfg
        if cfg.interval_range_s is None:
            self.timer.left[slice(None) if env_ids is None else env_ids] = cfg.interval_step
            return
        low, high = cfg.interval_range_s
        ids = np.zeros(1, np.int64) if self.is_global else env_ids
        name = f"events.{self.term.name}.interval"
        self.timer.start(env_ids, self._streams.uniform(name, (), low, high, ids))

    def restart(self, env_ids: EnvIndex | None) -> None:
        """Begin to count anew where an episode begins; a global timer runs on."""
        if not self.is_global and not self.every_step:
            self._start(env_ids)

    def advance(self, env_ids: EnvIndex | None) -> EnvIndex | None:
        """Count one step; returns the environments that are due, None meaning all of them."""
        if self.every_step:
            return None if self.is_global else env_ids
        if self.is_global and self.timer.left[0] == 0:
            self._start(None)
        found = self.timer.advance(None if self.is_global else env_ids)
        due = None if len(found) == len(self.timer.left) else found
        if len(found):
            self._start(due)
        return due
