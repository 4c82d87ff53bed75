"""Which links the declared sensors mean, and every mistake in them; nothing of MuJoCo's model.

What is computed on those links is `sensors`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.entity_names import Known, check_reference
from embodichain.lab.sim.compiler.names import check_uid, match
from embodichain.lab.sim.compiler.visuals import GROUND
from embodichain.lab.sim.sensors.cfg import (
    ContactSensorCfg,
    ForceTorqueSensorCfg,
    ImuSensorCfg,
    LinksCfg,
    SensorCfg,
)
from embodichain.utils.errors import Problem

__all__ = ["SensorPlan", "plan_sensor", "plan_sensors"]

_OBJECT = mujoco.mjtObj
_TYPES = (ContactSensorCfg, ImuSensorCfg, ForceTorqueSensorCfg)


@dataclass(frozen=True)
class SensorPlan:
    """A declared sensor whose names are known to exist.

    Attributes:
        uid: Its name.
        cfg: Its config.
        links: (n,) the links it sits on, as users call them.
        bodies: (n,) the same as bodies of the model.
        others: What a contact sensor's links touch: MuJoCo's object type and name of each; empty is
            anything.
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
        The plans of those that are right, and every mistake, with paths relative to the task.
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
        problems += [Problem(f"{path}.{p.path}", p.message, p.hint) for p in found]
        if plan is not None:
            plans[uid] = plan
    return plans, problems


def plan_sensor(
    uid: str, cfg: SensorCfg, known: Known, *, ground: bool = True, open_scene: bool = False
) -> tuple[SensorPlan | None, list[Problem]]:
    """Look up the links that a sensor means.

    Args:
        uid: Its name.
        cfg: Its config.
        known: The entities of the scene.
        ground: Whether the scene has the ground plane.
        open_scene: Whether Python code may add entities: an unknown one is then no mistake.

    Returns:
        The plan (None if it is wrong or not all known yet), and every mistake, with paths relative
        to the sensor's config.
    """
    if not isinstance(cfg, _TYPES):
        types = ", ".join(str(kind().sensor_type) for kind in _TYPES)
        name = getattr(cfg, "sensor_type", "") or type(cfg).__name__
        return None, [Problem("sensor_type", f"no sensor {name!r}; there are: {types}")]
    links, problems = _links("entity_cfg", cfg.entity_cfg, known, open_scene)
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


def _links(
    path: str, cfg: LinksCfg, known: Known, open_scene: bool
) -> tuple[tuple[str, ...], list[Problem]]:
    """The links that a config picks, all of them if it names none."""
    fields = {"uid": cfg.uid, "link_names": cfg.link_names}
    problems = check_reference(path, fields, known, open_scene)
    entity = known.get(cfg.uid)
    if problems or entity is None:
        return (), problems
    names = (cfg.uid,) if isinstance(entity, str) else entity.link_names
    if cfg.link_names is None:
        return names, []
    patterns = [cfg.link_names] if isinstance(cfg.link_names, str) else cfg.link_names
    picked = [i for p in patterns for i in match(p, names, "link", path)[0]]
    unique = list(dict.fromkeys(picked))
    ordered = unique if cfg.preserve_order else sorted(unique)
    if not ordered:
        return (), [Problem(f"{path}.link_names", "names no link; leave it out for all")]
    return tuple(names[i] for i in ordered), []


def _one(
    cfg: LinksCfg, links: tuple[str, ...], known: Known
) -> tuple[tuple[str, ...], list[Problem]]:
    """The one link that an IMU sits on: the picked one, else the root."""
    entity = known.get(cfg.uid)
    if cfg.link_names is None and links and not isinstance(entity, str) and entity is not None:
        return (entity.root_link_name,), []
    if len(links) > 1:
        message = f"one link is wanted, these match: {', '.join(links)}"
        return (), [Problem("entity_cfg.link_names", message)]
    return links, []


def _check_mount(cfg: ImuSensorCfg) -> list[Problem]:
    """Check how an IMU sits on its link."""
    problems = []
    for key, size in (("pos", 3), ("quat", 4)):
        value: Any = getattr(cfg, key)
        array = np.asarray(value, np.float64)
        if array.shape != (size,) or not np.isfinite(array).all():
            problems.append(Problem(key, f"wants {size} finite numbers, got {value!r}"))
        elif key == "quat" and not array.any():
            problems.append(Problem(key, "must not be zero: it is a rotation, wxyz"))
    return problems


def _others(
    cfg: LinksCfg, known: Known, ground: bool, open_scene: bool
) -> tuple[tuple[tuple[mujoco.mjtObj, str], ...], list[Problem]]:
    """What contacts count: the ground's shape, an entity's whole tree, or single links."""
    if cfg.uid == GROUND and ground:
        if cfg.link_names is not None:
            return (), [Problem("against.link_names", f"{GROUND!r} has no links")]
        return ((_OBJECT.mjOBJ_GEOM, GROUND),), []
    if ground:
        known = {GROUND: "ground plane", **known}  # for the list of what there is
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
