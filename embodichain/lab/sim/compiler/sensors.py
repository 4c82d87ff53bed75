"""Sensors in the model: what MuJoCo computes for them, and where it keeps it.

Which links they mean is `sensor_plans`; reading the numbers is `lab.sim.sensors`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.sensor_plans import SensorPlan
from embodichain.lab.sim.sensors.cfg import (
    ContactSensorCfg,
    ImuSensorCfg,
)

__all__ = ["SensorIndex", "add_sensors", "deaf_sensors", "index_sensors"]

_OBJECT = mujoco.mjtObj
_SENSOR = mujoco.mjtSensor
_CONTACT_DATA = (1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND)) | (
    1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE)
)
_NET_FORCE = 3  # `reduce="netforce"` in MJCF: one contact, the sum of all, in world axes

_KINDS: dict[str, tuple[mujoco.mjtSensor, ...]] = {
    "contact": (_SENSOR.mjSENS_CONTACT,),
    "imu": (_SENSOR.mjSENS_FRAMEQUAT, _SENSOR.mjSENS_GYRO, _SENSOR.mjSENS_ACCELEROMETER),
    "force_torque": (_SENSOR.mjSENS_FORCE, _SENSOR.mjSENS_TORQUE),
}


@dataclass(frozen=True)
class SensorIndex:
    """Where the compiled model keeps one sensor.

    Attributes:
        columns: Its part of ``sensordata``.
        shape: What the columns mean: (links, others, 4) for contacts (how many, then force in N),
            (10,) for an IMU (wxyz, rad/s, m/s^2), (links, 6) for force and torque (N, N m).
    """

    columns: slice
    shape: tuple[int, ...]


def add_sensors(spec: mujoco.MjSpec, plans: Mapping[str, SensorPlan]) -> None:
    """Add what MuJoCo computes for sensors, named ``UID/...``, each sensor's in one piece."""
    for plan in plans.values():
        if isinstance(plan.cfg, ContactSensorCfg):
            _add_contacts(spec, plan)
        else:
            _add_sites(spec, plan)


def _add_contacts(spec: mujoco.MjSpec, plan: SensorPlan) -> None:
    """One MuJoCo sensor for every pair of a link and what it touches."""
    for i, body in enumerate(plan.bodies):
        for j, (kind, name) in enumerate(plan.others or ((_OBJECT.mjOBJ_UNKNOWN, ""),)):
            sensor = spec.add_sensor(name=f"{plan.uid}/{i}/{j}", type=_SENSOR.mjSENS_CONTACT)
            sensor.objtype, sensor.objname = _OBJECT.mjOBJ_BODY, body
            sensor.reftype, sensor.refname = kind, name
            sensor.intprm[:3] = [_CONTACT_DATA, _NET_FORCE, 1]


def _add_sites(spec: mujoco.MjSpec, plan: SensorPlan) -> None:
    """A site on every link, and the sensors that read there."""
    cfg = plan.cfg
    for i, name in enumerate(plan.bodies):
        site = spec.body(name).add_site(name=f"{plan.uid}/{i}", size=[1e-3] * 3, group=5)
        if isinstance(cfg, ImuSensorCfg):
            site.pos = np.asarray(cfg.pos, np.float64)
            quat = np.asarray(cfg.quat, np.float64)
            site.quat = quat / np.sqrt((quat * quat).sum())
        for j, kind in enumerate(_KINDS[cfg.sensor_type]):
            sensor = spec.add_sensor(name=f"{plan.uid}/{i}/{j}", type=kind)
            sensor.objtype, sensor.objname = _OBJECT.mjOBJ_SITE, site.name


def index_sensors(model: mujoco.MjModel, plans: Mapping[str, SensorPlan]) -> dict[str, SensorIndex]:
    """Find every sensor's columns in the compiled model."""
    return {uid: _index(model, plan) for uid, plan in plans.items()}


def deaf_sensors(model: mujoco.MjModel, plans: Mapping[str, SensorPlan]) -> list[str]:
    """Return one line for every contact sensor that can never report anything."""
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    collides[np.concatenate([model.pair_geom1, model.pair_geom2])] = True  # a file's own pairs
    bodies = set(model.geom_bodyid[collides].tolist())
    return [
        f"{plan.uid}: no shape of {', '.join(plan.bodies)} collides, so it reports no contact"
        for plan in plans.values()
        if isinstance(plan.cfg, ContactSensorCfg)
        and not bodies.intersection(model.body(name).id for name in plan.bodies)
    ]


def _index(model: mujoco.MjModel, plan: SensorPlan) -> SensorIndex:
    count = len(plan.links)
    if isinstance(plan.cfg, ContactSensorCfg):
        parts = max(1, len(plan.others))
        shape: tuple[int, ...] = (count, parts, 4)
    else:
        parts = len(_KINDS[plan.cfg.sensor_type])
        shape = (10,) if isinstance(plan.cfg, ImuSensorCfg) else (count, 6)
    first = model.sensor(f"{plan.uid}/0/0").id
    last = model.sensor(f"{plan.uid}/{count - 1}/{parts - 1}").id
    start = int(model.sensor_adr[first])
    stop = int(model.sensor_adr[last] + model.sensor_dim[last])
    if stop - start != int(np.prod(shape)):
        raise RuntimeError(f"{plan.uid}: MuJoCo keeps its numbers in columns {start} to {stop}")
    return SensorIndex(slice(start, stop), shape)
