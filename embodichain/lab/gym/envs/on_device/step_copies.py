"""`StepCopies`: what observers see of steps on a device, in one copy to the host for each.

While a step is computed, the arrays that observers need are gathered on the device, in the order in
which they got their values, by kernels that can be part of a CUDA graph. After the step they are
copied, and once they have arrived, observers are called (`CopiedEnv`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.value_managers import TermRows
from embodichain.lab.gym.envs.observers import EventRecord, StepObserver, StepRecord
from embodichain.lab.gym.envs.on_device.copied_env import CopiedEnv
from embodichain.lab.sim.engine.api import PhysicsEvent, Write
from embodichain.lab.sim.engine.device.device_values import TensorHolder
from embodichain.lab.sim.engine.device.packed_arrays import ArrayPacker, HostBuffers, Slot
from embodichain.utils.arrays import is_host

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv
    from embodichain.lab.sim.engine.warp.device_engine import DeviceEngine

__all__ = ["StepCopies"]

_INPUTS = frozenset(
    {"ctrl", "qfrc_applied", "xfrc_applied", "eq_active", "mocap_pos", "mocap_quat", "userdata"}
)
"""State components that physics does not write."""
_INFO = ("elapsed_steps", "success", "success_terminated", "fail", "diverged")
_GROUPS = ("rewards", "episode_sums", "metrics")
Values = dict[str, Any]


@dataclass(frozen=True)
class _Call:
    """One call of observers, with the arrays that it passes on.

    Attributes:
        kind: ``states``, ``fields``, ``commands``, ``reset begins``, ``reset``, ``physics``,
            ``event`` or ``step``.
        about: What is known on the host.
        slots: Name -> where an array is.
    """

    kind: str
    about: Mapping[str, Any] = field(default_factory=dict)
    slots: Mapping[str, Slot] = field(default_factory=dict)


class StepCopies(StepObserver):
    """Gathers, copies and reports the steps of an environment with arrays on a device.

    It is the environment's only observer, and a context in which a step is computed. Outside of
    steps everything is copied at once, waiting for the device.

    Args:
        env: The environment.

    Attributes:
        copied_env: The environment that observers see.
    """

    def __init__(self, env: Any) -> None:
        self.copied_env = CopiedEnv(env, self.flush)
        engine: DeviceEngine = env.sim.engine
        self._env = env
        self._engine = engine
        layout = {name: engine.component(name) for name in engine.state_names}
        self._names = tuple(name for name, part in layout.items() if part.stop > part.start)
        self._buffers: HostBuffers[tuple[list[_Call], Mapping[str, float]]] = HostBuffers(
            engine.device
        )
        self._packer = ArrayPacker()
        self._calls: list[_Call] = []
        self._written: dict[str, None] = {}  # state components since they were gathered
        self._fields: dict[str, None] = {}  # model fields likewise
        self._constants = False
        self._in_step = False
        self._packed: tuple[torch.Tensor, list[_Call]] | None = None  # of the last step

    # -- around a step -----------------------------------------------------------------------------

    def __enter__(self) -> None:
        """Before a step: copy what has happened since the last one."""
        self._send_rest()
        self._in_step = True

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """After a step: launch its copy; report those that have arrived."""
        self._in_step = False
        if error is not None or self._packed is None:
            self.restart()
            return
        packed, calls = self._packed
        self._send(packed, calls)
        self._receive(wait=False)

    def restart(self) -> None:
        """Forget what was gathered of a step that is not taken, or taken once more."""
        self._packer.clear()
        self._calls = []
        self._written = dict.fromkeys(self._names)
        self._fields = dict.fromkeys(self._engine.fields.written_names)

    def flush(self) -> None:
        """Report everything up to now; waits for the device."""
        self._send_rest()
        self._receive(wait=True)

    def _send_rest(self) -> None:
        """Copy what was gathered outside of steps."""
        self._gather_written()
        if self._calls:
            packed, calls = self._pack()
            self._send(packed, calls)
            self._receive(wait=True)

    def _pack(self) -> tuple[torch.Tensor, list[_Call]]:
        """Pack what was gathered; return it, and the calls that it belongs to."""
        calls = self._calls
        self._calls = []
        return self._packer.pack(), calls

    def _send(self, packed: torch.Tensor, calls: list[_Call]) -> None:
        if self._buffers.full:
            self._receive_oldest(wait=True)
        self._buffers.send(packed, (calls, self._env.reward_manager.weights))

    def _receive(self, *, wait: bool) -> None:
        while self._receive_oldest(wait=wait):
            pass

    def _receive_oldest(self, *, wait: bool) -> bool:
        """Report the oldest copy; False if there is none, or it has not arrived."""
        oldest = self._buffers.oldest
        if oldest is None:
            return False
        calls, weights = oldest
        slots = [slot for call in calls for slot in call.slots.values()]
        arrays = self._buffers.receive(slots, wait=wait)
        if arrays is None:
            return False
        # Each call takes as many of the arrays as it has slots.
        remaining = iter(arrays)
        values = [dict(zip(call.slots, remaining, strict=False)) for call in calls]
        self._report(calls, values, weights)
        return True

    # -- on the device -----------------------------------------------------------------------------

    def _add(self, kind: str, arrays: Mapping[str, Any], live: bool = False, **about: Any) -> None:
        """Gather arrays for a call; `live` ones may change within the step: they are copied now."""
        slots: dict[str, Slot] = {}
        for name, array in arrays.items():
            tensor = array.tensor if isinstance(array, TensorHolder) else array
            slots[name] = self._packer.add(tensor, live=live)
        self._calls.append(_Call(kind, about, slots))

    def on_write(self, env: ObservedEnv, write: Write) -> None:
        """Note what was written."""
        if write.op == "model":
            self._fields[write.field] = None
        elif write.op == "set_const":
            self._constants = True
        elif write.op == "reset":
            self._written.update(dict.fromkeys(self._names))
            self._calls.append(self._masked("reset begins", write.env_ids))
        elif write.op == "state":
            components = self._names if write.field == "row" else (write.field,)
            self._written.update(dict.fromkeys(components))

    def _masked(self, kind: str, env_ids: Any, **about: Any) -> _Call:
        """A call for environments: a mask of the device, indices of the host, or all (None)."""
        if env_ids is None or isinstance(env_ids, np.ndarray):
            return _Call(kind, about | {"ids": env_ids})
        return _Call(kind, about, {"mask": self._packer.add(env_ids.mask, live=True)})

    def _gather_written(self) -> None:
        """Add state components and model fields that may have been written."""
        fields: dict[str, Any] = {}
        for name in self._fields:
            values = self._engine.fields.written(name)
            if values is not None:
                fields[name] = values
        if fields:
            constants = self._constants or self._engine.constants_late
            self._add("fields", fields, live=True, constants=constants)
            self._constants = False
        self._fields = {}
        if self._written:
            states = {name: self._engine.state(name) for name in self._written}
            self._add("states", states, live=True)
            self._written = {}

    def on_physics(self, env: ObservedEnv, event: PhysicsEvent) -> None:
        """Gather states around physics steps."""
        if event.phase == "before":
            self._gather_written()
            return
        moved = {name: self._engine.state(name) for name in self._names if name not in _INPUTS}
        self._add("physics", moved, live=True, nstep=event.nstep)

    def on_event(self, env: ObservedEnv, event: EventRecord) -> None:
        """Gather what a term drew."""
        mask: Any = event.env_ids
        arrays = {} if mask is None else {"": mask.mask}
        drawn = {name: values for name, values in event.drawn.items() if not is_host(values)}
        fixed = {name: values for name, values in event.drawn.items() if is_host(values)}
        self._add(
            "event",
            {**arrays, **drawn},
            live=True,
            term=event.term,
            mode=event.mode,
            fixed=fixed,
        )

    def on_reset(self, env: ObservedEnv, env_ids: Any) -> None:
        """Gather states after a reset; outside of steps, report it."""
        self._gather_written()
        if not self._in_step:
            self._gather_commands()
        self._calls.append(self._masked("reset", env_ids))
        if not self._in_step:
            self.flush()

    def _gather_commands(self) -> None:
        terms = self._env.command_manager.terms
        if terms:
            self._add("commands", {name: term.instance.values for name, term in terms.items()})

    def on_step(self, env: ObservedEnv, step: StepRecord) -> None:
        """Gather the results of a step, and pack all."""
        self._gather_written()
        self._gather_commands()
        arrays: Values = {
            "action": step.action,
            "reward": step.reward,
            "terminated": step.terminated,
            "truncated": step.truncated,
            "episode_ids": step.episode_ids,
        }
        groups = {name: step.info.get(name, {}) for name in _GROUPS}
        groups["terminations"] = self._env.termination_manager.values
        for key, group in groups.items():
            arrays |= {f"{key}/{name}": values for name, values in _arrays_of(group).items()}
        arrays |= {f"info/{name}": step.info[name] for name in _INFO if name in step.info}
        self._add("step", arrays, groups={key: tuple(group) for key, group in groups.items()})
        self._packed = self._pack()

    # -- on the host -------------------------------------------------------------------------------

    def _report(
        self, calls: Sequence[_Call], values: Sequence[Values], weights: Mapping[str, float]
    ) -> None:
        """Tell the observers, in the order of the calls."""
        env = self.copied_env
        for i, (call, arrays) in enumerate(zip(calls, values, strict=True)):
            if call.kind == "states":
                env.engine.put_states(arrays)
            elif call.kind == "fields":
                env.engine.put_fields(arrays, call.about["constants"])
            elif call.kind == "physics":
                env.engine.put_physics(call.about["nstep"], arrays)
            elif call.kind == "commands":
                env.put_commands(arrays)
            elif call.kind == "event":
                drawn = call.about["fixed"] | arrays
                mask = drawn.pop("", None)
                env.event(call.about["term"], call.about["mode"], mask, drawn)
            elif call.kind == "reset begins":
                # A reset is reported with the states after it, which are gathered later.
                later = zip(calls[i:], values[i:], strict=True)
                states = next(states for other, states in later if other.kind == "states")
                env.engine.put_reset(self._ids(call, arrays), states)
            elif call.kind == "reset":
                env.reset(self._ids(call, arrays))
            else:
                self._report_step(call, arrays, weights)

    def _ids(self, call: _Call, arrays: Values) -> NDArray[np.int64]:
        """(n,) environments of a call of `_masked`."""
        if arrays:
            return np.flatnonzero(arrays["mask"])
        ids: NDArray[np.int64] | None = call.about["ids"]
        return np.arange(self.copied_env.num_envs) if ids is None else ids

    def _report_step(self, call: _Call, arrays: Values, weights: Mapping[str, float]) -> None:
        groups: dict[str, tuple[tuple[str, ...], NDArray[Any]]] = {}
        for key, names in call.about["groups"].items():
            of_group = {name: arrays.get(f"{key}/{name}") for name in ("", *names)}
            groups[key] = (names, _stacked(of_group))
        prefix = "info/"
        info = {
            key.removeprefix(prefix): array
            for key, array in arrays.items()
            if key.startswith(prefix)
        }
        self.copied_env.step(arrays, info, groups, weights)

    def on_close(self, env: ObservedEnv) -> None:
        """Report what is left, then that the environment closes, even if that fails."""
        try:
            self.flush()
        finally:
            self.copied_env.close()


def _arrays_of(group: Mapping[str, Any]) -> dict[str, Any]:
    """Arrays of a group of values by name: one of (K, N), named "", where they are in one."""
    if isinstance(group, TermRows) and not isinstance(group.rows, (list, tuple)):
        return {"": group.rows}
    rows = group.rows if isinstance(group, TermRows) else group.values()
    return dict(zip(group, rows, strict=True))


def _stacked(arrays: Mapping[str, NDArray[Any] | None]) -> NDArray[Any]:
    """(K, N) of a group of values, from what `_arrays_of` gave."""
    in_one_array = arrays[""]
    if in_one_array is not None:
        return in_one_array
    return np.array([array for array in arrays.values() if array is not None])
