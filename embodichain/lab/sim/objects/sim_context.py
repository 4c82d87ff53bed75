"""`SimContext`: the part of a simulation that handles use."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import torch

    from embodichain.lab.sim.drawing.views import Pictures, View
    from embodichain.lab.sim.engine.api import Engine
    from embodichain.utils.arrays import Arrays

__all__ = ["SimContext"]


class SimContext(Protocol):
    """The interface of a simulation for its robots, objects, lights and sensors."""

    num_envs: int
    device: torch.device
    arrays: Arrays
    physics_steps_per_control: int

    @property
    def engine(self) -> Engine:
        """The engine; compiles the scene at first use.

        Raises:
            RuntimeError: If the simulation was destroyed.
        """

    def compile(self) -> None:
        """Compile the scene and bind every handle; does nothing if that is done already."""

    def reset_objects_state(self, env_ids: Any = None, *, only: Collection[str] | None) -> None:
        """Reset entities to their configured state."""

    def draw(self, views: Sequence[View], env_ids: Any = None) -> list[Pictures]:
        """Draw n environments (None: all) with every view; n rows for each view.

        Raises:
            RenderError: If an output cannot be drawn here.
        """
