"""`StepGraph`: the control step of an environment on a GPU as one CUDA graph.

A step launches hundreds of small kernels from Python, which takes longer than they run. Captured
once as a graph, they are launched together. All decisions of the step are made by masks on the
device, so that the launches are the same in every step.

What an environment keeps between steps must stay at its address. Where a step replaces an array
that it has read before, the graph copies the new numbers into the old array.
"""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, cast

import torch

from embodichain.lab.gym.envs.managers.terms.term_errors import KeySources
from embodichain.lab.gym.envs.observers import StepObserver
from embodichain.lab.gym.envs.on_device.kept_arrays import HostValue, Path, Place, kept_arrays
from embodichain.lab.sim.engine.device.device_array import DeviceArray, EnvMask

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observation import Observation
    from embodichain.lab.gym.envs.observers import ObservedEnv
    from embodichain.lab.sim.engine.warp.device_engine import DeviceEngine
    from embodichain.lab.sim.types import EnvObs

__all__ = ["StepGraph"]

logger = logging.getLogger(__name__)
_WARM_UP = 2
"""Steps before those that are observed and captured: they load kernels and make constants."""
_COUNTERS = {
    "control_step",
    "version",
    "_version",
    "_all_changed",
    "physics_seconds",
    "_any_dirty",
    "arrays_moved",
    "_views_made",
}
"""Numbers of the host that change from step to step, and do not decide what a step launches: they
only count, or `revision` contains them."""


Step = tuple["EnvObs", torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]


