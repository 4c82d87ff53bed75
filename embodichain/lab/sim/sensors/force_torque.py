"""Force-torque sensors: what parents exert on links."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Literal

from embodichain.lab.sim.compiler.sensing.frame_sensors import add_frame_sensors
from embodichain.lab.sim.compiler.sensing.sensor_index import SensorIndex, own_columns
from embodichain.lab.sim.configs.sensor_cfg import SensorCfg
from embodichain.lab.sim.sensors.base_sensor import LastStepSensor, register_sensor
from embodichain.utils.configclass import configclass

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.compiler.sensing.sensor_plans import SensorPlan
    from embodichain.utils.array_types import Floats

__all__ = ["ForceTorqueSensor", "ForceTorqueSensorCfg"]


@configclass
class ForceTorqueSensorCfg(SensorCfg):
    """Force and torque that parents exert on links: at their origins, or at sites or geoms."""

    reads: ClassVar[tuple[str, ...]] = ("force", "torque")

    sensor_type: Literal["force_torque"] = "force_torque"


@register_sensor(ForceTorqueSensorCfg)
class ForceTorqueSensor(LastStepSensor):
    """Force and torque that parents exert on n links, at each link's origin.

    They belong to the acceleration stage: they are those of the last physics step or, after a
    reset, of the reset state. At rest the force points up and equals the weight of the link and its
    descendants.
    """

    @classmethod
    def edit_spec(cls, spec: mujoco.MjSpec, plan: SensorPlan) -> None:
        """Add its two MuJoCo sensors on each link, site or geom: N and N m."""
        types = ("force", "torque")
        add_frame_sensors(spec, plan, types)

    @classmethod
    def find_index(
        cls, model: mujoco.MjModel, plan: SensorPlan, entities: Mapping[str, EntityIndex]
    ) -> SensorIndex:
        """Return its columns, (links, 6)."""
        return own_columns(model, plan.uid, (len(plan.names), 6))

    def read_force(self) -> Floats:
        """(N, n, 3) N, link axes."""
        return self.latest()[0][..., 0:3].copy()

    def read_torque(self) -> Floats:
        """(N, n, 3) N m about the link's origin, link axes."""
        return self.latest()[0][..., 3:6].copy()
