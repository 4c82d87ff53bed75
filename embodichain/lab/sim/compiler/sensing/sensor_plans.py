"""`SensorPlan`: a declared sensor whose config and names were checked."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.names import (
    GROUND,
    FrameKind,
    Known,
    KnownObject,
    NamedBy,
    frame_in_model,
    frame_names,
    no_such,
    pick,
)
from embodichain.lab.sim.compiler.scene.known import Place, place_of
from embodichain.lab.sim.compiler.sensing.cameras import check_camera, mount
from embodichain.lab.sim.configs.sensor_cfg import (
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

__all__ = ["OBJECTS", "SensorPlan", "plan_sensor"]

_OBJECT = mujoco.mjtObj
OBJECTS: dict[FrameKind, mujoco.mjtObj] = {
    "link": _OBJECT.mjOBJ_XBODY,
    "site": _OBJECT.mjOBJ_SITE,
    "geom": _OBJECT.mjOBJ_GEOM,
}
"""MuJoCo's object types whose frames these are."""
_FRAME_KEYS = ("link_names", "site_names", "geom_names", "link", "site", "geom")
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
        names: (n,) names of the links, sites or geoms it is fixed on, or of its joints; none for a
            camera or rays fixed in the environment.
        kind: Whether `frames` are links, sites or geoms.
        frames: (n,) their names in the model; empty for a sensor of joints.
        places: (n,) where the file has them: the body and the pose in its frame.
        joints: (n,) names of its joints in the model.
        named_by: The entries of the config that name them; none if it takes all.
        others: Objects with which contacts count, or in whose frame a pose is measured: MuJoCo's
            object type and name of each; empty is any object, or the world.
    """

    uid: str
    cfg: SensorCfg
    names: tuple[str, ...]
    kind: FrameKind = "link"
    frames: tuple[str, ...] = ()
    places: tuple[Place, ...] = ()
    joints: tuple[str, ...] = ()
    others: tuple[tuple[mujoco.mjtObj, str], ...] = ()
    named_by: tuple[NamedBy, ...] = ()

    @property
    def bodies(self) -> tuple[str, ...]:
        """(n,) names in the model of the bodies that carry the frames."""
        return tuple(body for body, _, _ in self.places)


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
    if isinstance(cfg, ImuSensorCfg):
        frames, problems = scene.one("of", cfg.of)
        problems += _check_mount(cfg.pos, cfg.quat)
    else:
        frames, problems = scene.frames("of", cfg.of)
    others: tuple[tuple[mujoco.mjtObj, str], ...] = ()
    if isinstance(cfg, ContactSensorCfg):
        problems += _refuse_sites("of", frames)
        if cfg.against is not None:
            others, found = scene.others(cfg.against)
            problems += found
            if not others:
                frames = None
    if problems or frames is None:
        return None, problems
    return frames.plan(uid, cfg, others), []


def _refuse_sites(path: str, frames: _Frames | None) -> list[Problem]:
    if frames is None or frames.kind != "site":
        return []
    message = "a site touches nothing: name the geom or the link that carries it"
    return [Problem(f"{path}.site_names", message)]


def _plan_camera(uid: str, cfg: CameraCfg, scene: _Names) -> _Plan:
    problems = check_camera(cfg)
    where, found = mount(cfg, scene.known)
    problems += found
    if where is None:
        return SensorPlan(uid, cfg, ()), problems
    frames, found = scene.one("of", where)
    problems += found
    if problems or frames is None:
        return None, problems
    return frames.plan(uid, cfg), []


def _plan_frame(uid: str, cfg: FramePoseSensorCfg, scene: _Names) -> _Plan:
    entity, problems = cfg.of, list[Problem]()
    if cfg.site is not None:
        given = [key for key in _FRAME_KEYS if getattr(entity, key) is not None]
        if given:
            message = f"give a site or {given[0]}, not both"
            problems.append(Problem("site", message))
        else:
            entity = dataclasses.replace(entity, site=cfg.site)
            problems += scene.site(cfg)
        if any(cfg.pos) or tuple(cfg.quat) != (1, 0, 0, 0):
            message = "has its own pose: leave pos and quat out, or name it in of"
            problems.append(Problem("site", message))
    frames, found = (None, []) if problems else scene.one("of", entity)
    problems += found
    problems += _check_mount(cfg.pos, cfg.quat)
    others: tuple[tuple[mujoco.mjtObj, str], ...] = ()
    if cfg.relative_to is not None:
        reference, found = scene.one("relative_to", cfg.relative_to)
        problems += found
        if reference is None:
            frames = None
        else:
            others = tuple((OBJECTS[reference.kind], name) for name in reference.in_model)
    if problems or frames is None:
        return None, problems
    return frames.plan(uid, cfg, others), []


def _plan_joints(uid: str, cfg: JointTorqueSensorCfg, scene: _Names) -> _Plan:
    entity = cfg.of
    joints, named_by, problems = scene.joints(entity)
    if problems or not joints:
        return None, problems
    in_model = tuple(f"{entity.uid}/{name}" for name in joints)
    return SensorPlan(uid, cfg, joints, joints=in_model, named_by=named_by), []


def _plan_rays(uid: str, cfg: RayCastCfg, scene: _Names) -> _Plan:
    entity = cfg.of
    fixed = entity == LinksCfg()
    frames, problems = (None, []) if fixed else scene.one("of", entity)
    problems += _check_mount(cfg.pos, cfg.quat)
    problems += _check_pattern(cfg.pattern)
    problems += _check_rays(cfg)
    for key in ("hit", "exclude"):
        problems += scene.entities(key, getattr(cfg, key))
    if problems or not (frames or fixed):
        return None, problems
    return (SensorPlan(uid, cfg, ()) if frames is None else frames.plan(uid, cfg)), []


@dataclass(frozen=True)
class _Frames:
    """Frames of an entity that a sensor is fixed on, or with which it has to do.

    Attributes:
        kind: Whether they are links, sites or geoms.
        names: Their names.
        in_model: Their names in the model.
        places: Where the file has them.
        named_by: The entries that name them; none if all were taken.
    """

    kind: FrameKind
    names: tuple[str, ...]
    in_model: tuple[str, ...]
    places: tuple[Place, ...]
    named_by: tuple[NamedBy, ...]

    def plan(
        self, uid: str, cfg: SensorCfg, others: tuple[tuple[mujoco.mjtObj, str], ...] = ()
    ) -> SensorPlan:
        """The plan of a sensor that is fixed on them."""
        return SensorPlan(
            uid,
            cfg,
            self.names,
            self.kind,
            self.in_model,
            self.places,
            others=others,
            named_by=self.named_by,
        )


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

    def frames(self, path: str, cfg: LinksCfg) -> tuple[_Frames | None, list[Problem]]:
        """The links, sites or geoms that a config picks; by default all links."""
        picked, problems = pick(path, vars(cfg), self.known, self.open_scene)
        entity = self.known.get(cfg.uid)
        if problems or entity is None:
            return None, problems
        names = frame_names(entity, cfg.uid, picked.kind)
        if names is None:
            return None, []
        if not _picks(cfg):
            chosen = names
        elif picked.frames:
            chosen = tuple(names[i] for i in picked.frames)
        else:
            return None, [Problem(f"{path}.link_names", "names no link; leave it out for all")]
        return _Frames(
            picked.kind,
            chosen,
            tuple(frame_in_model(entity, cfg.uid, picked.kind, name) for name in chosen),
            tuple(place_of(entity, cfg.uid, picked.kind, name) for name in chosen),
            picked.frames_by,
        ), []

    def one(self, path: str, cfg: LinksCfg) -> tuple[_Frames | None, list[Problem]]:
        """The one link, site or geom that a config picks; by default the root."""
        entity = self.known.get(cfg.uid)
        if not _picks(cfg) and entity is not None and not isinstance(entity, (str, KnownObject)):
            cfg = dataclasses.replace(cfg, link=entity.root_link_name)
        frames, problems = self.frames(path, cfg)
        if frames is not None and len(frames.names) > 1:
            message = f"one {frames.kind} is wanted, these match: {', '.join(frames.names)}"
            return None, [Problem(f"{path}.{frames.kind}_names", message)]
        return frames, problems

    def joints(self, cfg: JointsCfg) -> tuple[tuple[str, ...], tuple[NamedBy, ...], list[Problem]]:
        """The joints that a config picks, by default all active ones, and its entries."""
        for key in (key for key in _FRAME_KEYS if getattr(cfg, key) is not None):
            return (), (), [Problem(f"of.{key}", "this sensor takes joint_names")]
        picked, problems = pick("of", vars(cfg), self.known, self.open_scene)
        entity = self.known.get(cfg.uid)
        if problems or entity is None:
            return (), (), problems
        if isinstance(entity, (str, KnownObject)):
            what = entity if isinstance(entity, str) else "rigid object"
            return (), (), [Problem("of.uid", f"{cfg.uid!r} is a {what} without joints")]
        if not picked.joints:
            return (), (), [Problem("of", f"picks no joint of {cfg.uid!r}")]
        return tuple(entity.joint_names[i] for i in picked.joints), picked.joints_by, []

    def site(self, cfg: FramePoseSensorCfg) -> list[Problem]:
        """Check the site that is named beside the entity."""
        entity = self.known.get(cfg.of.uid)
        names = None if entity is None else frame_names(entity, cfg.of.uid, "site")
        if names is None or cfg.site is None or cfg.site in names:
            return []
        return [no_such("site", cfg.site, names or ("none",), "site")]

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
        """Objects with which contacts count: the ground's geom, an entity's tree, links, geoms."""
        if cfg.uid == GROUND and self.ground:
            for key in (key for key in _FRAME_KEYS if getattr(cfg, key) is not None):
                return (), [Problem(f"against.{key}", f"{GROUND!r} has no links, sites or geoms")]
            return ((_OBJECT.mjOBJ_GEOM, GROUND),), []
        known = {GROUND: "ground plane", **self.known} if self.ground else self.known
        frames, problems = _Names(known, self.ground, self.open_scene).frames("against", cfg)
        problems += _refuse_sites("against", frames)
        entity = known.get(cfg.uid)
        if problems or frames is None or entity is None:
            return (), problems
        if not _picks(cfg) and not isinstance(entity, (str, KnownObject)):
            return ((_OBJECT.mjOBJ_XBODY, f"{cfg.uid}/{entity.root_link_name}"),), []
        kind = _OBJECT.mjOBJ_BODY if frames.kind == "link" else _OBJECT.mjOBJ_GEOM
        return tuple((kind, name) for name in frames.in_model), []


def _picks(cfg: LinksCfg) -> bool:
    """Whether a config names links, sites or geoms."""
    return any(getattr(cfg, key) is not None for key in _FRAME_KEYS)


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
