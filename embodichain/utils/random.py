"""Random numbers that depend only on seed, environment, stream name and number of earlier draws.

A stream has one counter per environment; a draw hashes (key, counter) with SplitMix64's finalizer
(Steele, Lea and Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014). There is
no generator object per environment and no global state, so environment *i* gets the same numbers
for any number of environments and regardless of which others draw.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.utils.array_types import EnvIndex
from embodichain.utils.short_repr import short_repr

__all__ = [
    "GAMMA",
    "RandomStreams",
    "constant",
    "first_seed",
    "given_seed",
    "splitmix64",
    "stream_keys",
]

U64 = NDArray[np.uint64]
GAMMA = np.uint64(0x9E3779B97F4A7C15)
"""SplitMix64's increment."""
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX2 = np.uint64(0x94D049BB133111EB)
_S30 = np.uint64(30)
_S27 = np.uint64(27)
_S31 = np.uint64(31)
_S11 = np.uint64(11)
_UNIT = 2.0**-53
_BLOCK = 8192
"""Maximum of numbers computed ahead; a small draw costs as much as a thousand numbers."""


def splitmix64(z: U64) -> U64:
    """SplitMix64's output function, in place."""
    z ^= z >> _S30
    z *= _MIX1
    z ^= z >> _S27
    z *= _MIX2
    z ^= z >> _S31
    return z


def _unit(bits: U64) -> NDArray[np.float64]:
    """Convert the upper 53 bits to a number in [0, 1)."""
    return (bits >> _S11).astype(np.float64) * _UNIT


def _fixed(bound: Any) -> bool:
    """Whether a bound is immutable."""
    return isinstance(bound, np.ndarray) and not bound.flags.writeable


def constant(values: Any) -> NDArray[np.float64]:
    """A read-only float64 copy: for immutable bounds, streams scale many draws at once."""
    array = np.array(values, np.float64)
    array.setflags(write=False)
    return array


class _Block:
    """Numbers of one stream for several draws in all environments, (draws, N, width)."""

    __slots__ = ("high", "low", "unit", "used", "values", "width")

    def __init__(self, unit: NDArray[np.float64], width: int) -> None:
        self.unit = unit
        self.width = width
        self.used = 0
        self.low: Any = None
        self.high: Any = None
        self.values = unit

    def take(self) -> NDArray[np.float64]:
        """The next draw, (N, width) in [0, 1); read only."""
        self.used += 1
        return self.unit[self.used - 1]

    def take_within(self, low: Any, high: Any) -> NDArray[np.float64]:
        """The next draw, (N, width) in [low, high); read only.

        Immutable bounds scale the whole block at their first use.
        """
        row = self.used
        self.used += 1
        if low is not self.low or high is not self.high:
            if not (_fixed(low) and _fixed(high)):
                return _scaled(self.unit[row], low, high)
            self.low = low
            self.high = high
            self.values = _scaled(self.unit, low, high)
            self.values.setflags(write=False)
        return self.values[row]


def _scaled(unit: NDArray[np.float64], low: Any, high: Any) -> NDArray[np.float64]:
    low = np.asarray(low, np.float64)
    values: NDArray[np.float64] = unit * (high - low)
    values += low
    return values


def first_seed(seed: int | None) -> int:
    """Return the initial seed: 0 for None, a random one for -1."""
    if seed == -1:
        return int(np.random.SeedSequence().generate_state(1, np.uint32)[0])
    return 0 if seed is None else int(seed)


def given_seed(seed: Any) -> int:
    """Return the seed that a user gave; a random one for -1.

    Raises:
        ValueError: If it is not an integer.
    """
    if not isinstance(seed, (int, np.integer)) or isinstance(seed, bool):
        raise ValueError(
            f"seed must be one integer (each environment has its own stream): {seed!r}"
        )
    return first_seed(int(seed))


