"""Sensors of a scene: their links, MuJoCo's sensors for them, and their columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.cameras import (
    add_camera,
    camera_names,
    check_camera,
    entity_of_geom,
    mount,
)
from embodichain.lab.sim.compiler.index import EntityIndex
from embodichain.lab.sim.compiler.names import GROUND, Known, check_uid, pick
from embodichain.lab.sim.sensors.cfg import (
    CameraCfg,
    ContactSensorCfg,
    ForceTorqueSensorCfg,
    ImuSensorCfg,
    LinksCfg,
    SensorCfg,
)
from embodichain.utils.errors import Problem

__all__ = [
    "CameraIndex",
    "SensorIndex",
    "SensorPlan",
    "add_sensors",
    "index_sensors",
    "plan_sensor",
    "plan_sensors",
    "silent_sensors",
]

_OBJECT = mujoco.mjtObj
_TYPES = (ContactSensorCfg, ImuSensorCfg, ForceTorqueSensorCfg, CameraCfg)


@dataclass(frozen=True)
class SensorPlan:
    """A declared sensor with checked names.

    Attributes:
        uid: Its name.
        cfg: Its config.
        links: (n,) names of the links it is fixed on; none for a camera fixed in the environment.
        bodies: (n,) names of their bodies in the model.
        others: Objects with which contacts count: MuJoCo's object type and name of each; empty is
            any object.
    """

    uid: str
    cfg: SensorCfg
    links: tuple[str, ...]
    bodies: tuple[str, ...]
    others: tuple[tuple[mujoco.mjtObj, str], ...] = ()


def plan_sensors(
    sensors: Mapping[str, SensorCfg], known: Known, *, ground: bool, open_scene: bool
) -> tuple[dict[str, SensorPlan], list[Problem]]:
    """Look up the links of all declared sensors; see `plan_sensor`.

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
        problems += [p.below(path) for p in found]
        if plan is not None:
            plans[uid] = plan
    return plans, problems


def plan_sensor(
    uid: str, cfg: SensorCfg, known: Known, *, ground: bool = True, open_scene: bool = False
) -> tuple[SensorPlan | None, list[Problem]]:
    """Look up the links of a sensor.

    Args:
        uid: Its name.
        cfg: Its config.
        known: The entities of the scene.
        ground: Whether the scene has the ground plane.
        open_scene: Whether Python code may add entities, so that unknown ones are allowed.

    Returns:
        The plan (None if something is wrong or unknown), and every mistake, with paths relative to
        the sensor's config.
    """
    if not isinstance(cfg, _TYPES):
        types = ", ".join(str(kind().sensor_type) for kind in _TYPES)
        name = getattr(cfg, "sensor_type", "") or type(cfg).__name__
        return None, [Problem("sensor_type", f"no sensor {name!r}; there are: {types}")]
    if isinstance(cfg, CameraCfg):
        return _plan_camera(uid, cfg, known, open_scene)
    links, problems = _links("entity_cfg", cfg.entity_cfg, known, open_scene)
    problems += _check_rate(cfg)
    if isinstance(cfg, ImuSensorCfg):
        links, found = _one(cfg.entity_cfg, links, known)
        problems += found + _check_mount(cfg)
    others: tuple[tuple[mujoco.mjtObj, str], ...] = ()
    if isinstance(cfg, ContactSensorCfg) and cfg.against is not None:
        others, found = _others(cfg.against, known, ground, open_scene)
        problems += found
        if not others:
            links = ()
    if problems or not links:
        return None, problems
    bodies = tuple(_body(cfg.entity_cfg.uid, link, known) for link in links)
    return SensorPlan(uid, cfg, links, bodies, others), []


def _plan_camera(
    uid: str, cfg: CameraCfg, known: Known, open_scene: bool
) -> tuple[SensorPlan | None, list[Problem]]:
    problems = check_camera(cfg) + _check_rate(cfg)
    where, found = mount(cfg, known)
    problems += found
    links: tuple[str, ...] = ()
    if where is not None:
        links, found = _links("entity_cfg", where, known, open_scene)
        problems += found
        links, found = _one(where, links, known)
        problems += found
    if problems or (where is not None and not links):
        return None, problems
    bodies = tuple(_body(where.uid, link, known) for link in links if where is not None)
    return SensorPlan(uid, cfg, links, bodies), []


def _check_rate(cfg: SensorCfg) -> list[Problem]:
    if cfg.rate is None or 0 < cfg.rate < np.inf:
        return []
    return [Problem("rate", f"must be positive and finite, Hz, got {cfg.rate!r}")]


def _links(
    path: str, cfg: LinksCfg, known: Known, open_scene: bool
) -> tuple[tuple[str, ...], list[Problem]]:
    """The links that a config picks; by default all."""
    picked, problems = pick(path, vars(cfg), known, open_scene)
    entity = known.get(cfg.uid)
    if problems or entity is None:
        return (), problems
    names = (cfg.uid,) if isinstance(entity, str) else entity.link_names
    if cfg.link_names is None:
        return names, []
    if not picked.links:
        return (), [Problem(f"{path}.link_names", "names no link; leave it out for all")]
    return tuple(names[i] for i in picked.links), []


