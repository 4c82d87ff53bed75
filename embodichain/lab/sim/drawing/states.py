"""`DataState`, `StoredStates`: environments that are drawn later, or without a batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.views import DrawnState

if TYPE_CHECKING:
    from embodichain.lab.sim.drawing.commands import ShownCommand

__all__ = ["DRAWN_FIELDS", "DRAWN_POSES", "DataState", "StoredStates"]

DRAWN_POSES = (
    *("geom_xpos", "geom_xmat", "cam_xpos", "cam_xmat", "light_xpos", "light_xdir"),
    *("xpos", "xmat"),  # for marks
)
"""Fields of MjData that pictures depend on."""
_COMPONENTS = ("qpos", "qvel")
"""Components of the state that marks depend on."""
DRAWN_FIELDS = (
    *sorted(f for f in MODEL_FIELDS if f.startswith(("geom_", "mat_", "light_"))),
    "cam_fovy",
    "cam_intrinsic",
)
"""Fields of MjModel that pictures depend on and that can differ between environments."""


class DataState:
    """One environment with an MjData of its own.

    Args:
        data: Positions and everything that MuJoCo derives from them; its model is drawn.
    """

    num_envs = 1

    def __init__(self, data: mujoco.MjData) -> None:
        self._data = data
        self.commands: Sequence[ShownCommand] = ()

    @property
    def model(self) -> mujoco.MjModel:
        """The model."""
        return self._data.model

    def derived(self, name: str) -> NDArray[np.float64]:
        """(1, ...) a field of MjData."""
        return np.asarray(getattr(self._data, name))[None]

    def state(self, name: str) -> NDArray[np.float64]:
        """(1, ...) a component of the state."""
        return np.asarray(getattr(self._data, name))[None]

    def model_values(self, name: str) -> NDArray[Any]:
        """(1, ...) a field of MjModel."""
        return np.asarray(getattr(self.model, name))[None]


class StoredStates:
    """Copies of single environments, as the rows of one state: many moments in one call.

    Args:
        model: The compiled scene.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self._poses: list[dict[str, NDArray[np.float64]]] = []
        self._fields: list[dict[str, NDArray[Any]]] = []
        self._commands: list[list[ShownCommand]] = []

    @property
    def num_envs(self) -> int:
        """How many are stored."""
        return len(self._poses)

    def append(self, state: DrawnState, env: int = 0) -> None:
        """Store what one environment of `state`, whose scene is the same, looks like now."""
        poses = {name: state.derived(name)[env].copy() for name in DRAWN_POSES}
        poses |= {name: np.array(state.state(name)[env]) for name in _COMPONENTS}
        self._poses.append(poses)
        self._commands.append([command.of_env(env) for command in state.commands])
        fields: dict[str, NDArray[Any]] = {}
        for name in DRAWN_FIELDS:
            values = state.model_values(name)
            is_shared = len(values) == 1
            fields[name] = values[0 if is_shared else env].copy()
        self._fields.append(fields)

    def clear(self) -> None:
        """Remove all stored environments."""
        self._poses.clear()
        self._fields.clear()
        self._commands.clear()

    @property
    def commands(self) -> list[ShownCommand]:
        """Those of the stored environments, which are of one task; NaN where they are not known."""
        commands: list[ShownCommand] = []
        most: list[ShownCommand] = max(self._commands, key=len, default=[])
        for index, command in enumerate(most):
            unknown = np.full_like(command.values, np.nan)
            rows = [
                stored[index].values if index < len(stored) else unknown
                for stored in self._commands
            ]
            commands.append(replace(command, values=np.concatenate(rows)))
        return commands

    def derived(self, name: str) -> NDArray[np.float64]:
        """(n, ...) one of `DRAWN_POSES`."""
        return np.stack([poses[name] for poses in self._poses])

    def state(self, name: str) -> NDArray[np.float64]:
        """(n, ...) the components ``qpos`` and ``qvel``."""
        return self.derived(name)

    def model_values(self, name: str) -> NDArray[Any]:
        """(n, ...) a field of MjModel; one row if it is the same in all of them."""
        if name not in DRAWN_FIELDS:
            return np.asarray(getattr(self.model, name))[None]
        rows = np.stack([fields[name] for fields in self._fields])
        if (rows == rows[0]).all():
            return rows[:1]
        return rows
