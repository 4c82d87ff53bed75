"""Managers whose terms draw random numbers: `EventManager` and `CommandManager`.

Each term has its own random stream, and its draws are logged. `Timer` counts the control steps
until a term is due.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import CommandCfg, EventCfg, TermCfg
from embodichain.lab.gym.envs.managers.manager import BuiltTerm, Manager
from embodichain.lab.gym.envs.managers.term import CommandTerm
from embodichain.lab.gym.envs.managers.terms.term_errors import FAILURES, kind_of_values
from embodichain.utils.arrays import may_be_set, tensor_of
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean, listing

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.managers.context import TermContext, Weaken
    from embodichain.lab.gym.envs.managers.terms.registry import Kind
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.utils.array_types import Floats
    from embodichain.utils.arrays import Arrays

__all__ = [
    "CommandManager",
    "EventManager",
    "RandomManager",
    "Timer",
]

C = TypeVar("C", bound=TermCfg)

_NO_ENVIRONMENTS: NDArray[np.int64] = np.zeros(0, np.int64)


class RandomManager(Manager[C]):
    """A manager whose terms draw random numbers while they are called.

    A term draws by `draw` from a stream named ``SECTION.TERM``, so that adding, removing or
    reordering terms changes no other term's numbers. Draws are reported to the environment's
    observers.
    """

    def __init__(self, env: TermContext, section: str, kind: Kind, cfgs: Mapping[str, C]) -> None:
        self._stream = ""
        self._strength = 1.0
        self._drawn: dict[str, NDArray[Any]] = {}
        self._preset_draws: Mapping[str, NDArray[Any]] = {}
        super().__init__(env, section, kind, cfgs)

    @abstractmethod
    def _run(self, term: BuiltTerm[C], mode: str, env_ids: EnvIndex | None) -> None:
        """Call a term by `_call`; subclasses add bookkeeping."""

    def _call(
        self,
        term: BuiltTerm[C],
        mode: str,
        env_ids: EnvIndex | None,
        *,
        arguments: tuple[Any, ...],
    ) -> None:
        """Call a term with its own random stream, and log its draws.

        Args:
            term: The term.
            mode: The mode in which it is called, for the log.
            env_ids: (n,) environments, or None for all, for the log and for errors.
            arguments: What it is called with.
        """
        self._stream = f"{self.section}.{term.name}"
        self._drawn = {}
        try:
            term.call(*arguments)
        except ConfigError as error:
            params_path = f"{self.section}.{term.name}.params"
            problems = [
                Problem(f"{params_path}.{problem.path}".rstrip("."), problem.message, problem.hint)
                for problem in error.problems
            ]
            raise self.failed(term.name, ConfigError(problems), env_ids) from error
        except FAILURES as error:
            self.fail(term.name, error, env_ids)
        if self.env.observers:
            self.env.log_event(term.name, mode, env_ids, self._drawn)

    def draw(
        self,
        what: str,
        shape: Sequence[int],
        low: Any,
        high: Any,
        env_ids: EnvIndex | None,
        default: Any = None,
    ) -> Floats:
        """Draw uniform numbers for the term that is being called, and log them.

        Args:
            what: Their name in the log, such as ``position``.
            shape: Shape of one environment's draw.
            low: Scalar or array that broadcasts to ``shape``.
            high: Likewise; exclusive.
            env_ids: (n,) environments that draw, or None for all.
            default: What an event's `strength` draws towards, scalar or array that broadcasts to
                ``shape``; None if it does not act on these numbers. The log has the result.

        Returns:
            (n, *shape) float64. Do not write into it.
        """
        values: Floats | None = None
        if self._preset_draws:
            values = self.preset_draw(what, shape, env_ids)
        if values is None:
            values = self.env.streams.uniform(self._stream, shape, low, high, env_ids)
            if default is not None and self._strength != 1.0:
                values = default + self._strength * (values - default)
        self._drawn[what] = values
        return values

    def draw_columns(
        self,
        columns: Mapping[str, slice],
        low: Floats,
        high: Floats,
        env_ids: EnvIndex | None,
        normal: bool = False,
        weaken: Mapping[str, Weaken] | None = None,
    ) -> Floats:
        """Draw several quantities at once, and log each under its name.

        Args:
            columns: Name -> its columns of the draw.
            low: (k,) bounds at one end.
            high: (k,) bounds at the other end; smaller ones where a factor multiplies a negative
                number.
            env_ids: (n,) environments that draw, or None for all.
            normal: Whether to draw normal numbers: mean in the middle, clipped to the bounds at
                three standard deviations.
            weaken: Name -> how an event's `strength` acts on its columns. The log has the result.

        Returns:
            (n, k) float64. Do not write into it.
        """
        preset_values: list[Floats] = []
        for name, where in columns.items():
            draw = self.preset_draw(name, (where.stop - where.start,), env_ids)
            if draw is not None:
                preset_values.append(draw)
        values: Floats
        is_preset = bool(preset_values) and len(preset_values) == len(columns)
        if is_preset:
            values = np.concatenate(preset_values, axis=1)
        elif normal:
            values = self.env.streams.normal(self._stream, (len(low),), env_ids)
            values = 0.5 * (low + high) + (high - low) / 6.0 * values
            values = np.clip(values, np.minimum(low, high), np.maximum(low, high))
        else:
            values = self.env.streams.uniform(self._stream, (len(low),), low, high, env_ids)
        if weaken and self._strength != 1.0 and not is_preset:
            parts = [
                weaken[name](values[:, where], self._strength) for name, where in columns.items()
            ]
            values = np.concatenate(parts, axis=1)
        for name, where in columns.items():
            self._drawn[name] = values[:, where]
        return values

    def try_draw(self, shape: Sequence[int], env_ids: EnvIndex) -> Floats:
        """Draw numbers in [0, 1) for the term that is being called, which may reject them.

        They are not logged: what the term makes of those that it takes is, by `log_draw`. The k-th
        try of an environment draws the same numbers whichever environments try with it.

        Args:
            shape: Shape of one environment's draw.
            env_ids: (n,) environments that draw.

        Returns:
            (n, *shape) float64.
        """
        return self.env.streams.uniform(self._stream, shape, 0.0, 1.0, env_ids)

    def log_draw(self, what: str, values: Floats) -> None:
        """Log what the term that is being called made of its tries, (n, *shape), under a name."""
        self._drawn[what] = values

    def preset_draw(
        self, what: str, shape: Sequence[int], env_ids: EnvIndex | None
    ) -> Floats | None:
        """Return the numbers that `call_with_draws` has set for a name, (n, *shape), or None."""
        draw = self._preset_draws.get(what)
        if draw is None or draw.shape != tuple(shape):
            return None
        n = self.num_envs if env_ids is None else len(env_ids)
        once_per_axis = [1] * len(shape)
        return self.env.arrays.put(np.tile(draw, (n, *once_per_axis)))

    def call_with_draws(
        self, name: str, mode: str, env_ids: EnvIndex | None, drawn: Mapping[str, NDArray[Any]]
    ) -> None:
        """Call a term with draws of one environment instead of new ones, to restore a moment.

        `replay --verify` does not come here: it repeats what terms have written, and calls none.

        Args:
            name: The term.
            mode: The mode in which it was called.
            env_ids: (n,) environments, or None for all.
            drawn: The draws by name; missing ones are drawn.
        """
        self._preset_draws = drawn
        try:
            self._run(self.terms[name], mode, env_ids)
        finally:
            self._preset_draws = {}

    # Older names.
    replayed = preset_draw
    replay = call_with_draws


class Timer:
    """Control steps until something is due, in each environment.

    Args:
        count: N, or 1 for a timer that all environments share.
        step_dt: Seconds of a control step.
        arrays: Makes its array.

    Attributes:
        left: (count,) int64 control steps; 0 where the timer was not started.
    """

    def __init__(self, count: int, step_dt: float, arrays: Arrays) -> None:
        self.left: NDArray[np.int64] = arrays.full(count, 0, np.int64)
        self._arrays = arrays
        self._step_dt = step_dt

    def start(self, env_ids: EnvIndex | None, seconds: Floats) -> None:
        """Start the timer for (n,) seconds, rounded to control steps, at least one."""
        steps = np.maximum(1, np.rint(seconds / self._step_dt)).astype(np.int64)
        self.left[slice(None) if env_ids is None else env_ids] = steps

    def advance(self, env_ids: EnvIndex | None, steps: NDArray[np.int64] | int = 1) -> EnvIndex:
        """Count control steps.

        Args:
            env_ids: (n,) sorted environments that stepped, or None for all.
            steps: Number of steps, one number or (n,).

        Returns:
            Those environments whose timer is due, sorted.
        """
        if env_ids is None:
            # One number in place takes three times as long.
            self.left[...] = self.left - steps
            is_due = self.left <= 0
            if not may_be_set(is_due):
                return _NO_ENVIRONMENTS
            return self._arrays.where(is_due)
        self.left[env_ids] -= steps
        return env_ids[self.left[env_ids] <= 0]


class EventManager(RandomManager[EventCfg]):
    """Runs events and their timers.

    `interval` events count control steps per environment. A reset restarts the environment's
    count: no event fires for an environment in the step that reset it. With `is_global` all
    environments share one count that resets do not change; the event receives ``env_ids=None``.

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> event.

    Attributes:
        startup_draws: Startup event -> its draws (N, ...) by name. Observers do not see them: they
            are attached later.
    """

    def __init__(self, env: TermContext, cfgs: Mapping[str, EventCfg]) -> None:
        self._intervals: list[_Interval] = []
        self.startup_draws: dict[str, Mapping[str, NDArray[Any]]] = {}
        super().__init__(env, "events", "event", cfgs)
        self._intervals = [_Interval(env, term) for term in self._by_mode["interval"]]
        self._started = False

    def _bind(self) -> None:
        # A stable sort: the others keep the order in which they are declared.
        events = sorted(
            self.terms.values(),
            key=lambda term: not getattr(term.instance, "comes_first", False),
        )
        self._by_mode: dict[str, list[BuiltTerm[EventCfg]]] = {
            mode: [event for event in events if event.cfg.mode == mode]
            for mode in ("startup", "reset", "interval")
        }
        for interval in self._intervals:
            interval.term = self.terms[interval.term.name]

    def has(self, mode: Literal["startup", "reset", "interval"]) -> bool:
        """Whether there is an event of a mode."""
        return bool(self._by_mode[mode])

    def apply(
        self,
        mode: Literal["startup", "reset"],
        env_ids: EnvIndex | None = None,
        *,
        again: bool = False,
    ) -> None:
        """Fire every event of a mode; `startup` events fire once, however often this is called.

        Args:
            mode: The mode of the events.
            env_ids: (n,) sorted unique int64 environments, or None for all.
            again: Whether `startup` events fire once more.
        """
        if mode == "startup":
            if self._started and not again:
                return
            self._started = True
        for term in self._by_mode[mode]:
            self._run(term, mode, env_ids)

    @property
    def acts_in_steps(self) -> bool:
        """Whether there are `interval` events that may change something."""
        return any(not interval.watches for interval in self._intervals)

    def step(
        self, env_ids: EnvIndex | None = None, stepped: EnvIndex | None = None
    ) -> list[EnvIndex | None]:
        """Advance the timers by one control step and fire the `interval` events that are due.

        Args:
            env_ids: (n,) environments whose episode goes on, or None for all. Events with
                `is_global` fire in all environments nevertheless.
            stepped: (m,) environments that stepped, or None for all: those of events that change
                nothing (`Term.watches`).

        Returns:
            The environments of each event that fired and may have changed something; None is all.
        """
        changed: list[EnvIndex | None] = []
        for interval in self._intervals:
            due = interval.advance(stepped if interval.watches else env_ids)
            if due is not None and not len(due):
                continue
            self._run(interval.term, "interval", due)
            if not interval.watches:
                changed.append(due)
        return changed

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Restart the timers of these environments and reset the terms that are classes."""
        super().reset(env_ids)
        for interval in self._intervals:
            interval.restart(env_ids)

    @property
    def strength(self) -> float:
        """`strength` of the event that is being called, 0 to 1."""
        return self._strength

    def _run(self, term: BuiltTerm[EventCfg], mode: str, env_ids: EnvIndex | None) -> None:
        self._strength = term.cfg.strength
        self._call(term, mode, env_ids, arguments=(self.env, env_ids))
        if mode == "startup":
            self.startup_draws[term.name] = self._drawn

    def state_dict(self) -> dict[str, Any]:
        """Timers, and the state of terms that are classes (copies)."""
        timers = {interval.term.name: interval.timer.left.copy() for interval in self._intervals}
        return {**super().state_dict(), "timers": timers, "started": self._started}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        self._started = bool(state["started"])
        for interval in self._intervals:
            interval.timer.left[:] = state["timers"][interval.term.name]