class StepGraph:
    """Steps an environment, from its fourth step on by a CUDA graph.

    Args:
        env: An environment with arrays on a CUDA device.

    Attributes:
        reason: Why steps are not captured, or an empty string.
    """

    def __init__(self, env: ObservedEnv) -> None:
        self._env = env
        self._engine = cast("DeviceEngine", env.sim.engine)
        self._left = _WARM_UP
        self._graph: torch.cuda.CUDAGraph | None = None
        self._kept: dict[Path, Any] = {}
        self._revision: Any = None
        self._numbers: dict[Path, HostValue] = {}
        self._version = -1
        self.reason = ""

    def step(
        self,
        run: Callable[[torch.Tensor], Step],
        action: torch.Tensor,
        *,
        arrays_moved: bool,
        forget: Callable[[], None],
    ) -> Step:
        """Take a control step.

        Args:
            run: Takes a step by launching its kernels. It is not called where a graph is replayed.
            action: (N, A) on the device.
            arrays_moved: Whether code outside of steps may have replaced arrays since the last one.
            forget: Undoes what Python did in `run`, after a capture that failed: the numbers of
                that step were not computed.

        Returns:
            What `run` returns. Observation, reward and flags are copies; ``info`` is valid until
            the next step.
        """
        self._engine.check_memory()
        if self._graph is not None and not self._make_valid(arrays_moved):
            self._graph = None
            self._revision = None
            self._left = 1
        if self.reason or self._left:
            self._left = max(self._left - 1, 0)
            return run(action)
        if self._graph is None:
            if self._revision is None:
                return self._observe(run, action)
            self._capture(run, action, forget)
            if self._graph is None:
                return run(action)
        self._action.copy_(action)
        self._graph.replay()
        obs, reward, terminated, truncated, info = self._result
        observation = cast("Observation", obs).copy()
        return observation, reward.clone(), terminated.clone(), truncated.clone(), dict(info)

    def _observe(self, run: Callable[[torch.Tensor], Step], action: torch.Tensor) -> Step:
        """Take a step, and find the arrays that it reads and replaces."""
        self._kept.clear()
        before, numbers = self._places()
        watched: dict[Path, tuple[Any, Any]] = {}
        for path, place in before.items():
            value = place.get()
            stand_in = _Watched(value.tensor) if isinstance(value, DeviceArray) else value
            watched[path] = (value, stand_in)
            place.set(stand_in)
        self._revision = ()
        result = run(action)
        after, numbers_after = self._places()
        changing: list[Path] = []
        for path, (value, stand_in) in watched.items():
            # Of a tensor that is not in a `DeviceArray` it is not known: it counts as read.
            was_read = stand_in.was_read if isinstance(stand_in, _Watched) else True
            now = after[path].get() if path in after else None
            if now is stand_in:
                after[path].set(value)
            elif was_read and now is None:
                self._give_up(f"a step removes {_shown(path)}, which it reads")
            elif was_read:
                changing.append(path)
        self._unwatch()
        self._check_numbers(numbers, numbers_after)
        self._changing = changing
        return result

    def _places(self) -> tuple[dict[Path, Place], dict[Path, HostValue]]:
        return kept_arrays(self._env, (StepGraph, EnvMask, StepObserver, KeySources))

    def _unwatch(self) -> None:
        """Replace what still watches, such as arrays in new containers."""
        for place in self._places()[0].values():
            value = place.get()
            if isinstance(value, _Watched):
                place.set(DeviceArray(value.tensor))

    def _check_numbers(self, before: dict[Path, HostValue], after: dict[Path, HostValue]) -> None:
        for path, value in _decisive(after).items():
            if before.get(path, value) != value:
                self._give_up(f"a step changes {_shown(path)}, which is on the host")

    def _give_up(self, reason: str) -> None:
        self.reason = self.reason or reason
        logger.warning("steps are not captured as a CUDA graph: %s", reason)

    def _capture(
        self,
        run: Callable[[torch.Tensor], Step],
        action: torch.Tensor,
        forget: Callable[[], None],
    ) -> None:
        """Capture a step; its launches run when the graph is replayed."""
        places = self._places()[0]
        self._action = action.clone()
        # Each gets memory of its own: two places may hold the same array.
        for path in self._changing:
            value = places[path].get()
            self._kept[path] = value.copy() if isinstance(value, DeviceArray) else value.clone()
            places[path].set(self._kept[path])
        graph = torch.cuda.CUDAGraph()
        saved = {path: place.get() for path, place in places.items()}
        collecting = gc.isenabled()
        gc.collect()
        # What the garbage collector frees would be captured.
        gc.disable()
        try:
            with (
                torch.cuda.graph(graph, capture_error_mode="thread_local"),
                self._engine.capturing() as self._memory,
            ):
                self._result = run(self._action)
                self._keep()
        except (TypeError, ValueError, RuntimeError) as error:
            torch.cuda.synchronize()
            forget()
            now = self._places()[0]
            for path, value in saved.items():
                if path in now:
                    now[path].set(value)
            self._give_up(f"{type(error).__name__}: {error}")
            return
        finally:
            if collecting:
                gc.enable()
        self._graph = graph
        self._revision = self._env.revision
        self._numbers = _decisive(self._places()[1])
        self._version = self._engine.version

    def _keep(self) -> None:
        """Copy the arrays that replaced kept ones into these, and put the kept ones back."""
        places = self._places()[0]
        addresses = {_tensor(value).data_ptr() for value in self._kept.values()}
        moved: list[tuple[Place, Any, torch.Tensor]] = []
        for path, kept in self._kept.items():
            place = places.get(path)
            if place is None:
                raise ValueError(f"a step removes {_shown(path)}, which it reads")
            value = place.get()
            if value is kept:
                continue
            old = _tensor(kept)
            new = _tensor(value)
            if (new.shape, new.dtype) != (old.shape, old.dtype):
                change = f"{tuple(old.shape)} {old.dtype} to {tuple(new.shape)} {new.dtype}"
                raise ValueError(f"a step changes {_shown(path)} from {change}")
            if new.data_ptr() in addresses:
                # It is in the memory of a kept array, which the copies below overwrite.
                new = new.clone()
            moved.append((place, kept, new))
        for place, kept, new in moved:
            _tensor(kept).copy_(new)
            place.set(kept)

    def _make_valid(self, arrays_moved: bool) -> bool:
        """Take over changes by code outside of steps; return whether the graph is valid with them.

        Arrays that such code has put in place of kept arrays are copied into these. It may have
        written to the engine, or changed numbers of the host, such as whether drives have a largest
        velocity.
        """
        if self._revision != self._env.revision:
            return False
        if not arrays_moved and self._version == self._engine.version:
            return True
        self._version = self._engine.version
        places, numbers = self._places()
        if not self._kept.keys() <= places.keys() or _decisive(numbers) != self._numbers:
            return False
        for path, kept in self._kept.items():
            value = places[path].get()
            if value is not kept:
                _tensor(kept).copy_(_tensor(value))
                places[path].set(kept)
        return True


class _Watched(DeviceArray):
    """An array that notes whether it was read."""

    __slots__ = ("_numbers", "was_read")

    def __init__(self, tensor: torch.Tensor) -> None:
        self._numbers = tensor
        self.was_read = False

    @property
    def tensor(self) -> torch.Tensor:  # type: ignore[override]
        """The numbers."""
        self.was_read = True
        return self._numbers


def _tensor(value: Any) -> torch.Tensor:
    return value.tensor if isinstance(value, DeviceArray) else value


def _decisive(numbers: dict[Path, HostValue]) -> dict[Path, HostValue]:
    """Return the numbers of the host that may decide what a step computes."""
    return {path: value for path, value in numbers.items() if path[-1] not in _COUNTERS}


def _shown(path: Path) -> str:
    return ".".join(map(str, path))
