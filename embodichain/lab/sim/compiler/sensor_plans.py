"""`SensorPlan`: a declared sensor whose config and names were checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.cameras import check_camera, mount
from embodichain.lab.sim.compiler.names import GROUND, Known, no_such, pick
from embodichain.lab.sim.sensors.cfg import (
    CameraCfg,
    ContactSensorCfg,
    ForceTorqueSensorCfg,
    FramePoseSensorCfg,
    HeightScanSensorCfg,
    ImuSensorCfg,
    JointsCfg,
    JointTorqueSensorCfg,
    LinksCfg,
    RayCastCfg,
    RayFanCfg,
    RayGridCfg,
    RayPatternCfg,
    RaySensorCfg,
    SensorCfg,
)
from embodichain.utils.errors import Problem

__all__ = ["SensorPlan", "plan_sensor"]

_OBJECT = mujoco.mjtObj
_TYPES = (
    ContactSensorCfg,
    ImuSensorCfg,
    ForceTorqueSensorCfg,
    FramePoseSensorCfg,
    JointTorqueSensorCfg,
    RaySensorCfg,
    HeightScanSensorCfg,
    CameraCfg,
)
_MOST_RAYS = 100_000
_ALIGNMENTS = ("base", "yaw", "world")
_NO_HITS = ("max", "inf", "zero")


@dataclass(frozen=True)
class SensorPlan:
    """A declared sensor with checked names.

    Attributes:
        uid: Its name.
        cfg: Its config.
        names: (n,) names of the links it is fixed on, or of its joints; none for a camera or rays
            fixed in the environment.
        bodies: (n,) names of the links' bodies in the model; empty for a sensor of joints.
        joints: (n,) names of its joints in the model.
        others: Objects with which contacts count, or in whose frame a pose is measured: MuJoCo's
            object type and name of each; empty is any object, or the world.
        site: Name in the model of the site whose frame is measured; empty is a link's frame.
    """

    uid: str
    cfg: SensorCfg
    names: tuple[str, ...]
    bodies: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    others: tuple[tuple[mujoco.mjtObj, str], ...] = ()
    site: str = ""


def plan_sensor(
    uid: str, cfg: SensorCfg, known: Known, *, ground: bool = True, open_scene: bool = False
) -> tuple[SensorPlan | None, list[Problem]]:
    """Check a sensor's config, and look up its links, joints and other names.

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
    scene = _Names(known, ground, open_scene)
    problems = []
    if cfg.rate is not None and not 0 < cfg.rate < np.inf:
        problems.append(Problem("rate", f"must be positive and finite, Hz, got {cfg.rate!r}"))
    if isinstance(cfg, CameraCfg):
        plan, found = _plan_camera(uid, cfg, scene)
    elif isinstance(cfg, JointTorqueSensorCfg):
        plan, found = _plan_joints(uid, cfg, scene)
    elif isinstance(cfg, RayCastCfg):
        plan, found = _plan_rays(uid, cfg, scene)
    elif isinstance(cfg, FramePoseSensorCfg):
        plan, found = _plan_frame(uid, cfg, scene)
    else:
        plan, found = _plan_links(uid, cfg, scene)
    problems += found
    return None if problems else plan, problems


_Plan = tuple[SensorPlan | None, list[Problem]]


def _plan_links(uid: str, cfg: SensorCfg, scene: _Names) -> _Plan:
    """Plan contacts, forces and torques on links, or an IMU on one link."""
    entity = cfg.entity_cfg
    if isinstance(cfg, ImuSensorCfg):
        links, problems = scene.link("entity_cfg", entity)
        problems += _check_mount(cfg.pos, cfg.quat)
    else:
        links, problems = scene.links("entity_cfg", entity)
    others: tuple[tuple[mujoco.mjtObj, str], ...] = ()
    if isinstance(cfg, ContactSensorCfg) and cfg.against is not None:
        others, found = scene.others(cfg.against)
        problems += found
        if not others:
            links = ()
    if problems or not links:
        return None, problems
    return SensorPlan(uid, cfg, links, scene.bodies(entity.uid, links), others=others), []