def _one(
    cfg: LinksCfg, links: tuple[str, ...], known: Known
) -> tuple[tuple[str, ...], list[Problem]]:
    """The one link that an IMU is fixed on: the picked one, else the root."""
    entity = known.get(cfg.uid)
    if cfg.link_names is None and links and not isinstance(entity, str) and entity is not None:
        return (entity.root_link_name,), []
    if len(links) > 1:
        message = f"one link is wanted, these match: {', '.join(links)}"
        return (), [Problem("entity_cfg.link_names", message)]
    return links, []


def _check_mount(cfg: ImuSensorCfg) -> list[Problem]:
    """Check the pose of an IMU on its link."""
    problems = []
    for key, size in (("pos", 3), ("quat", 4)):
        value: Any = getattr(cfg, key)
        array = np.asarray(value, np.float64)
        if array.shape != (size,) or not np.isfinite(array).all():
            problems.append(Problem(key, f"must be {size} finite numbers, got {value!r}"))
        elif key == "quat" and not array.any():
            problems.append(Problem(key, "must not be zero: it is a rotation, wxyz"))
    return problems


def _others(
    cfg: LinksCfg, known: Known, ground: bool, open_scene: bool
) -> tuple[tuple[tuple[mujoco.mjtObj, str], ...], list[Problem]]:
    """Objects with which contacts count: the ground's geom, an entity's tree, or links."""
    if cfg.uid == GROUND and ground:
        if cfg.link_names is not None:
            return (), [Problem("against.link_names", f"{GROUND!r} has no links")]
        return ((_OBJECT.mjOBJ_GEOM, GROUND),), []
    if ground:
        known = {GROUND: "ground plane", **known}  # for the list in messages
    links, problems = _links("against", cfg, known, open_scene)
    entity = known.get(cfg.uid)
    if not links or entity is None:
        return (), problems
    if cfg.link_names is None and not isinstance(entity, str):
        return ((_OBJECT.mjOBJ_XBODY, f"{cfg.uid}/{entity.root_link_name}"),), []
    return tuple((_OBJECT.mjOBJ_BODY, _body(cfg.uid, link, known)) for link in links), []


def _body(uid: str, link: str, known: Known) -> str:
    """The name of a link's body in the model."""
    return uid if isinstance(known[uid], str) else f"{uid}/{link}"


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
    """Columns of one sensor in the compiled model.

    Attributes:
        columns: Its columns in ``sensordata``.
        shape: Shape of its data: (links, others, 4) for contacts (count, then force in N), (10,)
            for an IMU (wxyz, rad/s, m/s^2), (links, 6) for force and torque (N, N m).
    """

    columns: slice
    shape: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class CameraIndex(SensorIndex):
    """A camera sensor in the compiled model; it has no columns.

    Attributes:
        ids: MuJoCo's ids of its cameras: one, or left and right.
        entity_of_geom: (ngeom + 1,) int32 number in masks of each geom; the last is -1.
    """

    ids: tuple[int, ...]
    entity_of_geom: NDArray[np.int32]


def add_sensors(spec: mujoco.MjSpec, plans: Mapping[str, SensorPlan]) -> None:
    """Add MuJoCo's sensors, named ``UID/...``, contiguous for one sensor; and the cameras."""
    for plan in plans.values():
        if isinstance(plan.cfg, CameraCfg):
            add_camera(spec, plan.uid, plan.cfg, next(iter(plan.bodies), None))
        elif isinstance(plan.cfg, ContactSensorCfg):
            _add_contacts(spec, plan)
        else:
            _add_sites(spec, plan)


def _add_contacts(spec: mujoco.MjSpec, plan: SensorPlan) -> None:
    """Add a MuJoCo sensor for every pair of a link and an object of `others`."""
    for i, body in enumerate(plan.bodies):
        for j, (kind, name) in enumerate(plan.others or ((_OBJECT.mjOBJ_UNKNOWN, ""),)):
            sensor = spec.add_sensor(name=f"{plan.uid}/{i}/{j}", type=_SENSOR.mjSENS_CONTACT)
            sensor.objtype, sensor.objname = _OBJECT.mjOBJ_BODY, body
            sensor.reftype, sensor.refname = kind, name
            sensor.intprm[:3] = [_CONTACT_DATA, _NET_FORCE, 1]


def _add_sites(spec: mujoco.MjSpec, plan: SensorPlan) -> None:
    """Add a site on every link, and the sensors at it."""
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


def index_sensors(
    model: mujoco.MjModel,
    plans: Mapping[str, SensorPlan],
    entities: Mapping[str, EntityIndex],
) -> dict[str, SensorIndex]:
    """Find every sensor's columns, or cameras, in the compiled model."""
    found: dict[str, SensorIndex] = {}
    for uid, plan in plans.items():
        if isinstance(plan.cfg, CameraCfg):
            ids = tuple(int(model.camera(name).id) for name in camera_names(uid, plan.cfg))
            found[uid] = CameraIndex(slice(0, 0), (), ids, entity_of_geom(model, entities))
        else:
            found[uid] = _index(model, plan)
    return found


def silent_sensors(model: mujoco.MjModel, plans: Mapping[str, SensorPlan]) -> list[str]:
    """Return a message for every contact sensor that can never report a contact."""
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
