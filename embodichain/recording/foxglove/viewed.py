"""`Viewed`: one environment as whoever encodes its messages sees it, with a model of its own."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64
from embodichain.lab.sim.engine.layout import row_layout
from embodichain.recording.foxglove.scene import Props, Scene
from embodichain.recording.shapes import LOOKS

__all__ = ["Viewed"]


class Viewed:
    """Where the bodies of one environment are, and what they look like.

    Args:
        model: The compiled model; other values of the environment's own are set later.
        env_id: Which one.
        props: Encoded meshes, shared by all.
    """

    def __init__(self, model: mujoco.MjModel, env_id: int, props: Props) -> None:
        self.env_id = env_id
        self._model, self._props = model, props
        self._owned = False
        self.data = mujoco.MjData(model)
        layout = row_layout(model)
        inputs = {name: getattr(self.data, name) for name in ("qpos", "mocap_pos", "mocap_quat")}
        self._inputs = [(a.reshape(-1), layout[name]) for name, a in inputs.items() if a.size]
        self._scene: Scene | None = None

    def set_field(self, field: str, columns: NDArray[np.int64] | slice, values: F64) -> None:
        """Give this environment's own model other values, (k,) columns of a flattened field."""
        if not self._owned:
            self._model, self._owned = copy.copy(self._model), True
        getattr(self._model, field).reshape(-1)[columns] = values
        if field.startswith(LOOKS):
            self._scene = None

    def place(self, row: F64) -> None:
        """Compute where every body is."""
        for target, columns in self._inputs:
            target[:] = row[columns]
        mujoco.mj_kinematics(self._model, self.data)

    def scene(self, time_ns: int, anyway: bool = False) -> bytes | None:
        """What it looks like now; None if that has not changed: viewers keep what they were shown.

        Args:
            time_ns: The moment.
            anyway: Whether somebody sees it for the first time.
        """
        if self._scene is None:
            self._scene = Scene(self._model, self.env_id, self._props)
        elif not anyway:
            return None
        return self._scene.update(time_ns)
