"""Processing of actions and observations: noise, delay, history."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import ActionTermCfg, ConstantNoiseCfg, GaussianNoiseCfg, NoiseCfg
from embodichain.utils.arrays import may_be_set, tensor_of
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.terms.term_columns import TermColumns
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.utils.array_types import Floats
    from embodichain.utils.arrays import Arrays
    from embodichain.utils.random import RandomStreams

__all__ = [
    "ActionPipeline",
    "Advancing",
    "Delay",
    "Noise",
    "Past",
    "first_given",
]

F32 = NDArray[np.float32]


def first_given(*values: Any) -> Any:
    """Return the first value that is not None, or None."""
    return next((value for value in values if value is not None), None)


class Noise:
    """Draws noise for environments that step, each from its own stream, and applies it.

    The last draw is stored: an observation between two steps has the same noise again.

    Args:
        cfg: The kind of noise.
        shape: Shape of one environment's value.
        path: Key path of the value: the name of its stream, also used in messages.
        streams: The environment's random numbers.
        arrays: Makes the arrays.
        columns: The names of the value's columns.

    Attributes:
        last: (N, ...) float32, the last draw.

    Raises:
        ConfigError: If a list has another length than the value's last dimension.
    """

    def __init__(
        self,
        cfg: NoiseCfg,
        shape: tuple[int, ...],
        path: str,
        streams: RandomStreams,
        arrays: Arrays,
        columns: TermColumns,
    ) -> None:
        self._operation = cfg.operation
        self._gaussian = isinstance(cfg, GaussianNoiseCfg)
        self._stream = f"{path}.noise"
        self._streams = streams
        self._shape = (streams.num_envs, *shape)
        self._width = int(np.prod(shape, dtype=np.int64))
        self._is_vector = len(shape) == 1

        def sized(*names: str) -> Floats:
            return _sized(cfg, names, shape, path, columns)

        # The mean and the deviation of normal noise, the bounds of uniform, the value of constant.
        self._draws = not isinstance(cfg, ConstantNoiseCfg)
        if self._gaussian:
            self._low = sized("mean")
            self._high = sized("std")
        elif self._draws:
            self._low = sized("low", "n_min")
            self._high = sized("high", "n_max")
            self._require_order(path, columns)
        else:
            self._low = sized("bias")
            self._high = self._low
        # Before the first draw the value is unchanged, or the lower bound if noise replaces it.
        before_draws: Any = {"add": 0.0, "scale": 1.0, "abs": self._low}[cfg.operation]
        first = before_draws if self._draws else self._low
        rows = np.broadcast_to(first, (streams.num_envs, self._width))
        self.last = arrays.put(self._in_shape(rows))

    def _require_order(self, path: str, columns: TermColumns) -> None:
        """Refuse lower bounds above upper bounds; names the columns."""
        is_wrong = self._low > self._high
        if not is_wrong.any():
            return
        labels = columns.labels(self._width)
        wrong_columns = [labels[i] or str(i) for i in np.flatnonzero(is_wrong)]
        message = f"low exceeds high for {', '.join(wrong_columns)}"
        raise ConfigError([Problem(f"{path}.noise", message)])

    def _in_shape(self, rows: NDArray[np.float64]) -> F32:
        """(n, width) numbers as (n, ...) float32."""
        numbers: F32 = rows.astype(np.float32)
        return numbers if self._is_vector else numbers.reshape(-1, *self._shape[1:])

    def apply(self, value: NDArray[Any], rows: EnvIndex | None) -> NDArray[Any]:
        """Return a value with noise.

        Args:
            value: (N, ...), not changed.
            rows: (n,) environments that draw new noise, or None for all.
        """
        if self._draws and (rows is None or len(rows)):
            drawn = self._in_shape(self._draw(rows))
            if rows is None:
                self.last = drawn
            else:
                self.last[rows] = drawn
        if self._operation == "add":
            return value + self.last
        if self._operation == "scale":
            return value * self.last
        return self.last.copy()

    def _draw(self, rows: EnvIndex | None) -> Floats:
        """(n, width) float64."""
        if self._gaussian:
            normal = self._streams.normal(self._stream, (self._width,), rows)
            return self._low + self._high * normal
        shape = (self._width,)
        return self._streams.uniform(self._stream, shape, self._low, self._high, rows)


def _sized(
    cfg: NoiseCfg,
    names: tuple[str, ...],
    shape: tuple[int, ...],
    path: str,
    columns: TermColumns,
) -> Floats:
    """(width,) read-only numbers of the first given field; a mean may be absent."""
    name = next((name for name in names if getattr(cfg, name) is not None), names[0])
    value = first_given(getattr(cfg, name), 0.0)
    numbers = columns.numbers(value, shape, f"{path}.noise.{name}")
    array: Floats = np.broadcast_to(numbers, shape or (1,)).reshape(-1).copy()
    array.setflags(write=False)
    return array


@dataclass(frozen=True, slots=True)
class Advancing:
    """The environments whose noise, delay and history an observation advances.

    Attributes:
        stepped: (n,) environments that stepped or were reset, or None for all; empty for an
            observation between two steps.
        fresh: (N,) bool, environments whose episode has no earlier observation, or None.
    """

    stepped: EnvIndex | None
    fresh: NDArray[np.bool_] | None


class Past:
    """The last values of each environment, the oldest first.

    Args:
        num_envs: N.
        depth: Number of values.
        arrays: Makes the arrays.

    Attributes:
        values: (N, depth, ...), None before the first value.
    """

    def __init__(self, num_envs: int, depth: int, arrays: Arrays) -> None:
        self._num_envs = num_envs
        self._arrays = arrays
        self._depth = depth
        self.values: NDArray[Any] | None = None

    def append(
        self, value: NDArray[Any], advancing: Advancing, before: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """Append a value where environments stepped.

        Args:
            value: (N, ...), not changed.
            advancing: Environments that did not step keep their values; for fresh ones all values
                but the last are `before`.
            before: (N, ...); None is the value itself.

        Returns:
            (N, depth, ...): do not write into it.
        """
        newest = value[:, None]
        old = self.values
        if old is None:
            shape = (self._num_envs, self._depth, *value.shape[1:])
            old = self._arrays.full(shape, 0, value.dtype)
        moved = np.concatenate([old[:, 1:], newest], axis=1)
        stepped = self._arrays.full(self._num_envs, advancing.stepped is None, np.bool_)
        if advancing.stepped is not None:
            stepped[advancing.stepped] = True
            moved = np.where(_column(stepped, moved), moved, old)
        if advancing.fresh is not None:
            filled = newest if before is None else before[:, None]
            moved = np.where(_column(advancing.fresh, moved), filled, moved)
            moved[:, -1] = np.where(_column(advancing.fresh, value), value, moved[:, -1])
        # An observation between two steps changes nothing that is stored.
        self.values = (
            moved if advancing.stepped is None else np.where(_column(stepped, moved), moved, old)
        )
        return moved


def _column(mask: NDArray[np.bool_], like: NDArray[Any]) -> NDArray[np.bool_]:
    """Return a mask (N,) in the shape that broadcasts to an array (N, ...)."""
    return mask.reshape(-1, *[1] * (like.ndim - 1))


class Delay:
    """Delays values by some steps; at the start of an episode returns the value before it.

    Args:
        steps: Control steps, or [low, high]: each episode of each environment draws its own.
        stream: Name of its random stream.
        streams: The environment's random numbers.
        arrays: Makes the arrays.

    Attributes:
        past: The values that are still delayed.
        lag: (N,) int64 current delay in steps.
    """

    def __init__(
        self, steps: int | list[int], stream: str, streams: RandomStreams, arrays: Arrays
    ) -> None:
        if isinstance(steps, int):
            steps = [steps, steps]
        self._low, self._high = steps
        self._stream = stream
        self._streams = streams
        self.past = Past(streams.num_envs, self._high + 1, arrays)
        self.lag: NDArray[np.int64] = arrays.full(streams.num_envs, self._low, np.int64)
        self._rows = arrays.put(np.arange(streams.num_envs))

    def restart(self, env_ids: EnvIndex | None) -> Floats | None:
        """Draw the delay of a new episode.

        Args:
            env_ids: (n,) environments, or None for all.

        Returns:
            (n,) the delays in steps; None where they are not drawn.
        """
        if self._low == self._high:
            return None
        drawn = self._streams.uniform(self._stream, (), self._low, self._high + 1, env_ids)
        # A number just below the upper bound may round up to it.
        steps = np.minimum(drawn, self._high).astype(np.int64)
        self.lag[slice(None) if env_ids is None else env_ids] = steps
        return steps.astype(np.float64)

    def __call__(
        self, value: NDArray[Any], advancing: Advancing, before: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """(N, ...) the delayed value; `before` is the value before the first of an episode."""
        recent = self.past.append(value, advancing, before)
        return recent[self._rows, self._high - self.lag]


class ActionPipeline:
    """Delays the actions of one term by whole control steps, then adds noise.

    With a delay of d steps the term receives the action of d steps ago; in the first d steps of an
    episode, the one that keeps the present targets (`ActionTerm.hold`).

    Args:
        name: The term's name.
        cfg: Its declaration.
        columns: The names of its A columns.
        streams: Random numbers: each environment draws the delay once per episode, the noise in
            every step.
        arrays: Makes the arrays.

    Attributes:
        hold: Returns the action, (A,) or (N, A), that keeps the present targets.

    Raises:
        ConfigError: If a list of the noise does not have one value per column.
    """

    hold: Callable[[], Floats]

    def __init__(
        self,
        name: str,
        cfg: ActionTermCfg,
        columns: TermColumns,
        streams: RandomStreams,
        arrays: Arrays,
    ) -> None:
        self._arrays = arrays
        path = f"actions.{name}"
        self._delay: Delay | None = None
        if cfg.delay not in (0, [0, 0]):
            self._delay = Delay(cfg.delay, f"{path}.delay", streams, arrays)
        self._fresh: NDArray[np.bool_] = arrays.full(streams.num_envs, True, np.bool_)
        self._noise: Noise | None = None
        if cfg.noise is not None:
            self._noise = Noise(
                cfg.noise,
                shape=(len(columns.names),),
                path=path,
                streams=streams,
                arrays=arrays,
                columns=columns,
            )

    def __call__(self, action: torch.Tensor) -> torch.Tensor:
        """(N, A) float32 action that the term receives in this step."""
        values: NDArray[Any] = self._arrays.of(action)
        if self._delay is not None:
            advancing = Advancing(stepped=None, fresh=None)
            hold: NDArray[Any] | None = None
            if may_be_set(self._fresh):
                advancing = Advancing(stepped=None, fresh=self._fresh)
                hold = np.broadcast_to(self.hold(), values.shape)
                self._fresh = np.zeros_like(self._fresh)
            values = self._delay(values, advancing, hold).astype(np.float32)
        if self._noise is not None:
            values = self._noise.apply(values, None)
        return tensor_of(values)

    def reset(self, env_ids: EnvIndex | None) -> Floats | None:
        """Clear the delayed actions of these environments, and draw their delays.

        Args:
            env_ids: (n,) environments, or None for all.

        Returns:
            (n,) the delays in steps; None where they are not drawn.
        """
        self._fresh = self._fresh.copy()
        self._fresh[slice(None) if env_ids is None else env_ids] = True
        if self._delay is None:
            return None
        return self._delay.restart(env_ids)

    def state_dict(self) -> dict[str, Any]:
        """Delayed actions, and delays (copies)."""
        if self._delay is None:
            return {}
        past = self._delay.past.values
        return {
            "past": None if past is None else past.copy(),
            "lag": self._delay.lag.copy(),
            "fresh": self._fresh.copy(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        if self._delay is None:
            return
        past = state["past"]
        self._delay.past.values = None if past is None else past.copy()
        self._delay.lag[:] = state["lag"]
        self._fresh = state["fresh"].copy()