def _plan_camera(uid: str, cfg: CameraCfg, scene: _Names) -> _Plan:
    problems = check_camera(cfg)
    where, found = mount(cfg, scene.known)
    problems += found
    if where is None:
        return SensorPlan(uid, cfg, ()), problems
    links, found = scene.link("entity_cfg", where)
    problems += found
    if problems or not links:
        return None, problems
    return SensorPlan(uid, cfg, links, scene.bodies(where.uid, links)), []


def _plan_frame(uid: str, cfg: FramePoseSensorCfg, scene: _Names) -> _Plan:
    entity, site = cfg.entity_cfg, ""
    links, problems = scene.link("entity_cfg", entity)
    problems += _check_mount(cfg.pos, cfg.quat)
    if cfg.site is not None:
        site, found = scene.site(entity.uid, cfg.site)
        problems += found
        if entity.link_names is not None:
            problems.append(Problem("site", "give a site or link_names, not both"))
        if any(cfg.pos) or tuple(cfg.quat) != (1, 0, 0, 0):
            problems.append(Problem("site", "has its own pose: leave pos and quat out"))
    others: tuple[tuple[mujoco.mjtObj, str], ...] = ()
    if cfg.relative_to is not None:
        reference, found = scene.link("relative_to", cfg.relative_to)
        problems += found
        names = scene.bodies(cfg.relative_to.uid, reference)
        others = tuple((_OBJECT.mjOBJ_XBODY, name) for name in names)
        if not others:
            links = ()
    if problems or not links:
        return None, problems
    bodies = scene.bodies(entity.uid, links)
    return SensorPlan(uid, cfg, links, bodies, others=others, site=site), []


def _plan_joints(uid: str, cfg: JointTorqueSensorCfg, scene: _Names) -> _Plan:
    entity = cfg.entity_cfg
    joints, problems = scene.joints(entity)
    if problems or not joints:
        return None, problems
    in_model = tuple(f"{entity.uid}/{name}" for name in joints)
    return SensorPlan(uid, cfg, joints, joints=in_model), []


def _plan_rays(uid: str, cfg: RayCastCfg, scene: _Names) -> _Plan:
    entity = cfg.entity_cfg
    fixed = entity == LinksCfg()
    links, problems = ((), []) if fixed else scene.link("entity_cfg", entity)
    problems += _check_mount(cfg.pos, cfg.quat)
    problems += _check_pattern(cfg.pattern)
    problems += _check_rays(cfg)
    for key in ("hit", "exclude"):
        problems += scene.entities(key, getattr(cfg, key))
    if problems or not (links or fixed):
        return None, problems
    return SensorPlan(uid, cfg, links, scene.bodies(entity.uid, links)), []