def stream_keys(seed: int, name: str, numbers: U64) -> U64:
    """(n,) keys of a stream for environments with these numbers."""
    digest = hashlib.blake2b(f"{seed}\0{name}".encode(), digest_size=8).digest()
    base = np.uint64(int.from_bytes(digest, "little"))
    return splitmix64(splitmix64((numbers + np.uint64(1)) * GAMMA) + base)


class RandomStreams:
    """Named counter-based streams for N environments.

    Args:
        seed: Any integer.
        num_envs: N.
        first: Number of the first environment: environment *i* draws as environment first + i of
            a larger batch, see `renumber`.
    """

    def __init__(self, seed: int, num_envs: int, first: int = 0) -> None:
        self.seed = int(seed)
        self.num_envs = num_envs
        self._first = first
        self._numbers = np.arange(first, first + num_envs, dtype=np.uint64)
        self._keys: dict[str, U64] = {}
        self._counters: dict[str, U64] = {}
        self._steps: dict[int, U64] = {}
        self._blocks: dict[str, _Block] = {}

    def __repr__(self) -> str:
        """Return the seed and N."""
        return short_repr(self, seed=self.seed, num_envs=self.num_envs)

    def _stream(self, name: str) -> tuple[U64, U64]:
        keys = self._keys.get(name)
        if keys is None:
            keys = self._keys[name] = stream_keys(self.seed, name, self._numbers)
            self._counters[name] = np.zeros(self.num_envs, np.uint64)
        return keys, self._counters[name]

    def renumber(self, env_ids: EnvIndex, numbers: NDArray[np.int64]) -> None:
        """Let environments draw from now on what others would draw at their start.

        Environment *i* draws as environment first + i of any batch with this seed, unless it gets
        another number.

        Args:
            env_ids: (n,) environments.
            numbers: (n,) their new numbers, from 0; they may be larger than N.
        """
        for name in list(self._blocks):
            self._settle(name)
        self._numbers[env_ids] = numbers.astype(np.uint64)
        for name, keys in self._keys.items():
            keys[env_ids] = stream_keys(self.seed, name, self._numbers[env_ids])
            self._counters[name][env_ids] = 0

    def bits(self, name: str, width: int, env_ids: EnvIndex | None = None) -> U64:
        """Return (n, width) random 64-bit words and advance the environments' counters."""
        keys, counters = self._stream(name)
        self._settle(name)
        steps = self._steps.get(width)
        if steps is None:
            steps = self._steps[width] = np.arange(1, width + 1, dtype=np.uint64) * GAMMA
        if env_ids is None:
            start = keys + counters * GAMMA
            counters += np.uint64(width)
        else:
            start = keys[env_ids] + counters[env_ids] * GAMMA
            counters[env_ids] += np.uint64(width)
        return splitmix64(start[:, None] + steps)

    def uniform(
        self,
        name: str,
        shape: Sequence[int] = (),
        low: Any = 0.0,
        high: Any = 1.0,
        env_ids: EnvIndex | None = None,
    ) -> NDArray[np.float64]:
        """Draw uniformly from [low, high).

        Args:
            name: The stream.
            shape: Shape of one environment's draw.
            low: Scalar or array that broadcasts to ``shape``.
            high: As `low`.
            env_ids: (n,) environments that draw; None is all N. `DeviceStreams` takes a mask.

        Returns:
            (n, *shape) float64; do not write to it.
        """
        if env_ids is None and len(shape) == 1:
            block = self._blocks.get(name)
            if block is None or block.width != shape[0] or block.used == len(block.unit):
                block = self._block(name, shape[0])
            return block.take_within(low, high)
        width = 1
        for size in shape:
            width *= size
        if env_ids is None:
            unit = self._block(name, width).take()
        else:
            unit = _unit(self.bits(name, width, env_ids))
        if len(shape) != 1:
            unit = unit.reshape(len(unit), *shape)
        return _scaled(unit, low, high)

    def _block(self, name: str, width: int) -> _Block:
        """Return a block of draws for all environments with at least one draw left.

        The numbers are those of `bits`; a block only avoids many small array operations.
        """
        block = self._blocks.get(name)
        if block is None or block.width != width or block.used == len(block.unit):
            self._settle(name)
            count = max(1, _BLOCK // max(1, self.num_envs * width))
            keys, counters = self._stream(name)
            draws = np.arange(count, dtype=np.uint64) * np.uint64(width)
            start = keys + (counters + draws[:, None]) * GAMMA
            steps = np.arange(1, width + 1, dtype=np.uint64) * GAMMA
            block = self._blocks[name] = _Block(_unit(splitmix64(start[:, :, None] + steps)), width)
        return block

    def _settle(self, name: str) -> None:
        """Advance the counters by the draws from a stream's block, and drop the block."""
        block = self._blocks.pop(name, None)
        if block is not None:
            self._counters[name] += np.uint64(block.used * block.width)

    def normal(
        self, name: str, shape: Sequence[int] = (), env_ids: EnvIndex | None = None
    ) -> NDArray[np.float64]:
        """Draw standard normal numbers (Box-Muller), (n, *shape) float64."""
        width = int(np.prod(shape, dtype=np.int64))
        unit = _unit(self.bits(name, 2 * width, env_ids))
        # Contiguous copies: numpy's transcendental functions may round strided input differently.
        radius = np.sqrt(-2.0 * np.log1p(-np.ascontiguousarray(unit[:, :width])))
        angle = np.cos(2.0 * np.pi * np.ascontiguousarray(unit[:, width:]))
        return (radius * angle).reshape(len(unit), *shape)

    def state_dict(self) -> dict[str, Any]:
        """Return the seed, the environments' numbers and every stream's counters (copies)."""
        counters = {name: values.copy() for name, values in self._counters.items()}
        for name, block in self._blocks.items():
            counters[name] += np.uint64(block.used * block.width)
        return {"seed": self.seed, "numbers": self._numbers.copy(), "counters": counters}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue exactly where `state_dict` was taken."""
        self.seed = int(state["seed"])
        self._numbers = np.arange(self._first, self._first + self.num_envs, dtype=np.uint64)
        if "numbers" in state:  # absent from older training states
            self._numbers[:] = state["numbers"]
        self._keys.clear()
        self._counters.clear()
        self._blocks.clear()
        for name, counters in state["counters"].items():
            self._stream(name)[1][:] = counters

    def reseed(self, seed: Any) -> None:
        """Restart every stream with a new seed.

        Raises:
            ValueError: If the seed is not an integer.
        """
        self.load_state_dict({"seed": given_seed(seed), "counters": {}})

    def save_counters(self) -> dict[str, Any]:
        """Copy all counters, for `rewind`."""
        return self.state_dict()

    def rewind(self, saved: dict[str, Any], rows: NDArray[np.bool_]) -> None:
        """Restore the counters of some environments from a saved state.

        Args:
            saved: An earlier `save_counters` with the same seed.
            rows: (N,) boolean mask of environments.
        """
        now = self.state_dict()
        changed = False
        for name, counters in now["counters"].items():
            old = saved["counters"].get(name, np.zeros_like(counters))
            if not np.array_equal(old, counters):
                counters[rows] = old[rows]
                changed = True
        if changed:
            self.load_state_dict(now)

    def take_back(self, before: dict[str, Any], after: dict[str, Any]) -> None:
        """Undo the draws between two saved states, and none of those after them.

        Args:
            before: An earlier `save_counters` with the same seed.
            after: A later one.
        """
        now = self.state_dict()
        changed = False
        for name, counters in after["counters"].items():
            drawn = counters - before["counters"].get(name, np.zeros_like(counters))
            if drawn.any():
                now["counters"][name] -= drawn
                changed = True
        if changed:
            self.load_state_dict(now)
