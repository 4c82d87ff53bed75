"""Marks for pictures: a halo, and another colour while something is near or a joint is past."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import mujoco

from embodichain.lab.sim.cfg import ArticulationCfg, HaloCfg, ReachedCfg, RigidObjectCfg
from embodichain.lab.sim.compiler.names import Known, KnownObject
from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
from embodichain.lab.sim.compiler.scene.known import find_place
from embodichain.lab.sim.drawing.marks import (
    MARK_PREFIX,
    Halo,
    JointPast,
    Mark,
    Near,
    Reached,
)
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["MarkedEntity", "add_marks", "check_marks"]

MarkedEntity = RigidObjectCfg | ArticulationCfg
_ORANGE = (0.95, 0.45, 0.1)
"""Of a halo that has no colour around a thing without one."""
_ORIGIN = (0.0, 0.0, 0.0)


def check_marks(
    entities: Mapping[str, MarkedEntity], known: Known, *, is_open: bool
) -> dict[str, list[Problem]]:
    """Return the mistakes in the marks of entities by uid, with paths below the entity.

    Args:
        entities: Objects and articulations by uid.
        known: The declared entities.
        is_open: Whether there may be more: then an unknown one is not a mistake.
    """
    problems: dict[str, list[Problem]] = {}
    for uid, cfg in entities.items():
        mistakes: list[Problem] = []
        for declared in _declared(uid, cfg):
            _, found = _find_mark(declared, known, is_open=is_open)
            mistakes += [problem.below(declared.path) for problem in found]
        if mistakes:
            problems[uid] = mistakes
    return problems


def add_marks(spec: mujoco.MjSpec, entities: Mapping[str, MarkedEntity], known: Known) -> None:
    """Add the texts by which pictures find marks.

    Args:
        spec: The scene.
        entities: Objects and articulations by uid.
        known: The entities.

    Raises:
        ConfigError: If there is nothing that something is to be reached by.
    """
    for uid, cfg in entities.items():
        for declared in _declared(uid, cfg):
            mark, problems = _find_mark(declared, known, is_open=False)
            if mark is None:
                path = f"{uid}.{declared.path}" if declared.path else uid
                raise ConfigError(problem.below(path) for problem in problems)
            spec.add_text(name=f"{MARK_PREFIX}{declared.name}", data=mark.as_text())


@dataclass(frozen=True)
class _DeclaredMark:
    """A mark as a config has it.

    Attributes:
        name: What is marked: an object's uid, or ``UID/NAME`` of a frame.
        path: The keys of the mark below the entity; empty of an object.
        color: RGB of the thing, for a halo without a colour.
        halo: Its halo.
        reached: When it has another colour.
    """

    name: str
    path: str
    color: tuple[float, ...]
    halo: HaloCfg | None
    reached: ReachedCfg | None


def _declared(uid: str, cfg: MarkedEntity) -> Iterator[_DeclaredMark]:
    """Yield the marks of an entity."""
    if isinstance(cfg, RigidObjectCfg):
        if cfg.halo is not None or cfg.reached is not None:
            yield _DeclaredMark(uid, "", _color_of(cfg), cfg.halo, cfg.reached)
        return
    for name, mark in cfg.marks.items():
        yield _DeclaredMark(f"{uid}/{name}", f"marks.{name}", _ORANGE, mark.halo, mark.reached)


def _color_of(cfg: RigidObjectCfg) -> tuple[float, ...]:
    """RGB of an object."""
    material = cfg.shape.visual_material
    if material is None:
        return _ORANGE
    return tuple(float(share) for share in material.base_color[:3])


def _find_mark(
    declared: _DeclaredMark, known: Known, *, is_open: bool
) -> tuple[Mark | None, list[Problem]]:
    """The mark with the bodies that it is about; None with the mistakes, if there are any."""
    body, pos, problems = _find_marked(declared.name, known)
    reached: Reached | None = None
    if declared.reached is not None:
        reached, mistakes = _find_reached(declared.reached, known, is_open=is_open)
        problems += [mistake.below("reached") for mistake in mistakes]
    if problems or body is None:
        return None, problems
    halo: Halo | None = None
    if declared.halo is not None:
        color = declared.halo.color or declared.color
        halo = Halo(
            pos=pos,
            radius=float(declared.halo.radius),
            color=tuple(float(share) for share in color),
        )
    return Mark(body=body, halo=halo, reached=reached), []


def _find_marked(name: str, known: Known) -> tuple[str | None, tuple[float, ...], list[Problem]]:
    """The body that is marked, and the middle of its halo, (3,) m in its frame."""
    uid, slash, _ = name.partition("/")
    entity = known.get(uid)
    if not slash:
        body = entity.body if isinstance(entity, KnownObject) else uid
        return body, _ORIGIN, []
    place, problems = find_place(name, known)
    if place is None:
        return None, _ORIGIN, [Problem("", p.message, p.hint) for p in problems]
    return place.body, tuple(place.pos.tolist()), []


def _find_reached(
    cfg: ReachedCfg, known: Known, *, is_open: bool
) -> tuple[Reached | None, list[Problem]]:
    """The condition of a mark; the mistakes are what is missing, or is not in the scene."""
    color = tuple(float(share) for share in cfg.color)
    if (cfg.by is None) == (cfg.joint is None):
        both = "" if cfg.by is None else ", got both"
        return None, [Problem("", f"needs one of by and joint{both}")]
    if cfg.by is not None:
        mistakes = [
            Problem(key, "belongs to joint: leave it out, or give a joint")
            for key in ("above", "below")
            if getattr(cfg, key) is not None
        ]
        if cfg.within is None:
            mistakes.append(Problem("within", "missing value: by needs the largest distance, m"))
        near, unknown = _find_near(cfg, known, is_open=is_open)
        mistakes += unknown
        return (Reached(color=color, near=near) if near else None), mistakes
    joint, mistakes = _find_joint(cfg, known, is_open=is_open)
    return (Reached(color=color, joint=joint) if joint else None), mistakes


def _find_near(
    cfg: ReachedCfg, known: Known, *, is_open: bool
) -> tuple[Near | None, list[Problem]]:
    """Find what something is reached by; the problem is that there is no such thing."""
    name = cfg.by or ""
    uid, slash, _ = name.partition("/")
    if uid not in known:
        return None, [] if is_open else [_unknown_entity("by", uid, known)]
    entity = known[uid]
    if entity == "light":
        return None, [_unknown_entity("by", uid, known)]
    if slash:
        # Without a place and a problem, the entity's own config or file is wrong.
        place, problems = find_place(name, known)
        if place is None:
            return None, [Problem("by", problem.message, problem.hint) for problem in problems]
        return _near(cfg, place.body, tuple(place.pos.tolist())), []
    if isinstance(entity, KnownObject):
        return _near(cfg, entity.body, _ORIGIN), []
    if isinstance(entity, ParsedArticulation):
        return _near(cfg, f"{uid}/{entity.root_link_name}", _ORIGIN), []
    return None, []  # its file could not be read


def _near(cfg: ReachedCfg, body: str, pos: tuple[float, ...]) -> Near:
    return Near(
        body=body,
        pos=pos,
        offset=tuple(float(x) for x in cfg.offset),
        within=float(cfg.within or 0.0),
    )


def _find_joint(
    cfg: ReachedCfg, known: Known, *, is_open: bool
) -> tuple[JointPast | None, list[Problem]]:
    """Find the joint that has to be past a position; the problem is that there is no such joint."""
    mistakes: list[Problem] = []
    if cfg.within is not None:
        mistakes.append(Problem("within", "belongs to by: a joint needs above or below"))
    if cfg.above is None and cfg.below is None:
        mistakes.append(Problem("joint", "needs above or below, a position in rad or m"))
    uid, _, name = (cfg.joint or "").partition("/")
    entity = known.get(uid)
    if uid in known and entity is None or is_open and uid not in known:
        return None, mistakes
    if not isinstance(entity, ParsedArticulation):
        return None, [*mistakes, _unknown_entity("joint", uid, known)]
    if name not in entity.joint_names:
        names = [*entity.joint_names]
        message = f"{uid!r} has no joint {name!r}; there are: {listing(names, name) or 'none'}"
        return None, [*mistakes, Problem("joint", message, did_you_mean(name, names).strip())]
    return JointPast(joint=f"{uid}/{name}", above=cfg.above, below=cfg.below), mistakes


def _unknown_entity(key: str, uid: str, known: Known) -> Problem:
    names = [name for name, value in known.items() if value != "light"]
    message = f"no entity is called {uid!r}; there are: {listing(names, uid) or 'none'}"
    return Problem(key, message, did_you_mean(uid, names).strip())
