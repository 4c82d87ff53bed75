"""Marks of objects for pictures: a halo, and another colour while something is near."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco

from embodichain.lab.sim.cfg import HaloCfg, ReachedCfg, RigidObjectCfg
from embodichain.lab.sim.compiler.names import Known, KnownObject
from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
from embodichain.lab.sim.compiler.scene.known import find_place
from embodichain.lab.sim.drawing.marks import HALO, MARK_PREFIX, Mark, Reached
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["add_marks", "check_marks"]

_ORANGE = (0.95, 0.45, 0.1)
"""Of a halo whose object has no colour."""


def check_marks(
    objects: Mapping[str, RigidObjectCfg], known: Known, *, is_open: bool
) -> dict[str, list[Problem]]:
    """Return the mistakes in the marks of objects by uid, with paths below the object.

    Args:
        objects: The objects by uid.
        known: The declared entities.
        is_open: Whether there may be more: then an unknown one is not a mistake.
    """
    problems: dict[str, list[Problem]] = {}
    for uid, cfg in objects.items():
        if cfg.reached is None:
            continue
        if is_open and cfg.reached.by.partition("/")[0] not in known:
            continue
        _, mistakes = _find_point(cfg.reached, known)
        problems[uid] = [mistake.below("reached") for mistake in mistakes]
    return problems


def add_marks(spec: mujoco.MjSpec, objects: Mapping[str, RigidObjectCfg], known: Known) -> None:
    """Add the halos of objects, and the texts by which pictures find marks.

    Args:
        spec: The scene with all its bodies.
        objects: The objects by uid.
        known: The entities.

    Raises:
        ConfigError: If there is nothing that an object is to be reached by.
    """
    for uid, cfg in objects.items():
        if cfg.halo is None and cfg.reached is None:
            continue
        if cfg.halo is not None:
            _add_halo(spec.body(uid), uid, cfg.halo, _color_of(cfg))
        reached: Reached | None = None
        if cfg.reached is not None:
            reached, problems = _find_point(cfg.reached, known)
            if problems:
                raise ConfigError(problem.below(f"{uid}.reached") for problem in problems)
        spec.add_text(name=f"{MARK_PREFIX}{uid}", data=Mark(uid=uid, reached=reached).as_text())


def _color_of(cfg: RigidObjectCfg) -> tuple[float, ...]:
    """RGB of an object."""
    material = cfg.shape.visual_material
    if material is None:
        return _ORANGE
    return tuple(float(share) for share in material.base_color[:3])


def _add_halo(
    body: mujoco.MjsBody, uid: str, cfg: HaloCfg, color_of_object: tuple[float, ...]
) -> None:
    """Add a sphere that touches nothing, weighs nothing and is invisible but in pictures."""
    color = color_of_object if cfg.color is None else [float(share) for share in cfg.color]
    body.add_geom(
        name=f"{uid}/{HALO}",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[float(cfg.radius), 0.0, 0.0],
        rgba=[*color, 0.0],
        mass=0.0,
        contype=0,
        conaffinity=0,
    )


def _find_point(cfg: ReachedCfg, known: Known) -> tuple[Reached | None, list[Problem]]:
    """Find what an object is reached by; the problem is that there is no such thing."""
    uid, slash, _ = cfg.by.partition("/")
    entity = known.get(uid)
    if slash:
        place, problems = find_place(cfg.by, known)
        if place is not None:
            return _reached(cfg, place.body, place.pos.tolist()), []
        if problems:
            return None, [Problem("by", problem.message, problem.hint) for problem in problems]
    elif isinstance(entity, KnownObject):
        return _reached(cfg, entity.body, [0.0, 0.0, 0.0]), []
    elif isinstance(entity, ParsedArticulation):
        return _reached(cfg, f"{uid}/{entity.root_link_name}", [0.0, 0.0, 0.0]), []
    elif uid in known and entity is None:
        return None, []  # its file could not be read, which is a mistake of its own
    names = [name for name, value in known.items() if value != "light"]
    message = f"no entity is called {uid!r}; there are: {listing(names, uid) or 'none'}"
    return None, [Problem("by", message, did_you_mean(uid, names).strip())]


def _reached(cfg: ReachedCfg, body: str, pos: list[float]) -> Reached:
    return Reached(
        body=body,
        pos=tuple(pos),
        offset=tuple(float(x) for x in cfg.offset),
        within=float(cfg.within),
        color=tuple(float(share) for share in cfg.color),
    )
