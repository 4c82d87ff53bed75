"""The commands of viewed environments, as the simulation's thread reads them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.sim.engine.base import F64
from embodichain.lab.sim.engine.layout import as_slice
from embodichain.recording.foxglove.view_spec import MarkerSpec

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv

__all__ = ["Commands"]


class Commands:
    """What an environment is commanded, and which of it is drawn.

    Args:
        env: The environment; it may have no commands.
        env_ids: (n,) environments that are viewed.
    """

    def __init__(self, env: ObservedEnv, env_ids: Sequence[int]) -> None:
        self._which = as_slice(np.array(env_ids, np.int64))
        manager = getattr(env, "command_manager", None)  # environments of others may have none
        terms = {} if manager is None else dict(manager.terms)
        self._commands = {name: term.instance for name, term in terms.items()}
        self.markers = tuple(
            MarkerSpec(name, term.marker.kind, int(term.marker.body))
            for name, term in self._commands.items()
            if term.marker is not None
        )

    def scalars(self) -> list[tuple[list[str], F64]]:
        """Of every command the names of its columns, and its values, (N, columns): live."""
        found = []
        for name, command in self._commands.items():
            values = command.values
            labels = command.names or map(str, range(values.shape[1]))
            found.append(([f"{name}_{label}" for label in labels], values))
        return found

    def take(self) -> list[F64]:
        """The drawn commands in force in the order of `markers`, (n, K) each, copied."""
        which = self._which
        return [self._commands[marker.name].values[which].copy() for marker in self.markers]
