"""`DeviceStreams`: the random numbers of `RandomStreams`, computed on a device.

A draw is one launch of a Warp kernel for all N environments; only those of a mask advance. Counters
stay at one address and change in place, and nothing is copied to the host, so draws can be captured
in a CUDA graph. Importing this module imports Warp (extra ``gpu``).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray

from embodichain.lab.sim.engine.device.device_array import DeviceArray, EnvMask
from embodichain.lab.sim.engine.warp.torch_stream import torch_stream
from embodichain.lab.sim.engine.warp.warp_support import start_warp
from embodichain.utils.random import given_seed, stream_keys

__all__ = ["DeviceStreams"]

# Contracted to one rounding, `unit * (high - low) + low` would differ from numpy's.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_GAMMA = wp.constant(wp.uint64(0x9E3779B97F4A7C15))
_MIX1 = wp.constant(wp.uint64(0xBF58476D1CE4E5B9))
_MIX2 = wp.constant(wp.uint64(0x94D049BB133111EB))
_UNIT = wp.constant(wp.float64(2.0**-53))
_TURN = wp.constant(wp.float64(2.0 * math.pi))
_STREAMS = 64
"""Streams that share an allocation."""


@wp.func  # type: ignore[untyped-decorator]
def _unit(start: wp.uint64, draw: int) -> wp.float64:
    """Number `draw`, from 0, in [0, 1) of a stream."""
    z = start + wp.uint64(draw + 1) * _GAMMA
    z = (z ^ (z >> wp.uint64(30))) * _MIX1
    z = (z ^ (z >> wp.uint64(27))) * _MIX2
    z = z ^ (z >> wp.uint64(31))
    return wp.float64(z >> wp.uint64(11)) * _UNIT


@wp.kernel  # type: ignore[untyped-decorator]
def _uniform(
    keys: wp.array[wp.uint64],
    counters: wp.array[wp.uint64],
    mask: wp.array[wp.bool],
    low: wp.float64,
    high: wp.float64,
    lows: wp.array2d[wp.float64],
    highs: wp.array2d[wp.float64],
    out: wp.array2d[wp.float64],
) -> None:
    i = wp.tid()
    width = out.shape[1]
    start = keys[i] + counters[i] * _GAMMA
    for j in range(width):
        if lows.shape[0] > 0:
            least = lows[i % lows.shape[0], j]
            most = highs[i % highs.shape[0], j]
            out[i, j] = _unit(start, j) * (most - least) + least
        else:
            out[i, j] = _unit(start, j) * (high - low) + low
    if mask[i]:
        counters[i] = counters[i] + wp.uint64(width)


@wp.kernel  # type: ignore[untyped-decorator]
def _normal(
    keys: wp.array[wp.uint64],
    counters: wp.array[wp.uint64],
    mask: wp.array[wp.bool],
    out: wp.array2d[wp.float64],
) -> None:
    i = wp.tid()
    width = out.shape[1]
    start = keys[i] + counters[i] * _GAMMA
    for j in range(width):
        # 1 - unit is exact, so the logarithm is that of numpy's log1p.
        radius = wp.sqrt(wp.float64(-2.0) * wp.log(wp.float64(1.0) - _unit(start, j)))
        out[i, j] = radius * wp.cos(_TURN * _unit(start, width + j))
    if mask[i]:
        counters[i] = counters[i] + wp.uint64(2 * width)


class _Block(NamedTuple):
    """Tensors (streams, N) int64 that hold the bits of unsigned numbers."""

    keys: torch.Tensor
    counters: torch.Tensor


class DeviceStreams:
    """Named counter-based streams for N environments, on a device.

    Uniform numbers equal those of `RandomStreams` to the bit; normal ones may differ in their last
    bits, as logarithm and cosine do. The first draw from a stream, and the first with an array of
    the host as bounds, copy to the device: they must come before a capture.

    Args:
        seed: Any integer.
        num_envs: N.
        device: ``cpu``, ``cuda`` or ``cuda:N``.
        first: Number of the first environment, see `RandomStreams`.
    """

    def __init__(self, seed: int, num_envs: int, device: str = "cpu", first: int = 0) -> None:
        start_warp()
        self.seed = int(seed)
        self.num_envs = num_envs
        self._device = torch.device(device)
        self._first = first
        self._numbers = np.arange(first, first + num_envs, dtype=np.uint64)
        self._names: list[str] = []
        self._streams: dict[str, tuple[wp.array, wp.array]] = {}
        self._blocks: list[_Block] = []
        self._bounds: dict[Any, tuple[Any, ...]] = {}
        self._all = torch.ones(num_envs, dtype=torch.bool, device=self._device)
        wp.load_module(sys.modules[__name__], device=str(self._device))

    # -- draws -------------------------------------------------------------------------------------

    def uniform(
        self,
        name: str,
        shape: Sequence[int] = (),
        low: Any = 0.0,
        high: Any = 1.0,
        env_ids: EnvMask | None = None,
    ) -> DeviceArray:
        """Draw uniformly from [low, high).

        Args:
            name: The stream.
            shape: Shape of one environment's draw.
            low: Number, or array of the host or the device, that broadcasts to ``shape`` or to
                (N, *shape). An array of the host that can be written to is copied at every draw.
            high: As `low`.
            env_ids: The environments whose counters advance; None is all N.

        Returns:
            (N, *shape) float64. Environments that do not advance will draw the same again.

        Raises:
            TypeError: If environments are given by index.
            RuntimeError: If something must be copied to the device while a graph is captured.
        """
        if np.isscalar(low) and np.isscalar(high):
            bounds = (float(low), float(high), None, None)  # type: ignore[arg-type]
        else:
            bounds = (0.0, 0.0, *self._arrays(name, low, high, tuple(shape)))
        return self._draw(_uniform, name, shape, env_ids, bounds)

    def normal(
        self, name: str, shape: Sequence[int] = (), env_ids: EnvMask | None = None
    ) -> DeviceArray:
        """Draw standard normal numbers (Box-Muller), (N, *shape) float64; see `uniform`."""
        return self._draw(_normal, name, shape, env_ids, ())

    def _draw(
        self,
        kernel: Any,
        name: str,
        shape: Sequence[int],
        env_ids: EnvMask | None,
        inputs: tuple[Any, ...],
    ) -> DeviceArray:
        mask = self._all if env_ids is None else _mask(env_ids)
        out = torch.empty(
            (self.num_envs, math.prod(shape)), dtype=torch.float64, device=self._device
        )
        wp.launch(
            kernel,
            self.num_envs,
            [*self._stream(name), wp.from_torch(mask), *inputs, wp.from_torch(out)],
            device=str(self._device),
            stream=torch_stream(self._device),
        )
        return DeviceArray(out.reshape(self.num_envs, *shape))

    def _arrays(self, name: str, low: Any, high: Any, shape: tuple[int, ...]) -> tuple[Any, Any]:
        """Bounds as arrays (1 or N, width) on the device; immutable ones are copied once."""
        fixed = all(np.isscalar(b) or _fixed(b) for b in (low, high))
        key = (shape, *(b if np.isscalar(b) else id(b) for b in (low, high)))
        if fixed and key in self._bounds:
            return self._bounds[key][0], self._bounds[key][1]
        low_rows = wp.from_torch(self._rows(name, low, shape))
        high_rows = wp.from_torch(self._rows(name, high, shape))
        if fixed:
            # The bounds too: an address is not reused.
            self._bounds[key] = (low_rows, high_rows, low, high)
        return low_rows, high_rows

    def _rows(self, name: str, bound: Any, shape: tuple[int, ...]) -> torch.Tensor:
        if isinstance(bound, DeviceArray):
            tensor = bound.tensor.to(torch.float64)
        else:
            self._need_no_capture(f"the bounds of random stream {name!r}")
            tensor = torch.from_numpy(np.array(bound, np.float64)).to(self._device)
        rows = self.num_envs if tensor.ndim > len(shape) else 1
        return tensor.broadcast_to(rows, *shape).reshape(rows, -1)

    def _stream(self, name: str) -> tuple[wp.array, wp.array]:
        """Keys and counters (N,) of a stream."""
        stream = self._streams.get(name)
        if stream is None:
            stream = self._add_stream(name)
            self._streams[name] = stream
        return stream

    def _add_stream(self, name: str) -> tuple[wp.array, wp.array]:
        self._need_no_capture(f"the keys of random stream {name!r}")
        row = len(self._names) % _STREAMS
        if row == 0:
            shape = (_STREAMS, self.num_envs)
            keys = torch.zeros(shape, dtype=torch.int64, device=self._device)
            self._blocks.append(_Block(keys, torch.zeros_like(keys)))
        self._names.append(name)
        keys, counters = self._blocks[-1]
        keys[row] = self._uploaded(stream_keys(self.seed, name, self._numbers))
        return wp.from_torch(keys[row], wp.uint64), wp.from_torch(counters[row], wp.uint64)

    def _need_no_capture(self, what: str) -> None:
        if torch.cuda.is_available() and torch.cuda.is_current_stream_capturing():
            raise RuntimeError(
                f"{what} are copied to the device at its first draw: draw before "
                "a graph is captured"
            )

    def _uploaded(self, words: NDArray[np.uint64]) -> torch.Tensor:
        return torch.from_numpy(words.view(np.int64)).to(self._device)

    # -- counters ----------------------------------------------------------------------------------

    def save_counters(self) -> list[torch.Tensor]:
        """Copy all counters on the device, for `rewind`."""
        return [block.counters.clone() for block in self._blocks]

    def rewind(self, saved: list[torch.Tensor], rows: EnvMask) -> None:
        """Restore the counters of some environments; streams that are newer begin again.

        Args:
            saved: An earlier `save_counters`.
            rows: The environments.
        """
        mask = _mask(rows)
        for i, (_, counters) in enumerate(self._blocks):
            old = saved[i] if i < len(saved) else torch.zeros_like(counters)
            torch.where(mask, old, counters, out=counters)

    def take_back(self, before: list[torch.Tensor], after: list[torch.Tensor]) -> None:
        """Undo the draws between two saved states, and none of those after them.

        Args:
            before: An earlier `save_counters`.
            after: A later one.
        """
        for i, counters in enumerate(after):
            drawn = counters - before[i] if i < len(before) else counters
            self._blocks[i].counters.sub_(drawn)

    def state_dict(self) -> dict[str, Any]:
        """Copy the state to the host, as `RandomStreams.state_dict`; waits for the device."""
        counters = [block.counters.cpu().numpy().view(np.uint64) for block in self._blocks]
        return {
            "seed": self.seed,
            "numbers": self._numbers.copy(),
            "counters": {
                name: counters[i // _STREAMS][i % _STREAMS].copy()
                for i, name in enumerate(self._names)
            },
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue exactly where `state_dict` was taken, here or of `RandomStreams`.

        Arrays stay where they are: a captured graph continues with the new state.
        """
        self.seed = int(state["seed"])
        self._numbers = np.arange(self._first, self._first + self.num_envs, dtype=np.uint64)
        if "numbers" in state:  # absent from older training states
            self._numbers[:] = state["numbers"]
        for name in state["counters"]:
            self._stream(name)
        self._write_keys()
        for i, name in enumerate(self._names):
            row = self._blocks[i // _STREAMS].counters[i % _STREAMS]
            words = state["counters"].get(name)
            if words is None:
                row.zero_()
            else:
                row.copy_(self._uploaded(np.array(words, np.uint64)))

    def _write_keys(self) -> None:
        for i, name in enumerate(self._names):
            words = self._uploaded(stream_keys(self.seed, name, self._numbers))
            self._blocks[i // _STREAMS].keys[i % _STREAMS] = words

    def reseed(self, seed: Any) -> None:
        """Restart every stream with a new seed.

        Raises:
            ValueError: If the seed is not an integer.
        """
        self.load_state_dict({"seed": given_seed(seed), "counters": {}})

    def renumber(self, env_ids: NDArray[np.int64], numbers: NDArray[np.int64]) -> None:
        """Let environments draw from now on what others would draw at their start.

        Args:
            env_ids: (n,) environments, on the host.
            numbers: (n,) their new numbers, from 0; they may be larger than N.
        """
        self._numbers[env_ids] = numbers.astype(np.uint64)
        self._write_keys()
        for block in self._blocks:
            block.counters[:, torch.from_numpy(env_ids).to(self._device)] = 0


def _mask(env_ids: Any) -> torch.Tensor:
    """(N,) bool.

    Raises:
        TypeError: If environments are not a mask.
    """
    if isinstance(env_ids, DeviceArray):
        return env_ids.tensor
    if not isinstance(env_ids, EnvMask):
        raise TypeError(f"environments on a device are an EnvMask, got {type(env_ids).__name__}")
    return env_ids.mask


def _fixed(bound: Any) -> bool:
    """Whether a bound is an array of the host that cannot change."""
    return isinstance(bound, np.ndarray) and not bound.flags.writeable
