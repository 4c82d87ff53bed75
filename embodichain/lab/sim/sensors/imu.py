"""Inertial measurement units: orientation, angular velocity and specific force."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from embodichain.lab.sim.compiler.sensing.frame_sensors import add_frame_sensors
from embodichain.lab.sim.configs.scene_cfg import Orientation, Vec3
from embodichain.lab.sim.configs.sensor_cfg import SensorCfg
from embodichain.lab.sim.reads.gravity import gravity_direction
from embodichain.lab.sim.sensors.base_sensor import LastStepSensor, register_sensor
from embodichain.utils.configclass import configclass
from embodichain.utils.math import quat_conjugate, quat_rotate

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler.sensing.sensor_plans import SceneNames, SensorPlan
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.sensors.sampling import Readings
    from embodichain.utils.array_types import Floats
    from embodichain.utils.errors import Problem

__all__ = ["ImuSensor", "ImuSensorCfg"]


@configclass
class ImuSensorCfg(SensorCfg):
    """An inertial measurement unit on one link, site or geom; by default on the root."""

    reads: ClassVar[tuple[str, ...]] = (
        "orientation",
        "angular_velocity",
        "acceleration",
        "projected_gravity",
    )

    sensor_type: Literal["imu"] = "imu"
    pos: Vec3 = (0.0, 0.0, 0.0)
    """Its position, metres in the frame of that link, site or geom."""
    quat: Orientation = (1.0, 0.0, 0.0, 0.0)
    """Its orientation, wxyz in that frame."""


@register_sensor(ImuSensorCfg)
class ImuSensor(LastStepSensor):
    """An inertial measurement unit without noise; its axes are the link's, rotated by the config.

    Orientation and angular velocity are those of the current state. The specific force belongs to
    the acceleration stage: it is that of the last physics step or, after a reset, of the reset
    state.
    """

    cfg: ImuSensorCfg

    @classmethod
    def make_plan(
        cls, uid: str, cfg: ImuSensorCfg, scene: SceneNames
    ) -> tuple[SensorPlan | None, list[Problem]]:
        """Look up the one link, site or geom that it is on."""
        frames, problems = scene.one("of", cfg.of)
        return (None if frames is None else frames.plan(uid, cfg)), problems

    @classmethod
    def edit_spec(cls, spec: mujoco.MjSpec, plan: SensorPlan) -> None:
        """Add its three MuJoCo sensors: wxyz, rad/s and m/s^2."""
        types = (
            "framequat",
            "gyro",
            "accelerometer",
        )
        cfg: ImuSensorCfg = plan.cfg  # type: ignore[assignment]
        add_frame_sensors(spec, plan, types, pos=cfg.pos, quat=cfg.quat)

    def measure(self, env_ids: EnvIndex | None) -> Readings:
        """(n, 7) orientation and angular velocity of now; (n, 3) force of the last physics step."""
        state = self.columns(self.engine.derived("sensordata"), env_ids)
        (last_step,) = super().measure(env_ids)
        return state[:, 0:7], last_step[:, 7:10]

    def read_orientation(self) -> Floats:
        """(N, 4) wxyz orientation of the sensor in the world."""
        return self.latest()[0][:, 0:4].copy()

    def read_angular_velocity(self) -> Floats:
        """(N, 3) rad/s, sensor axes."""
        return self.latest()[0][:, 4:7].copy()

    def read_acceleration(self) -> Floats:
        """(N, 3) m/s^2 specific force (acceleration minus gravity), sensor axes.

        It is 9.81 upwards at rest and 0 in free fall.
        """
        return self.latest()[1].copy()

    def read_projected_gravity(self) -> Floats:
        """(N, 3) unit vector of gravity in sensor axes: (0, 0, -1) if upright; 0 without it."""
        quat = self.read_orientation()
        gravity = np.broadcast_to(gravity_direction(self.engine), (len(quat), 3))
        return quat_rotate(quat_conjugate(quat), gravity)