@dataclass(frozen=True)
class _Names:
    """Names of a scene.

    Attributes:
        known: Its entities.
        ground: Whether it has the ground plane.
        open_scene: Whether unknown entities are allowed.
    """

    known: Known
    ground: bool
    open_scene: bool

    def links(self, path: str, cfg: LinksCfg) -> tuple[tuple[str, ...], list[Problem]]:
        """The links that a config picks; by default all."""
        picked, problems = pick(path, vars(cfg), self.known, self.open_scene)
        entity = self.known.get(cfg.uid)
        if problems or entity is None:
            return (), problems
        names = (cfg.uid,) if isinstance(entity, str) else entity.link_names
        if cfg.link_names is None:
            return names, []
        if not picked.links:
            return (), [Problem(f"{path}.link_names", "names no link; leave it out for all")]
        return tuple(names[i] for i in picked.links), []

    def link(self, path: str, cfg: LinksCfg) -> tuple[tuple[str, ...], list[Problem]]:
        """The one link that a config picks; by default the root."""
        links, problems = self.links(path, cfg)
        entity = self.known.get(cfg.uid)
        if cfg.link_names is None and links and not isinstance(entity, str) and entity is not None:
            return (entity.root_link_name,), []
        if len(links) > 1:
            message = f"one link is wanted, these match: {', '.join(links)}"
            return (), [Problem(f"{path}.link_names", message)]
        return links, problems

    def joints(self, cfg: JointsCfg) -> tuple[tuple[str, ...], list[Problem]]:
        """The joints that a config picks; by default all active ones."""
        if cfg.link_names is not None:
            return (), [Problem("entity_cfg.link_names", "this sensor takes joint_names")]
        picked, problems = pick("entity_cfg", vars(cfg), self.known, self.open_scene)
        entity = self.known.get(cfg.uid)
        if problems or entity is None:
            return (), problems
        if isinstance(entity, str):
            return (), [Problem("entity_cfg.uid", f"{cfg.uid!r} is a {entity} without joints")]
        if not picked.joints:
            return (), [Problem("entity_cfg", f"picks no joint of {cfg.uid!r}")]
        return tuple(entity.joint_names[i] for i in picked.joints), []

    def site(self, uid: str, name: str) -> tuple[str, list[Problem]]:
        """The name of an entity's site in the model."""
        entity = self.known.get(uid)
        if entity is None:
            return "", []
        names = () if isinstance(entity, str) else entity.site_names
        if name not in names:
            return "", [no_such("site", name, names or ("none",), "site")]
        return f"{uid}/{name}", []

    def entities(self, key: str, uids: Sequence[str] | None) -> list[Problem]:
        """Check uids of entities, or of the ground plane."""
        if uids is None:
            return []
        there = [name for name, what in self.known.items() if what != "light"]
        there += [GROUND] if self.ground else []
        problems = [
            no_such("entity", uid, there, f"{key}.{i}")
            for i, uid in enumerate(uids)
            if uid not in there and (not self.open_scene or uid in self.known)
        ]
        if key == "hit" and not uids:
            problems.append(Problem(key, "names no entity; leave it out for all"))
        return problems

    def others(self, cfg: LinksCfg) -> tuple[tuple[tuple[mujoco.mjtObj, str], ...], list[Problem]]:
        """Objects with which contacts count: the ground's geom, an entity's tree, or links."""
        if cfg.uid == GROUND and self.ground:
            if cfg.link_names is not None:
                return (), [Problem("against.link_names", f"{GROUND!r} has no links")]
            return ((_OBJECT.mjOBJ_GEOM, GROUND),), []
        known = {GROUND: "ground plane", **self.known} if self.ground else self.known
        links, problems = _Names(known, self.ground, self.open_scene).links("against", cfg)
        entity = known.get(cfg.uid)
        if not links or entity is None:
            return (), problems
        if cfg.link_names is None and not isinstance(entity, str):
            return ((_OBJECT.mjOBJ_XBODY, f"{cfg.uid}/{entity.root_link_name}"),), []
        return tuple((_OBJECT.mjOBJ_BODY, name) for name in self.bodies(cfg.uid, links)), []

    def bodies(self, uid: str, links: Sequence[str]) -> tuple[str, ...]:
        """The names of links' bodies in the model."""
        if isinstance(self.known.get(uid), str):
            return (uid,) * len(links)
        return tuple(f"{uid}/{link}" for link in links)


# -- values ----------------------------------------------------------------------------------------


def _check_numbers(key: str, value: Any, size: int) -> list[Problem]:
    array = np.asarray(value, np.float64)
    if array.shape == (size,) and np.isfinite(array).all():
        return []
    return [Problem(key, f"must be {size} finite numbers, got {value!r}")]


def _check_mount(pos: Any, quat: Any) -> list[Problem]:
    """Check the pose of a sensor on its link."""
    problems = _check_numbers("pos", pos, 3) + _check_numbers("quat", quat, 4)
    if not any(p.path == "quat" for p in problems) and not np.any(quat):
        problems.append(Problem("quat", "must not be zero: it is a rotation, wxyz"))
    return problems


