"""`StepObserver`: how recording, viewers and dashboards watch an environment from outside.

The records an observer receives live here as well: named tuples, which are made in a third of the
time of frozen data classes, several in every step. Nothing here knows a log format or a window.
A Gymnasium wrapper could not do this: it sees nothing of what happens inside an automatic reset.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.engine.base import F64, EnvIndex, PhysicsEvent, Write
    from embodichain.lab.sim.types import EnvObs

__all__ = ["EventRecord", "StepObserver", "StepRecord"]


class EventRecord(NamedTuple):
    """A term of the event manager has fired, or a command was drawn.

    Attributes:
        term: The term's name in the config.
        mode: ``startup``, ``reset`` or ``interval``; ``command`` for a command.
        env_ids: (n,) int64 environments in which it fired, or None for all N.
        drawn: What it drew at random, by name, each (n, ...); empty if it draws nothing.
    """

    term: str
    mode: str
    env_ids: EnvIndex | None
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
    action: F64
    reward: NDArray[np.float32]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    info: dict[str, Any]
    obs: EnvObs
    episode_ids: NDArray[np.int64]


class StepObserver:
    """Base of everything that watches; override what you need, the rest does nothing.

    An observer must not change the environment. Attach it with `BaseEnv.add_observer`.
    """

    def on_reset(self, env: BaseEnv, env_ids: EnvIndex) -> None:
        """Environments were reset, explicitly or automatically; their new state is complete.

        Args:
            env: The environment.
            env_ids: (n,) which of the N were reset, sorted.
        """

    def on_write(self, env: BaseEnv, write: Write) -> None:
        """Something outside physics was written. ``write.values`` may be live: copy it."""

    def on_physics(self, env: BaseEnv, event: PhysicsEvent) -> None:
        """Physics is about to step, or has just stepped. ``event.rows`` is live: copy it."""

    def on_event(self, env: BaseEnv, event: EventRecord) -> None:
        """A term of the event manager fired."""

    def on_step(self, env: BaseEnv, step: StepRecord) -> None:
        """A control step ended; environments that are done have been reset already."""

    def on_close(self, env: BaseEnv) -> None:
        """The environment closes; nothing follows."""
