"""Sensors of a scene: MuJoCo's sensors for the declared ones, and their columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.index import EntityIndex, Ids, Mask
from embodichain.lab.sim.compiler.names import GROUND, Known, check_uid
from embodichain.lab.sim.compiler.sensing.cameras import (
    add_camera,
    check_memory,
    entity_of_geom,
    picture_names,
)
from embodichain.lab.sim.compiler.sensing.sensor_plans import OBJECTS, SensorPlan, plan_sensor
from embodichain.lab.sim.configs.sensor_cfg import (
    CameraCfg,
    ContactSensorCfg,
    FramePoseSensorCfg,
    ImuSensorCfg,
    JointTorqueSensorCfg,
    RayCastCfg,
    SensorCfg,
)
from embodichain.utils.errors import Problem
from embodichain.utils.math import normalize_quat, quat_multiply, quat_rotate

__all__ = [
    "CameraIndex",
    "SensorIndex",
    "add_sensor",
    "index_sensor",
    "is_silent",
    "plan_sensors",
]

_OBJECT = mujoco.mjtObj


def plan_sensors(
    sensors: Mapping[str, SensorCfg],
    known: Known,
    *,
    ground: bool,
    open_scene: bool,
    num_envs: int,
) -> tuple[dict[str, SensorPlan], list[Problem]]:
    """Look up the links of all declared sensors of N environments; see `plan_sensor`.

    Returns:
        The plans of valid sensors, and every mistake, with paths relative to the task.
    """
    plans: dict[str, SensorPlan] = {}
    problems: list[Problem] = []
    taken = {GROUND: "the ground plane", **dict.fromkeys(known, "an entity")}
    for uid, cfg in sensors.items():
        path = f"sensors.{uid}"
        plan, found = plan_sensor(uid, cfg, known, ground=ground, open_scene=open_scene)
        problems += check_uid(uid, path, taken)
        if cfg.uid not in (None, "", uid):
            message = f"the key {uid!r} is its uid; it cannot be {cfg.uid!r}: leave uid out"
            found = [Problem("uid", message), *found]
        if isinstance(cfg, CameraCfg):
            found = [*found, *check_memory(cfg, num_envs)]
        problems += [p.below(path) for p in found]
        if plan is not None:
            plans[uid] = plan
    return plans, problems


_SENSOR = mujoco.mjtSensor
_CONTACT_DATA = (1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND)) | (
    1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE)
)
_NET_FORCE = 3  # `reduce="netforce"` in MJCF: one contact, the sum of all, in world axes

_KINDS: dict[str, tuple[mujoco.mjtSensor, ...]] = {
    "contact": (_SENSOR.mjSENS_CONTACT,),
    "imu": (_SENSOR.mjSENS_FRAMEQUAT, _SENSOR.mjSENS_GYRO, _SENSOR.mjSENS_ACCELEROMETER),
    "force_torque": (_SENSOR.mjSENS_FORCE, _SENSOR.mjSENS_TORQUE),
    "frame_pose": (
        _SENSOR.mjSENS_FRAMEPOS,
        _SENSOR.mjSENS_FRAMEQUAT,
        _SENSOR.mjSENS_FRAMELINVEL,
        _SENSOR.mjSENS_FRAMEANGVEL,
    ),
}


@dataclass(frozen=True, eq=False)
class SensorIndex:
    """Columns of one sensor in the compiled model.

    Attributes:
        columns: Its columns in ``sensordata``; none if no sensor of MuJoCo's measures it.
        shape: Shape of its data: (links, others, 4) for contacts (count, then force in N), (10,)
            for an IMU (wxyz, rad/s, m/s^2), (links, 6) for force and torque (N, N m), (13,) for a
            frame (m, wxyz, m/s, rad/s).
        dofs: (n,) columns in qvel of its joints.
        geoms: (ngeom,) geoms that its rays can hit.
    """

    columns: slice = field(default_factory=lambda: slice(0, 0))
    shape: tuple[int, ...] = ()
    dofs: Ids = field(default_factory=lambda: np.zeros(0, np.int64))
    geoms: Mask = field(default_factory=lambda: np.zeros(0, np.bool_))


@dataclass(frozen=True, eq=False)
class CameraIndex(SensorIndex):
    """A camera sensor in the compiled model; it has no columns.

    Attributes:
        ids: MuJoCo's ids of its cameras: one, or left and right.
        entity_of_geom: (ngeom + 1,) int32 number in masks of each geom; the last is -1.
        pictures: Name of each of its pictures, ``UID`` or ``UID/right``, in the order of `ids`.
        size: Width and height in pixels.
    """

    ids: tuple[int, ...] = ()
    entity_of_geom: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))
    pictures: tuple[str, ...] = ()
    size: tuple[int, int] = (0, 0)


def add_sensor(spec: mujoco.MjSpec, plan: SensorPlan) -> None:
    """Add the cameras of a sensor, or MuJoCo's sensors for it, ``UID/...``, contiguous."""
    if isinstance(plan.cfg, CameraCfg):
        add_camera(spec, plan.uid, plan.cfg, next(iter(plan.places), None))
    elif isinstance(plan.cfg, ContactSensorCfg):
        _add_contacts(spec, plan)
    elif plan.cfg.sensor_type in _KINDS:
        _add_sites(spec, plan)


