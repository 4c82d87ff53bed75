"""`TermContext`: the part of an environment that terms and managers use.

`BaseEnv` satisfies these protocols structurally. Terms annotate their first argument with
`TermContext`, so that they do not depend on the environment's class.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from embodichain.lab.gym.envs.observers import ObservedEnv, StepObserver

if TYPE_CHECKING:
    import numpy as np
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.cfg import EnvCfg
    from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.objects.robot import Robot
    from embodichain.utils.array_types import Floats
    from embodichain.utils.arrays import Arrays
    from embodichain.utils.random import RandomStreams

__all__ = [
    "ActionSlices",
    "Commands",
    "EditableTerms",
    "EventDraws",
    "RandomDraws",
    "TermContext",
    "Weaken",
]


class Weaken(Protocol):
    """Brings drawn values nearer to their defaults."""

    def __call__(self, values: Floats, strength: float) -> Floats:
        """(n, m) values at a strength: defaults at 0, the values given at 1."""
        ...


class RandomDraws(Protocol):
    """Random numbers for the term that is being called."""

    def draw(
        self,
        what: str,
        shape: Sequence[int],
        low: Any,
        high: Any,
        env_ids: EnvIndex | None,
        default: Any = None,
    ) -> Floats:
        """Draw uniform numbers from the calling term's own stream, and log them.

        Args:
            what: Name of the numbers in the log.
            shape: Shape of one environment's draw.
            low: Scalar or array that broadcasts to ``shape``.
            high: Likewise; exclusive.
            env_ids: (n,) environments that draw, or None for all.
            default: What an event's `strength` draws towards, of the shape of ``low``; None if it
                does not act on these numbers.

        Returns:
            (n, *shape) float64. Do not write into it.
        """
        ...


class EventDraws(RandomDraws, Protocol):
    """Random numbers for event terms."""

    @property
    def strength(self) -> float:
        """`strength` of the event that is being called, 0 to 1."""
        ...

    def draw_columns(
        self,
        columns: Mapping[str, slice],
        low: Floats,
        high: Floats,
        env_ids: EnvIndex | None,
        normal: bool = False,
        weaken: Mapping[str, Weaken] | None = None,
    ) -> Floats:
        """Draw several quantities at once, each logged under its name; see `EventManager`."""
        ...

    def try_draw(self, shape: Sequence[int], env_ids: EnvIndex) -> Floats:
        """Draw numbers in [0, 1) that the term may reject, (n, *shape); not logged."""
        ...

    def log_draw(self, what: str, values: Floats) -> None:
        """Log what the term made of its tries, (n, *shape), under a name."""
        ...

    def preset_draw(
        self, what: str, shape: Sequence[int], env_ids: EnvIndex | None
    ) -> Floats | None:
        """Return the numbers that the term has to use for a name, (n, *shape); None if it draws."""
        ...


class Commands(RandomDraws, Protocol):
    """The commands of a task, by name."""

    def require(self, name: str, key: str = "command_name") -> str:
        """Return ``name`` if there is such a command; else raise a ConfigError for ``key``."""
        ...

    def names(self, name: str) -> tuple[str, ...]:
        """Names of the columns of a command."""
        ...

    def values(self, name: str) -> Floats:
        """(N, K) float64 current command: a live view; do not write to it or store it."""
        ...

    def get_command(self, name: str) -> torch.Tensor:
        """(N, K) float32 current command; a copy."""
        ...


class ActionSlices(Protocol):
    """Which columns of the action belong to which term."""

    @property
    def slices(self) -> Mapping[str, slice]:
        """Columns by name of the action term."""
        ...

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each column of the action: ``TERM/JOINT``."""
        ...


class EditableTerms(Protocol):
    """Terms of one section, whose parameters may change while the task runs."""

    @property
    def terms(self) -> Mapping[str, Any]:
        """The built terms by name."""
        ...

    def set_params(self, name: str, params: dict[str, Any], shape: Any = None) -> None:
        """Rebuild a term with other parameters; its state is carried over."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """State of the terms, and under ``params`` what was changed of their parameters."""
        ...


class TermContext(ObservedEnv, Protocol):
    """The part of an environment that terms and managers use. N is the number of environments."""

    @property
    def cfg(self) -> EnvCfg:
        """The environment's copy of its config."""
        ...

    @property
    def device(self) -> torch.device:
        """Device of the returned tensors."""
        ...

    @property
    def arrays(self) -> Arrays:
        """Makes the arrays that terms keep, where the simulation has its arrays."""
        ...

    @property
    def robot(self) -> Robot | None:
        """The first declared robot, or None."""
        ...

    @property
    def active_joint_ids(self) -> Sequence[int]:
        """The robot's joints that ``obs["robot"]`` contains and actions move."""
        ...

    @property
    def sensors(self) -> Mapping[str, Any]:
        """Sensors by uid."""
        ...

    @property
    def run_dir(self) -> Path | None:
        """The run's folder, or None."""
        ...

    @property
    def streams(self) -> RandomStreams:
        """Random numbers, one stream for each name and environment."""
        ...

    @property
    def control_frequency(self) -> float:
        """Control steps per second."""
        ...

    @property
    def max_episode_steps(self) -> int:
        """Control steps after which an episode is truncated; 2**31 - 1 means no limit."""
        ...

    @property
    def elapsed_steps(self) -> torch.Tensor:
        """(N,) int32 control steps of the current episodes, the present one included; a copy.

        Before physics, in action terms, the present one does not count yet.
        """
        ...

    @property
    def episode_ids(self) -> torch.Tensor:
        """(N,) int64 number of the current episodes, from 0; a copy."""
        ...

    @property
    def last_action(self) -> torch.Tensor:
        """(N, A) float32 action as last given to `step`; zeros after a reset. A copy."""
        ...

    def is_task_success(self) -> torch.Tensor:
        """(N,) bool: whether the last step, which ends an episode in a reset, was a success."""
        ...

    def read_last_action(self) -> Floats:
        """(N, A) action as last given to `step`; do not write to it."""
        ...

    def read_elapsed_steps(self) -> NDArray[np.int32]:
        """`elapsed_steps` as an array (N,); do not write to it."""
        ...

    @property
    def event_manager(self) -> EventDraws:
        """Random numbers for event terms."""
        ...

    @property
    def command_manager(self) -> Commands:
        """The commands."""
        ...

    @property
    def action_manager(self) -> ActionSlices:
        """The columns of action terms."""
        ...

    @property
    def managers(self) -> Mapping[str, EditableTerms]:
        """All managers by section."""
        ...

    def add_observer(self, observer: StepObserver) -> None:
        """Attach an observer."""
        ...

    def scene_entity(self, cfg: Any) -> ResolvedEntity:
        """Look up the entity of a `SceneEntityCfg` (or of a mapping with its keys)."""
        ...

    def add_detached_uids_for_reset(self, uids: Sequence[str]) -> None:
        """Exclude entities from the reset of states."""
        ...

    def log_event(
        self,
        term: str,
        mode: str,
        env_ids: EnvIndex | None,
        drawn: Mapping[str, NDArray[Any]] | None = None,
    ) -> None:
        """Report to observers that a term fired and what it drew."""
        ...
