"""`BaseSensor`: what every sensor handle has - a uid, a config, columns of the engine's numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.sensor_plans import SensorPlan
    from embodichain.lab.sim.compiler.sensors import SensorIndex
    from embodichain.lab.sim.engine.base import F64, Engine
    from embodichain.lab.sim.sensors.cfg import SensorCfg
    from embodichain.lab.sim.sim_manager import SimulationManager

__all__ = ["BaseSensor"]


class BaseSensor:
    """One sensor in N environments.

    Args:
        plan: What it is and where it sits.
        sim: The simulation that owns it.

    Attributes:
        cfg: Its config.
        uid: Its name.
        names: (n,) the links it sits on.
    """

    def __init__(self, plan: SensorPlan, sim: SimulationManager) -> None:
        self.plan = plan
        self.cfg: SensorCfg = plan.cfg
        self.uid = plan.uid
        self.names = plan.links
        self._sim = sim
        self._bound: Engine | None = None
        self._columns = slice(0)
        self._shape: tuple[int, ...] = (sim.num_envs,)

    def bind(self, engine: Engine, index: SensorIndex) -> None:
        """Learn where the compiled model keeps this sensor. Called once, by the simulation."""
        self._bound = engine
        self._columns = index.columns
        self._shape = (engine.num_envs, *index.shape)
        # From here on the engine keeps what physics computes; asking later would compute it anew.
        engine.acceleration("sensordata")

    @property
    def engine(self) -> Engine:
        """The engine; compiles the scene at first use."""
        if self._bound is None:
            self._sim.compile()
        if self._bound is None:
            raise RuntimeError(f"{self.uid} was removed, or its simulation destroyed")
        return self._bound

    @property
    def observe(self) -> bool:
        """Whether ``obs["sensor"]`` holds its data."""
        return self.cfg.observe

    @property
    def num_instances(self) -> int:
        """N."""
        return self._sim.num_envs

    @property
    def device(self) -> torch.device:
        """Where tensors handed out live."""
        return self._sim.device

    @property
    def body_ids(self) -> NDArray[np.int64]:
        """(n,) MuJoCo's bodies of the links it sits on."""
        model = self.engine.model
        return np.array([model.body(name).id for name in self.plan.bodies], np.int64)

    def destroy(self) -> None:
        """Drop the handle's hold on the engine."""
        self._bound = None

    def get_data(self) -> dict[str, torch.Tensor]:
        """Return what ``obs["sensor"][uid]`` holds: float32 tensors (N, ...)."""
        raise NotImplementedError

    def _now(self) -> F64:
        """Its numbers at the present poses and velocities: a view, not to be kept."""
        engine = self.engine  # compiles, so that the columns are known
        return engine.derived("sensordata")[:, self._columns].reshape(self._shape)

    def _last(self) -> F64:
        """Its numbers within the last physics step, or as a reset left them: a view."""
        engine = self.engine
        return engine.acceleration("sensordata")[:, self._columns].reshape(self._shape)


def as_tensor(array: F64) -> torch.Tensor:
    """A float32 tensor of its own."""
    return torch.from_numpy(array.astype(np.float32))