class _Interval:
    """The timer of an event."""

    def __init__(self, env: TermContext, term: BuiltTerm[EventCfg]) -> None:
        cfg = term.cfg
        self.term = term
        self._streams = env.streams
        self._arrays = env.arrays
        self.is_global = cfg.is_global
        self.watches: bool = getattr(term.instance, "watches", False)
        self.every_step = cfg.interval_range_s is None and cfg.interval_step == 1
        # On a device a timer that all share is N equal ones: masks choose among N environments.
        count = 1 if cfg.is_global and not env.arrays.on_device else env.num_envs
        self.timer = Timer(count, env.step_dt, env.arrays)
        self._first = env.arrays.put(np.arange(count) == 0)

    def _start(self, env_ids: EnvIndex | None) -> None:
        """Restart the timer. A global one draws from environment 0's stream."""
        cfg = self.term.cfg
        if cfg.interval_range_s is None:
            self.timer.left[slice(None) if env_ids is None else env_ids] = cfg.interval_step
            return
        low, high = cfg.interval_range_s
        drawing_ids = env_ids
        if self.is_global and env_ids is not None:
            drawing_ids = env_ids[self._first]
        stream = f"events.{self.term.name}.interval"
        seconds = self._streams.uniform(stream, (), low, high, drawing_ids)
        if self.is_global:
            seconds = seconds[:1]
        self.timer.start(env_ids, seconds)

    def restart(self, env_ids: EnvIndex | None) -> None:
        """Restart the timer of environments that begin an episode; a global one is not changed."""
        if not self.is_global and not self.every_step:
            self._start(env_ids)

    def advance(self, env_ids: EnvIndex | None) -> EnvIndex | None:
        """Count one step; return the environments that are due, None for all."""
        if self.every_step:
            return None if self.is_global else env_ids
        if self.is_global:
            env_ids = None
            # No reset starts a timer that all share: the first step does.
            is_stopped = self.timer.left == 0
            if may_be_set(is_stopped):
                self._start(self._arrays.where(is_stopped))
        due_ids = self.timer.advance(env_ids)
        due = None if self._arrays.are_all(due_ids, len(self.timer.left)) else due_ids
        if len(due_ids):
            # A timer that all share draws from environment 0's stream; None would draw from all.
            self._start(due_ids if self.is_global else due)
        return due


