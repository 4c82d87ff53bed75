"""`Noise`: random numbers that change an observation or an action."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import NoiseCfg
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.base import F64, EnvIndex
    from embodichain.utils.random import RandomStreams

__all__ = ["Noise", "first_given"]

F32 = NDArray[np.float32]


def first_given(*values: Any) -> Any:
    """Return the first value that is not None, or None."""
    return next((value for value in values if value is not None), None)


class Noise:
    """Draws noise for environments that step, each from its own stream, and applies it.

    The last draw is stored: an observation between two steps has the same noise again.

    Args:
        cfg: What kind of noise.
        shape: Of one environment's value.
        path: Key path of the value: the name of its stream, and for messages.
        streams: The environment's random numbers.

    Attributes:
        last: (N, ...) float32, the last draw.

    Raises:
        ConfigError: If a list has another length than the value's last dimension.
    """

    def __init__(
        self, cfg: NoiseCfg, shape: tuple[int, ...], path: str, streams: RandomStreams
    ) -> None:
        self._operation = cfg.operation
        self._gaussian = cfg.type == "gaussian"
        self._stream = f"{path}.noise"
        self._streams = streams
        self._shape = (streams.num_envs, *shape)
        self._width = int(np.prod(shape, dtype=np.int64))

        def sized(*names: str) -> F64:
            return _sized(cfg, names, shape, path)

        self._draws = cfg.type != "constant"
        if self._gaussian:
            self._low, self._high = sized("mean"), sized("std")
        elif self._draws:
            self._low, self._high = sized("low", "n_min"), sized("high", "n_max")
        else:
            self._low = self._high = sized("bias")
        # Before the first draw nothing changes; a value that is replaced is the lower bound.
        start: Any = {"add": 0.0, "scale": 1.0, "abs": self._low}[cfg.operation]
        rows = np.broadcast_to(start if self._draws else self._low, (streams.num_envs, self._width))
        self.last = self._shaped(rows)

    def _shaped(self, rows: NDArray[np.float64]) -> F32:
        return rows.astype(np.float32).reshape(-1, *self._shape[1:])

    def apply(self, value: NDArray[Any], rows: EnvIndex | None) -> NDArray[Any]:
        """Return a value with noise.

        Args:
            value: (N, ...), left as it is.
            rows: (n,) environments that draw anew, or None for all.
        """
        if self._draws and (rows is None or len(rows)):
            drawn = self._shaped(self._draw(rows))
            if rows is None:
                self.last = drawn
            else:
                self.last[rows] = drawn
        if self._operation == "add":
            return value + self.last
        return value * self.last if self._operation == "scale" else self.last.copy()

    def _draw(self, rows: EnvIndex | None) -> F64:
        """(n, width) float64."""
        if self._gaussian:
            normal = self._streams.normal(self._stream, (self._width,), rows)
            return self._low + self._high * normal
        shape = (self._width,)
        return self._streams.uniform(self._stream, shape, self._low, self._high, rows)


def _sized(cfg: NoiseCfg, names: tuple[str, ...], shape: tuple[int, ...], path: str) -> F64:
    """(width,) read-only numbers of the first field that is given; a mean may be absent."""
    name = next((n for n in names if getattr(cfg, n) is not None), names[0])
    given = first_given(getattr(cfg, name), 0.0)
    width = shape[-1] if shape else 1
    if isinstance(given, list) and len(given) != width:
        message = f"has {len(given)} values; the observation's last dimension is {width}"
        raise ConfigError([Problem(f"{path}.noise.{name}", message)])
    array: F64 = np.broadcast_to(np.asarray(given, np.float64), shape or (1,)).reshape(-1).copy()
    array.setflags(write=False)
    return array
