"""`StepObserver`: how logs, viewers and dashboards follow an environment.

Also the records that observers receive (named tuples: a third of the time of frozen dataclasses),
and `ObservedEnv`, the part of an environment that observers use. A Gymnasium wrapper cannot replace
an observer: it receives nothing from inside an automatic reset.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import torch

    from embodichain.lab.sim.engine.api import PhysicsEvent, Write
    from embodichain.lab.sim.sim_manager import SimulationManager
    from embodichain.lab.sim.types import EnvObs
    from embodichain.utils.array_types import EnvIds, EnvIndex, Floats

__all__ = [
    "EndedBy",
    "EngineRelay",
    "EventRecord",
    "ObservedEnv",
    "RewardWeights",
    "StepObserver",
    "StepRecord",
]


class RewardWeights(Protocol):
    """The weights of a task's rewards."""

    @property
    def weights(self) -> Mapping[str, float]:
        """Current weight by name of the reward term."""
        ...

    def set_weight(self, name: str, weight: float) -> None:
        """Change a weight from the next step on."""
        ...


class EndedBy(Protocol):
    """Which terms ended episodes in the last step."""

    @property
    def values(self) -> Mapping[str, torch.Tensor]:
        """Name of the termination term -> (N,) bool."""
        ...


class ObservedEnv(Protocol):
    """The part of an environment that observers use."""

    @property
    def num_envs(self) -> int:
        """N."""
        ...

    @property
    def sim(self) -> SimulationManager:
        """The simulation of all N environments."""
        ...

    @property
    def physics_dt(self) -> float:
        """Seconds per physics step."""
        ...

    @property
    def step_dt(self) -> float:
        """Seconds per control step."""
        ...

    @property
    def sim_steps_per_control(self) -> int:
        """Physics steps per control step."""
        ...

    @property
    def physics_steps_per_call(self) -> int:
        """Physics steps of each physics call of a control step: all, or 1 (`ActionTerm`)."""
        ...

    @property
    def control_step(self) -> int:
        """Control steps since the environment was built."""
        ...

    @property
    def seed_value(self) -> int:
        """The seed in use."""
        ...

    @property
    def reward_manager(self) -> RewardWeights:
        """The weights of rewards."""
        ...

    @property
    def termination_manager(self) -> EndedBy:
        """The results of terminations."""
        ...

    @property
    def judges_success(self) -> bool:
        """Whether the task defines success."""
        ...

    @property
    def revision(self) -> tuple[int, ...]:
        """Numbers that change when a step is computed in another way: limit, terms, model."""
        ...

    @property
    def observers(self) -> Sequence[StepObserver]:
        """The observers, in the order in which they are called."""
        ...

    def truncate(self, env_ids: EnvIndex) -> None:
        """Truncate the episodes of these environments at the next step."""
        ...


class EventRecord(NamedTuple):
    """A term of the event manager has fired, or a command or a delay was drawn.

    Attributes:
        term: The term's name in the config; of a delay ``observations.NAME`` or ``actions.NAME``.
        mode: ``startup``, ``reset`` or ``interval``; ``command`` for a command, ``delay`` for a
            delay that is drawn for each episode.
        env_ids: (n,) environments in which it fired, or None for all N.
        drawn: Its random draws by name, each (n, ...); empty if there are none.
    """

    term: str
    mode: str
    env_ids: EnvIds | None
    drawn: Mapping[str, NDArray[Any]] = MappingProxyType({})


class StepRecord(NamedTuple):
    """One control step, as `BaseEnv.step` returns it. Everything in it may be kept.

    Attributes:
        control_step: Control steps since the environment was built, this one included (from 1).
        action: (N, A) float64, as given to `step`.
        reward: (N,) float32.
        terminated: (N,) bool.
        truncated: (N,) bool.
        info: The dict that `step` returns.
        obs: The observation that `step` returns: after the reset of environments that are done.
        episode_ids: (N,) int64 episodes this step belongs to: before that reset.
    """

    control_step: int
    action: Floats
    reward: NDArray[np.float32]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    info: dict[str, Any]
    obs: EnvObs
    episode_ids: NDArray[np.int64]


class StepObserver:
    """Base class of observers; the default of every method does nothing.

    An observer must not change the environment. Attach it with `BaseEnv.add_observer`.

    Attributes:
        may_lag: Whether it may be called late: with arrays on a device only such observers can be
            attached, and are called one or two control steps later, with a `CopiedEnv`.
    """

    may_lag: bool = False

    def on_reset(self, env: ObservedEnv, env_ids: EnvIds) -> None:
        """Called after environments were reset, explicitly or automatically.

        Args:
            env: The environment.
            env_ids: (n,) which of the N were reset, sorted.
        """

    def on_write(self, env: ObservedEnv, write: Write) -> None:
        """Called after a write outside physics. ``write.values`` may be a live view: copy it."""

    def on_physics(self, env: ObservedEnv, event: PhysicsEvent) -> None:
        """Called before and after physics steps. ``event.rows`` is a live view: copy it."""

    def on_event(self, env: ObservedEnv, event: EventRecord) -> None:
        """A term of the event manager fired."""

    def on_step(self, env: ObservedEnv, step: StepRecord) -> None:
        """Called after a control step; environments that are done have been reset already."""

    def on_close(self, env: ObservedEnv) -> None:
        """Called when the environment closes; the last call."""


@dataclass(frozen=True)
class EngineRelay:
    """The engine's listener that passes writes and physics steps on to an environment's observers.

    Args:
        env: The environment; relays of the same one are equal.
    """

    env: ObservedEnv

    def on_write(self, write: Write) -> None:
        """Something outside physics was written."""
        for observer in self.env.observers:
            observer.on_write(self.env, write)

    def on_physics(self, event: PhysicsEvent) -> None:
        """Physics is about to step, or has stepped."""
        for observer in self.env.observers:
            observer.on_physics(self.env, event)
