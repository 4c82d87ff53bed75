"""`Snapshot`: the recorded data of one environment at one moment.

Logs make them (`embodichain.recording.open(path).snapshot(...)`), `BaseEnv.restore` takes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

__all__ = ["Drawn", "Snapshot", "SnapshotSource"]


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """The draws of a term for one environment.

    Attributes:
        term: Name of the term.
        mode: ``reset`` or ``interval`` for events, ``command`` for commands.
        values: The numbers: name -> array.
    """

    term: str
    mode: str
    values: Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """One environment between two control steps.

    Attributes:
        origin: Where it comes from, as text.
        model: The compiled model, the same for all environments.
        layout: Component of a row -> its (start, stop) columns.
        row: (nstate,) integration state (`mjSTATE_INTEGRATION`), controls included.
        fields: Model fields that may differ between environments, (size,) each, flattened; all
            others are `model`'s.
        elapsed: Finished control steps of the episode.
        episode: Number of the episode.
        last_action: (A,) the action of the step before; zeros at the start of an episode.
        drawn: The draws of event and command terms since its episode began, in order.
        notes: Doubts about the data, one line each.
    """

    origin: str
    model: mujoco.MjModel
    layout: Mapping[str, tuple[int, int]]
    row: NDArray[np.float64]
    fields: Mapping[str, NDArray[Any]]
    elapsed: int
    episode: int
    last_action: NDArray[np.float64]
    drawn: tuple[Drawn, ...] = ()
    notes: tuple[str, ...] = ()


class SnapshotSource(Protocol):
    """Something that makes snapshots, such as an open log."""

    def snapshot(self, env: int, episode: int | None = None, step: int | None = None) -> Snapshot:
        """Return the snapshot of one environment before a control step.

        Args:
            env: The environment.
            episode: One of its episodes; None counts steps from the start of the recording.
            step: Finished control steps, from the start of the episode or of the recording.
        """
