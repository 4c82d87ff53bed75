"""`EventManager`: what happens to the scene at start, at resets, and at intervals.

The events themselves are in `envs/mdp/events.py`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import EventCfg
from embodichain.lab.gym.envs.managers.base import BuiltTerm, Manager

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["EventManager"]


class EventManager(Manager[EventCfg]):
    """Runs events and keeps their timers.

    An event draws its random numbers by `draw`: from a stream of its own, named after the term, so
    that adding, removing or reordering terms changes no other term's numbers. What it drew goes to
    the environment's observers.

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
        self._stream = ""
        self._drawn: dict[str, NDArray[Any]] = {}
        self._given: Mapping[str, NDArray[Any]] = {}

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
            self._fire(term, mode, env_ids)

    def step(self, env_ids: EnvIndex | None = None) -> None:
        """Advance the timers by one control step and fire the `interval` events that are due.

        Args:
            env_ids: (n,) environments that took the step, or None for all. Environments that were
                reset instead of stepped are left out by the caller.
        """
        for interval in self._intervals:
            due = interval.advance(env_ids)
            if due is None or len(due):
                self._fire(interval.term, "interval", due)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Restart the timers of these environments and reset the terms that are classes."""
        super().reset(env_ids)
        for interval in self._intervals:
            interval.restart(env_ids)

    def restart_global(self) -> None:
        """Start the timers anew that all environments share: for a reset with a seed."""
        for interval in self._intervals:
            if interval.is_global:
                interval.left[:] = 0

    def _fire(self, term: BuiltTerm[EventCfg], mode: str, env_ids: EnvIndex | None) -> None:
        self._stream = f"events.{term.name}"
        self._drawn = {}
        term.call(self.env, env_ids)
        if self.env.observers:
            self.env.log_event(term.name, mode, env_ids, self._drawn)

    def draw(
        self,
        what: str,
        shape: Sequence[int],
        low: Any,
        high: Any,
        env_ids: EnvIndex | None,
    ) -> F64:
        """Draw uniform numbers for the event that is being fired, and have them logged.

        Args:
            what: What they are, for the log: ``position``.
            shape: Shape of one environment's draw.
            low: Scalar or array that broadcasts to ``shape``.
            high: Likewise; exclusive.
            env_ids: (n,) environments that draw, or None for all.

        Returns:
            (n, *shape) float64. Do not write into it.
        """
        values = self._recorded(what, shape, env_ids) if self._given else None
        if values is None:
            values = self.env.streams.uniform(self._stream, shape, low, high, env_ids)
        self._drawn[what] = values
        return values

    def _recorded(self, what: str, shape: Sequence[int], env_ids: EnvIndex | None) -> F64 | None:
        """What `again` was told that was drawn, for all of its environments."""
        given = self._given.get(what)
        if given is None or given.shape != tuple(shape):
            return None
        n = self.num_envs if env_ids is None else len(env_ids)
        return np.tile(given, (n, *[1] * len(shape)))

    def _all_recorded(self, columns: Mapping[str, slice], env_ids: EnvIndex | None) -> F64 | None:
        found = [self._recorded(n, (c.stop - c.start,), env_ids) for n, c in columns.items()]
        known = [values for values in found if values is not None]
        return np.concatenate(known, axis=1) if known and len(known) == len(found) else None

    def again(self, name: str, env_ids: EnvIndex | None, drawn: Mapping[str, NDArray[Any]]) -> None:
        """Fire a term with numbers that were drawn before, when a log was recorded.

        Args:
            name: The term.
            env_ids: (n,) environments, or None for all.
            drawn: What one environment drew, by name; what is not here is drawn anew.
        """
        self._given = drawn
        try:
            self._fire(self.terms[name], self.terms[name].cfg.mode, env_ids)
        finally:
            self._given = {}

    def draw_columns(
        self,
        columns: Mapping[str, slice],
        low: F64,
        high: F64,
        env_ids: EnvIndex | None,
        normal: bool = False,
    ) -> F64:
        """Draw several quantities at once, and have each logged under its name.

        Args:
            columns: Name -> its columns of the draw.
            low: (k,) lower bounds.
            high: (k,) upper bounds.
            env_ids: (n,) environments that draw, or None for all.
            normal: Normal instead of uniform numbers: the mean in the middle, the bounds at three
                standard deviations, where the numbers are clipped.

        Returns:
            (n, k) float64. Do not write into it.
        """
        streams, shape = self.env.streams, (len(low),)
        given = self._all_recorded(columns, env_ids) if self._given else None
        values: F64
        if given is not None:
            values = given
        elif normal:
            values = streams.normal(self._stream, shape, env_ids)
            values = np.clip(0.5 * (low + high) + (high - low) / 6.0 * values, low, high)
        else:
            values = streams.uniform(self._stream, shape, low, high, env_ids)
        for name, where in columns.items():
            self._drawn[name] = values[:, where]
        return values

    def state_dict(self) -> dict[str, Any]:
        """Timers, and the state of terms that are classes (copies)."""
        timers = {i.term.name: i.left.copy() for i in self._intervals}
        return {**super().state_dict(), "timers": timers, "started": self._started}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        self._started = bool(state["started"])
        for interval in self._intervals:
            interval.left[:] = state["timers"][interval.term.name]


class _Interval:
    """Control steps until an event fires: (N,), or (1,) for a global one; 0 is not drawn yet."""

    def __init__(self, env: TermContext, term: BuiltTerm[EventCfg]) -> None:
        self.term = term
        self.env = env
        cfg = term.cfg
        self.is_global = cfg.is_global
        self.every_step = cfg.interval_range_s is None and cfg.interval_step == 1
        self.left: NDArray[np.int64] = np.zeros(1 if cfg.is_global else env.num_envs, np.int64)

    def _draw(self, env_ids: EnvIndex | None) -> None:
        """Set the time to the next firing. A global timer uses environment 0's stream."""
        cfg = self.term.cfg
        where: Any = slice(None) if env_ids is None else env_ids
        if cfg.interval_range_s is None:
            self.left[where] = cfg.interval_step
            return
        low, high = cfg.interval_range_s
        ids = np.zeros(1, np.int64) if self.is_global else env_ids
        name = f"events.{self.term.name}.interval"
        seconds = self.env.streams.uniform(name, (), low, high, ids)
        self.left[where] = np.maximum(1, np.rint(seconds / self.env.step_dt)).astype(np.int64)

    def restart(self, env_ids: EnvIndex | None) -> None:
        """Begin to count anew where an episode begins; a global timer runs on."""
        if not self.is_global and not self.every_step:
            self._draw(env_ids)

    def advance(self, env_ids: EnvIndex | None) -> EnvIndex | None:
        """Count one step; returns the environments that are due, None meaning all of them."""
        if self.every_step:
            return None if self.is_global else env_ids
        if self.is_global:
            if self.left[0] == 0:
                self._draw(None)
            self.left -= 1
        elif env_ids is None:
            self.left -= 1
        else:
            self.left[env_ids] -= 1
        due = np.flatnonzero(self.left <= 0)
        if not len(due):
            return due
        everyone = len(due) == len(self.left)
        self._draw(None if everyone else due)
        return None if everyone else due
