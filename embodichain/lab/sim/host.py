"""What handles know of their simulation: `Host`, `Binding`, and their base class `Handle`."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

if TYPE_CHECKING:
    import torch

    from embodichain.lab.sim.engine.base import Engine

__all__ = ["Binding", "Handle", "Host"]

Index = TypeVar("Index")


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

    def reset_objects_state(
        self,
        env_ids: Any = None,
        excluded_uids: Collection[str] = (),
        only: Collection[str] | None = None,
    ) -> None:
        """Put entities back to their configured state."""


class Binding(Generic[Index]):
    """One handle's place in a simulation, shared by the parts of the handle.

    Args:
        host: The simulation.
        uid: The handle's name.
    """

    def __init__(self, host: Host, uid: str) -> None:
        self.host = host
        self.uid = uid
        self._engine: Engine | None = None
        self._index: Index | None = None

    def bind(self, engine: Engine, index: Index) -> None:
        """Set the engine and the handle's indices in the compiled model."""
        self._engine, self._index = engine, index

    def release(self) -> None:
        """Drop the reference to the engine."""
        self._engine = None

    @property
    def num_envs(self) -> int:
        """N."""
        return self.host.num_envs

    @property
    def engine(self) -> Engine:
        """The engine; compiles the scene at first use.

        Raises:
            RuntimeError: If the simulation was destroyed.
        """
        return self.host.engine if self._engine is None else self._engine

    @property
    def index(self) -> Index:
        """Indices in the compiled model; compiles the scene at first use.

        Raises:
            RuntimeError: If the handle was removed from the scene, or the simulation destroyed.
        """
        if self._index is None:
            self.host.compile()
        if self._index is None:
            raise RuntimeError(f"{self.uid} was removed from the scene before it was compiled")
        return self._index


class Handle(Generic[Index]):
    """A named thing in N environments of a simulation.

    Args:
        uid: Its name.
        host: The simulation.
    """

    def __init__(self, uid: str, host: Host) -> None:
        self.uid = uid
        self.binding: Binding[Index] = Binding(host, uid)

    def bind(self, engine: Engine, index: Index) -> None:
        """Set the engine and the indices in the compiled model. Called once, by the simulation."""
        self.binding.bind(engine, index)

    @property
    def engine(self) -> Engine:
        """The engine; compiles the scene at first use."""
        return self.binding.engine

    @property
    def num_instances(self) -> int:
        """N."""
        return self.binding.num_envs

    @property
    def device(self) -> torch.device:
        """Device of the tensors that reads return."""
        return self.binding.host.device

    def destroy(self) -> None:
        """Drop the reference to the engine."""
        self.binding.release()