class CommandManager(RandomManager[CommandCfg]):
    """Draws commands at resets (after reset events) and at their intervals within an episode.

    A command draws by `draw` from its own stream; draws are reported to the environment's observers
    as an event of mode ``command``. The means of a term's metrics over the episode are
    ``info["metrics"]["COMMAND/METRIC"]``.

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> command.

    Raises:
        ConfigError: If a term is wrong, or has no values (N, K).
    """

    def __init__(self, env: TermContext, cfgs: Mapping[str, CommandCfg]) -> None:
        super().__init__(env, "commands", "command", cfgs)
        self._timers = {
            name: Timer(self.num_envs, env.step_dt, env.arrays)
            for name, term in self.terms.items()
            if term.cfg.resampling_time_s is not None
        }
        self._sums: dict[str, Floats] = {}
        self._steps: Floats = env.arrays.full(self.num_envs, 0.0)

    def _bind(self) -> None:
        for name, term in self.terms.items():
            values = getattr(term.instance, "values", None)
            if values is None or getattr(values, "ndim", 0) != 2:
                message = f"{term.spec.label} must set values, an array (N, K)"
                raise ConfigError([Problem(f"commands.{name}.func", message)])
            has_right_type = self.env.arrays.on_device or values.dtype == np.float64
            if values.shape[0] != self.num_envs or not has_right_type:
                message = f"needs float64 values ({self.num_envs}, K), got {values.shape}"
                raise ConfigError([Problem(f"commands.{name}", message)])
        instances = [(name, term.instance) for name, term in self.terms.items()]
        self._updates = [
            (name, term.update)
            for name, term in instances
            if type(term).update is not CommandTerm.update
        ]
        self._measured = [
            (name, term.metrics)
            for name, term in instances
            if type(term).metrics is not CommandTerm.metrics
        ]

    # -- read by terms -------------------------------------------------------------------------

    def require(self, name: str, key: str = "command_name") -> str:
        """Return the name of a command if it exists; for terms with a command parameter.

        Args:
            name: The name.
            key: The parameter, for the message.

        Raises:
            ConfigError: If there is no such command; lists those that exist.
        """
        if name not in self.terms:
            message = f"no command is called {name!r}; there are: {listing(self.terms, name)}"
            raise ConfigError([Problem(key, message, did_you_mean(name, self.terms).strip())])
        return name

    def values(self, name: str) -> Floats:
        """(N, K) float64 commands in force: a live view; do not write to it or store it."""
        return self.terms[name].instance.values

    def get_command(self, name: str) -> torch.Tensor:
        """(N, K) float32 commands in force; a copy."""
        return tensor_of(self.values(name).astype(np.float32))

    def names(self, name: str) -> tuple[str, ...]:
        """Names of the columns of a command."""
        instance = self.terms[name].instance
        return tuple(instance.names) or tuple(map(str, range(instance.values.shape[1])))

    # -- called by the environment -------------------------------------------------------------

    def resample(self, env_ids: EnvIndex | None) -> None:
        """Draw every command, for environments that were reset.

        Args:
            env_ids: (n,) sorted unique int64, or None for all.
        """
        for term in self.terms.values():
            self._run(term, "command", env_ids)
        self._update(env_ids)

    @property
    def acts_in_steps(self) -> bool:
        """Whether commands are drawn or updated within an episode."""
        return bool(self._timers or self._updates)

    def step(self, env_ids: EnvIndex | None = None) -> list[EnvIndex | None]:
        """Count one control step, draw the commands that are due, and update all.

        Args:
            env_ids: (n,) environments whose episode goes on, or None for all.

        Returns:
            The environments of each command that was drawn or updated; None is all.
        """
        changed: list[EnvIndex | None] = []
        for name, timer in self._timers.items():
            due = timer.advance(env_ids)
            if len(due):
                drawing_ids = None if self.env.arrays.are_all(due, self.num_envs) else due
                self._run(self.terms[name], "command", drawing_ids)
                changed.append(drawing_ids)
        self._update(env_ids)
        if self._updates and (env_ids is None or len(env_ids)):
            changed.append(env_ids)
        return changed

    def measure(self, env_ids: EnvIndex | None = None) -> None:
        """Count one control step in the metrics of the commands that were acted on.

        Args:
            env_ids: (n,) environments that stepped, or None for all.
        """
        if not self._measured:
            return
        _add(self._steps, 1.0, env_ids)
        for name, metrics in self._measured:
            for key, value in metrics().items():
                total = self._sums.get(f"{name}/{key}")
                if total is None:
                    total = np.zeros_like(self._steps)
                    self._sums[f"{name}/{key}"] = total
                _add(total, value if env_ids is None else value[env_ids], env_ids)

    def report(self, metrics: dict[str, NDArray[Any]]) -> None:
        """Add the means over the episode so far, this step included.

        Args:
            metrics: Gains ``COMMAND/METRIC`` -> (N,) float32.
        """
        count = np.maximum(self._steps, 1.0)
        for name, total in self._sums.items():
            metrics[name] = (total / count).astype(np.float32)

    @property
    def has_metrics(self) -> bool:
        """Whether a command measures how well it is followed."""
        return bool(self._measured)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Start the episode of these environments; `resample` draws, after reset events."""
        super().reset(env_ids)
        where: Any = slice(None) if env_ids is None else env_ids
        self._steps[where] = 0.0
        for total in self._sums.values():
            total[where] = 0.0

    def _run(self, term: BuiltTerm[CommandCfg], mode: str, env_ids: EnvIndex | None) -> None:
        self._call(term, mode, env_ids, arguments=(env_ids,))
        timer = self._timers.get(term.name)
        range_s = term.cfg.resampling_time_s
        if timer is not None and range_s is not None:
            low, high = range_s
            stream = f"commands.{term.name}.interval"
            seconds = self.env.streams.uniform(stream, (), low, high, env_ids)
            timer.start(env_ids, seconds)

    def update(self, env_ids: EnvIndex | None) -> None:
        """Adjust the commands of environments to a restored state."""
        self._update(env_ids)

    def _update(self, env_ids: EnvIndex | None) -> None:
        for name, update in self._updates:
            try:
                update(env_ids)
            except FAILURES as error:
                self.fail(name, error, env_ids)

    def not_finite(self, rows: NDArray[np.bool_]) -> dict[str, tuple[str, NDArray[np.bool_]]]:
        """Commands that are not finite in some environments.

        Args:
            rows: (N,) the environments.

        Returns:
            ``commands.NAME`` -> what its values are, and in which environments, (N,).
        """
        causes: dict[str, tuple[str, NDArray[np.bool_]]] = {}
        for name in self.terms:
            values = self.values(name)
            bad = rows & ~np.isfinite(values).all(axis=1)
            if bad.any():
                causes[f"{self.section}.{name}"] = (kind_of_values(values[bad]), bad)
        return causes

    # -- saving --------------------------------------------------------------------------------

    def state_dict(self) -> dict[str, Any]:
        """Commands, timers and sums (copies)."""
        return {
            **super().state_dict(),
            "left": {name: timer.left.copy() for name, timer in self._timers.items()},
            "sums": {name: total.copy() for name, total in self._sums.items()},
            "steps": self._steps.copy(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        for name, timer in self._timers.items():
            timer.left[:] = state["left"][name]
        self._sums = {name: total.copy() for name, total in state["sums"].items()}
        self._steps[:] = state["steps"]


def _add(totals: Floats, values: Floats | float, env_ids: EnvIndex | None) -> None:
    """Add values (n,) to the totals of environments (n,), None for all."""
    if env_ids is None:
        totals[...] = totals + values  # one number in place takes three times as long
    else:
        totals[env_ids] += values