def _check_direction(key: str, value: Any) -> list[Problem]:
    problems = _check_numbers(key, value, 3)
    if not problems and not np.any(value):
        problems = [Problem(key, "must not be zero: it is a direction")]
    return problems


def _check_pattern(cfg: RayPatternCfg) -> list[Problem]:
    """Check the rays."""
    given = [name for name, value in vars(cfg).items() if value is not None]
    if len(given) != 1:
        message = f"give one of {', '.join(vars(cfg))}; got {', '.join(given) or 'none'}"
        return [Problem("pattern", message)]
    if cfg.grid is not None:
        found = [p.below("pattern.grid") for p in _check_grid(cfg.grid)]
        return found or _check_count(_grid_size(cfg.grid))
    if cfg.fan is not None:
        count = cfg.fan.horizontal_count * cfg.fan.vertical_count
        return [p.below("pattern.fan") for p in _check_fan(cfg.fan)] or _check_count(count)
    directions = cfg.directions or []
    if not directions:
        return [Problem("pattern.directions", "names no ray")]
    found = []
    for i, value in enumerate(directions):
        found += _check_direction(f"pattern.directions.{i}", value)
    return found or _check_count(len(directions))


def _check_count(rays: float) -> list[Problem]:
    if rays <= _MOST_RAYS:
        return []
    return [Problem("pattern", f"has {rays:.0f} rays; a sensor can have {_MOST_RAYS}")]


def _check_grid(cfg: RayGridCfg) -> list[Problem]:
    problems = _check_numbers("size", cfg.size, 2) + _check_direction("direction", cfg.direction)
    if not problems and min(cfg.size) < 0:
        problems.append(Problem("size", f"must not be negative, got {list(cfg.size)}"))
    if not 0 < cfg.resolution < np.inf:
        problems.append(Problem("resolution", f"must be positive, metres, got {cfg.resolution!r}"))
    return problems


def _grid_size(cfg: RayGridCfg) -> float:
    """How many points a grid has, at most."""
    across, along = (length / cfg.resolution + 1 for length in cfg.size)
    return across * along


def _check_fan(cfg: RayFanCfg) -> list[Problem]:
    problems: list[Problem] = []
    for axis in ("horizontal", "vertical"):
        key, count = f"{axis}_range", getattr(cfg, f"{axis}_count")
        bounds = getattr(cfg, key)
        found = _check_numbers(key, bounds, 2)
        if not found and bounds[0] > bounds[1]:
            found = [Problem(key, f"must be [lowest, highest], got {list(bounds)}")]
        if not count >= 1:
            found.append(Problem(f"{axis}_count", f"must be at least 1, got {count!r}"))
        problems += found
    return problems


def _check_rays(cfg: RayCastCfg) -> list[Problem]:
    """Check all of a ray sensor that is neither a name nor its pattern."""
    problems = [
        Problem(key, f"must be one of {', '.join(allowed)}, got {getattr(cfg, key)!r}")
        for key, allowed in (("alignment", _ALIGNMENTS), ("no_hit", _NO_HITS))
        if getattr(cfg, key) not in allowed
    ]
    if not 0 < cfg.max_range < np.inf:
        message = f"must be positive and finite, metres, got {cfg.max_range!r}"
        problems.append(Problem("max_range", message))
    if not cfg.geom_groups or not set(cfg.geom_groups) <= set(range(6)):
        message = f"must be numbers from 0 to 5, got {cfg.geom_groups!r}"
        problems.append(Problem("geom_groups", message))
    if cfg.observe and cfg.no_hit == "inf":
        problems.append(Problem("no_hit", "observations must be finite: use max or zero"))
    if isinstance(cfg, RaySensorCfg) and not cfg.data_types:
        problems.append(Problem("data_types", "names no reading"))
    if isinstance(cfg, HeightScanSensorCfg):
        if cfg.pattern.grid is None:
            problems.append(Problem("pattern", "a height scan has a grid"))
        if not 0 <= cfg.start_height < np.inf:
            message = f"must not be negative, metres, got {cfg.start_height!r}"
            problems.append(Problem("start_height", message))
    return problems
