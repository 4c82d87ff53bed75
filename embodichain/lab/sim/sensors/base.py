"""`BaseSensor`: what every sensor handle has - a uid, a config, columns of the engine's numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.host import Handle, Host

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.sensor_plans import SensorPlan
    from embodichain.lab.sim.compiler.sensors import SensorIndex
    from embodichain.lab.sim.engine.base import F64, Engine
    from embodichain.lab.sim.sensors.cfg import SensorCfg

__all__ = ["BaseSensor"]


class BaseSensor(Handle["SensorIndex"]):
    """One sensor in N environments.

    Args:
        plan: What it is and the links it is fixed on.
        host: The simulation.

    Attributes:
        cfg: Its config.
        uid: Its name.
        names: (n,) the links it is fixed on.
    """

    def __init__(self, plan: SensorPlan, host: Host) -> None:
        super().__init__(plan.uid, host)
        self.plan = plan
        self.cfg: SensorCfg = plan.cfg
        self.names = plan.links

    def bind(self, engine: Engine, index: SensorIndex) -> None:
        """Set the engine and the sensor's columns. Called once, by the simulation."""
        super().bind(engine, index)
        # The first request of an acceleration field computes it anew, so it is made here.
        engine.acceleration("sensordata")

    @property
    def observe(self) -> bool:
        """Whether ``obs["sensor"]`` holds its data."""
        return self.cfg.observe

    @property
    def body_ids(self) -> NDArray[np.int64]:
        """(n,) MuJoCo's bodies of the links it sits on."""
        model = self.engine.model
        return np.array([model.body(name).id for name in self.plan.bodies], np.int64)

    def get_data(self) -> dict[str, torch.Tensor]:
        """Return what ``obs["sensor"][uid]`` holds: float32 tensors (N, ...)."""
        raise NotImplementedError

    def _now(self) -> F64:
        """(N, ...) its numbers at the present poses and velocities: a view, do not keep."""
        index = self.binding.index
        rows = self.engine.derived("sensordata")[:, index.columns]
        return rows.reshape(len(rows), *index.shape)

    def _last(self) -> F64:
        """(N, ...) its numbers of the last physics step, or of the last reset: a view."""
        index = self.binding.index
        rows = self.engine.acceleration("sensordata")[:, index.columns]
        return rows.reshape(len(rows), *index.shape)


def as_tensor(array: F64) -> torch.Tensor:
    """A float32 tensor of its own."""
    return torch.from_numpy(array.astype(np.float32))
