"""Random numbers of events and commands, and the times at which they are due.

`DrawingManager` gives each term a random stream of its own and logs what it draws, `Uniform` is a
range that a term draws from, `Timer` counts control steps.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import TermCfg
from embodichain.lab.gym.envs.managers.base import BuiltTerm, Manager
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import Draws, TermContext
    from embodichain.lab.gym.envs.managers.registry import Kind
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["DrawingManager", "Timer", "Uniform", "constant"]

C = TypeVar("C", bound=TermCfg)


def constant(values: Any) -> F64:
    """A read-only float64 copy: streams scale many draws at once by bounds that cannot change."""
    array = np.array(values, np.float64)
    array.setflags(write=False)
    return array


class Uniform:
    """Numbers that a term draws uniformly, logged under a name.

    Args:
        name: Name in the log.
        low: Scalar or array, of the shape of one environment's draw.
        high: Likewise; exclusive.

    Attributes:
        low, high: Those, read-only float64.
    """

    def __init__(self, name: str, low: Any, high: Any) -> None:
        self.name = name
        self.low, self.high = constant(low), constant(high)

    @classmethod
    def within(
        cls, name: str, bounds: Sequence[Any] | None, degrees: bool = False
    ) -> Uniform | None:
        """The numbers of a parameter [low, high], or of a box [[...], [...]]; None for None.

        Args:
            name: Name in the log.
            bounds: The parameter; [low, high] is a draw of shape (1,).
            degrees: Whether the bounds are in degrees; draws are in rad.
        """
        if bounds is None:
            return None
        low, high = (np.atleast_1d(np.asarray(bound, np.float64)) for bound in bounds)
        return cls(name, *(np.deg2rad(low), np.deg2rad(high)) if degrees else (low, high))

    def __call__(self, draws: Draws, env_ids: EnvIndex | None) -> F64:
        """(n, ...) numbers for the environments given, or for all. Do not write into it."""
        return draws.draw(self.name, self.low.shape, self.low, self.high, env_ids)


class DrawingManager(Manager[C]):
    """A manager whose terms draw random numbers while they are called.

    A term draws by `draw` from a stream named ``SECTION.TERM``, so that adding, removing or
    reordering terms changes no other term's numbers. What it drew goes to the environment's
    observers.
    """

    def __init__(self, env: TermContext, section: str, kind: Kind, cfgs: Mapping[str, C]) -> None:
        self._stream = ""
        self._drawn: dict[str, NDArray[Any]] = {}
        self._recorded: Mapping[str, NDArray[Any]] = {}
        super().__init__(env, section, kind, cfgs)

    @abstractmethod
    def _run(self, term: BuiltTerm[C], mode: str, env_ids: EnvIndex | None) -> None:
        """Call a term, by `_call`, and do what follows from it."""

    def _call(self, term: BuiltTerm[C], mode: str, env_ids: EnvIndex | None, *args: Any) -> None:
        """Call a term with a stream of its own, and log what it drew."""
        self._stream = f"{self.section}.{term.name}"
        self._drawn = {}
        try:
            term.call(*args)
        except ConfigError as error:
            where = f"{self.section}.{term.name}.params"
            raise ConfigError(
                Problem(f"{where}.{p.path}".rstrip("."), p.message, p.hint) for p in error.problems
            ) from error
        if self.env.observers:
            self.env.log_event(term.name, mode, env_ids, self._drawn)

    def draw(
        self, what: str, shape: Sequence[int], low: Any, high: Any, env_ids: EnvIndex | None
    ) -> F64:
        """Draw uniform numbers for the term that is being called, and have them logged.

        Args:
            what: What they are, for the log: ``position``.
            shape: Shape of one environment's draw.
            low: Scalar or array that broadcasts to ``shape``.
            high: Likewise; exclusive.
            env_ids: (n,) environments that draw, or None for all.

        Returns:
            (n, *shape) float64. Do not write into it.
        """
        values = self._replayed(what, shape, env_ids) if self._recorded else None
        if values is None:
            values = self.env.streams.uniform(self._stream, shape, low, high, env_ids)
        self._drawn[what] = values
        return values

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
        found = [self._replayed(n, (c.stop - c.start,), env_ids) for n, c in columns.items()]
        known = [values for values in found if values is not None]
        values: F64
        if known and len(known) == len(found):
            values = np.concatenate(known, axis=1)
        elif normal:
            values = self.env.streams.normal(self._stream, (len(low),), env_ids)
            values = np.clip(0.5 * (low + high) + (high - low) / 6.0 * values, low, high)
        else:
            values = self.env.streams.uniform(self._stream, (len(low),), low, high, env_ids)
        for name, where in columns.items():
            self._drawn[name] = values[:, where]
        return values

    def _replayed(self, what: str, shape: Sequence[int], env_ids: EnvIndex | None) -> F64 | None:
        """(n, *shape) what a replayed term drew, or None."""
        given = self._recorded.get(what)
        if given is None or given.shape != tuple(shape):
            return None
        n = self.num_envs if env_ids is None else len(env_ids)
        return np.tile(given, (n, *[1] * len(shape)))

    def replay(
        self, name: str, mode: str, env_ids: EnvIndex | None, drawn: Mapping[str, NDArray[Any]]
    ) -> None:
        """Call a term with numbers that were drawn before, when a log was recorded.

        Args:
            name: The term.
            mode: The mode in which it was called.
            env_ids: (n,) environments, or None for all.
            drawn: What one environment drew, by name; what is not here is drawn anew.
        """
        self._recorded = drawn
        try:
            self._run(self.terms[name], mode, env_ids)
        finally:
            self._recorded = {}


class Timer:
    """Control steps until something is due, in each environment.

    Args:
        count: N, or 1 for a timer that all environments share.
        step_dt: Seconds of a control step.

    Attributes:
        left: (count,) int64 control steps; 0 where the timer was not started.
    """

    def __init__(self, count: int, step_dt: float) -> None:
        self.left: NDArray[np.int64] = np.zeros(count, np.int64)
        self._step_dt = step_dt

    def start(self, env_ids: EnvIndex | None, seconds: F64) -> None:
        """Start it for (n,) seconds, rounded to control steps, at least one."""
        steps = np.maximum(1, np.rint(seconds / self._step_dt)).astype(np.int64)
        self.left[slice(None) if env_ids is None else env_ids] = steps

    def advance(self, env_ids: EnvIndex | None, steps: NDArray[np.int64] | int = 1) -> EnvIndex:
        """Count control steps.

        Args:
            env_ids: (n,) sorted environments that took them, or None for all.
            steps: How many, one number or (n,).

        Returns:
            Those of the environments in which it is due, sorted.
        """
        if env_ids is None:
            self.left -= steps
            return np.flatnonzero(self.left <= 0)
        self.left[env_ids] -= steps
        return env_ids[self.left[env_ids] <= 0]
