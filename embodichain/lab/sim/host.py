"""`Host`: what handles know of their simulation."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import torch

    from embodichain.lab.sim.engine.api import Engine

__all__ = ["Host"]


class Host(Protocol):
    """A simulation, as its robots, objects, lights and sensors see it."""

    num_envs: int
    device: torch.device

    @property
    def engine(self) -> Engine:
        """The engine; compiles the scene at first use.

        Raises:
            RuntimeError: If the simulation was destroyed.
        """

    def compile(self) -> None:
        """Compile the scene and bind every handle; does nothing the second time."""

    def reset_objects_state(self, env_ids: Any = None, *, only: Collection[str] | None) -> None:
        """Put entities back to their configured state."""