def _add_contacts(spec: mujoco.MjSpec, plan: SensorPlan) -> None:
    """Add a MuJoCo sensor for every pair of a link or geom and an object of `others`."""
    own = _OBJECT.mjOBJ_BODY if plan.kind == "link" else _OBJECT.mjOBJ_GEOM
    for i, frame in enumerate(plan.frames):
        for j, (kind, name) in enumerate(plan.others or ((_OBJECT.mjOBJ_UNKNOWN, ""),)):
            sensor = spec.add_sensor(name=f"{plan.uid}/{i}/{j}", type=_SENSOR.mjSENS_CONTACT)
            sensor.objtype, sensor.objname = own, frame
            sensor.reftype, sensor.refname = kind, name
            sensor.intprm[:3] = [_CONTACT_DATA, _NET_FORCE, 1]


def _add_sites(spec: mujoco.MjSpec, plan: SensorPlan) -> None:
    """Add the sensors at every link, site or geom, with a site there unless MuJoCo needs none."""
    cfg = plan.cfg
    pos, quat = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    if isinstance(cfg, (ImuSensorCfg, FramePoseSensorCfg)):
        pos, quat = (
            np.asarray(cfg.pos, np.float64),
            normalize_quat(np.asarray(cfg.quat, np.float64)),
        )
    moved = bool(pos.any()) or quat[0] != 1.0
    for i, (name, place) in enumerate(zip(plan.frames, plan.places, strict=True)):
        # Its own object, so that it follows the fields of an environment's model.
        own = plan.kind == "site" or (plan.kind == "geom" and isinstance(cfg, FramePoseSensorCfg))
        kind = OBJECTS[plan.kind]
        if moved or not own:
            kind, name = _OBJECT.mjOBJ_SITE, f"{plan.uid}/{i}"
            body, at, turned = place
            spec.body(body).add_site(
                name=name,
                size=[1e-3] * 3,
                group=5,
                pos=at + quat_rotate(turned, pos),
                quat=quat_multiply(turned, quat),
            )
        for j, measured in enumerate(_KINDS[cfg.sensor_type]):
            sensor = spec.add_sensor(name=f"{plan.uid}/{i}/{j}", type=measured)
            sensor.objtype, sensor.objname = kind, name
            for reference, other in plan.others:
                sensor.reftype, sensor.refname = reference, other


def is_silent(model: mujoco.MjModel, plan: SensorPlan) -> bool:
    """Whether a sensor is a contact sensor that can never report a contact."""
    if not isinstance(plan.cfg, ContactSensorCfg):
        return False
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    collides[np.concatenate([model.pair_geom1, model.pair_geom2])] = True  # a file's own pairs
    if plan.kind == "geom":
        return not collides[[model.geom(name).id for name in plan.frames]].any()
    links = [model.body(name).id for name in plan.bodies]
    return not np.isin(links, model.geom_bodyid[collides]).any()


def index_sensor(
    model: mujoco.MjModel, plan: SensorPlan, entities: Mapping[str, EntityIndex]
) -> SensorIndex:
    """Find a sensor's columns, joints, geoms and cameras in the compiled model.

    Args:
        model: The model.
        plan: The sensor.
        entities: Indices of the entities in the model, by uid.
    """
    cfg, count = plan.cfg, len(plan.names)
    if isinstance(cfg, CameraCfg):
        named = picture_names(plan.uid, cfg)
        return CameraIndex(
            ids=tuple(int(model.camera(name).id) for name in named.values()),
            entity_of_geom=entity_of_geom(model, entities),
            pictures=tuple(named),
            size=(cfg.width, cfg.height),
        )
    if isinstance(cfg, RayCastCfg):
        return SensorIndex(geoms=_targets(model, cfg, entities))
    if isinstance(cfg, JointTorqueSensorCfg):
        dofs = [model.joint(name).dofadr[0] for name in plan.joints]
        return SensorIndex(dofs=np.array(dofs, np.int64))
    if isinstance(cfg, ContactSensorCfg):
        parts = max(1, len(plan.others))
        shape: tuple[int, ...] = (count, parts, 4)
    else:
        parts = len(_KINDS[cfg.sensor_type])
        shapes = {"imu": (10,), "frame_pose": (13,), "force_torque": (count, 6)}
        shape = shapes[cfg.sensor_type]
    first = model.sensor(f"{plan.uid}/0/0").id
    last = model.sensor(f"{plan.uid}/{count - 1}/{parts - 1}").id
    start = int(model.sensor_adr[first])
    stop = int(model.sensor_adr[last] + model.sensor_dim[last])
    if stop - start != int(np.prod(shape)):
        raise RuntimeError(f"{plan.uid}: MuJoCo keeps its numbers in columns {start} to {stop}")
    return SensorIndex(slice(start, stop), shape)


def _targets(model: mujoco.MjModel, cfg: RayCastCfg, entities: Mapping[str, EntityIndex]) -> Mask:
    """(ngeom,) geoms that a sensor's rays can hit."""
    hits: Mask = np.isin(model.geom_group, cfg.geom_groups)
    if cfg.hit is not None:
        hits &= _geoms(model, cfg.hit, entities)
    own = cfg.of.uid
    excluded = [own] if own and own not in (cfg.hit or ()) else []
    return hits & ~_geoms(model, excluded if cfg.exclude is None else cfg.exclude, entities)


def _geoms(model: mujoco.MjModel, uids: Sequence[str], entities: Mapping[str, EntityIndex]) -> Mask:
    """(ngeom,) the geoms of these entities."""
    found: Mask = np.zeros(model.ngeom, np.bool_)
    for uid in uids:
        found[model.geom(GROUND).id if uid == GROUND else entities[uid].geom_ids] = True
    return found
