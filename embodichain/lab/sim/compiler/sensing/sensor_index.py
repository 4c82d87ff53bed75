"""`SensorIndex`: where a sensor's numbers are in the compiled model."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.sim.compiler.index import Ids, Mask

if TYPE_CHECKING:
    import mujoco

__all__ = ["SensorIndex", "own_columns"]


@dataclass(frozen=True, eq=False)
class SensorIndex:
    """A sensor in the compiled model; a type of sensor that needs more has a subclass.

    Attributes:
        columns: Its columns in ``sensordata``; none if no sensor of MuJoCo's measures it.
        shape: Shape of its data in these columns.
        dofs: (n,) columns in qvel of its joints.
        geoms: (ngeom,) geoms that its rays can hit.
    """

    columns: slice = field(default_factory=lambda: slice(0, 0))
    shape: tuple[int, ...] = ()
    dofs: Ids = field(default_factory=lambda: np.zeros(0, np.int64))
    geoms: Mask = field(default_factory=lambda: np.zeros(0, np.bool_))

    def picture_cameras(self) -> dict[str, tuple[int, tuple[int, int]]]:
        """Name of each of its pictures -> id of the camera in the model, and width and height."""
        return {}


def own_columns(
    model: mujoco.MjModel, uid: str, shape: tuple[int, ...] | None = None
) -> SensorIndex:
    """Return the columns of the MuJoCo sensors of a sensor: those called ``UID/...``.

    Args:
        model: The compiled scene.
        uid: The sensor.
        shape: Shape of its data; None is one row of all columns.

    Raises:
        RuntimeError: If the columns are not contiguous, or not as many as the shape has.
    """
    sensors = [i for i in range(model.nsensor) if model.sensor(i).name.startswith(f"{uid}/")]
    if not sensors:
        return SensorIndex()
    start = int(model.sensor_adr[sensors[0]])
    stop = int(model.sensor_adr[sensors[-1]] + model.sensor_dim[sensors[-1]])
    width = int(model.sensor_dim[sensors].sum())
    if shape is None:
        shape = (width,)
    if stop - start != width or width != int(np.prod(shape)):
        raise RuntimeError(f"{uid}: MuJoCo keeps its numbers in columns {start} to {stop}")
    return SensorIndex(columns=slice(start, stop), shape=shape)
