"""The event `arrange_objects`: objects on, in and beside other things, without overlaps.

Places are drawn and rejected, in all environments at once. The k-th try of an environment depends
on its own random stream alone, so that its result does not depend on the other environments.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from embodichain.lab.gym.envs.managers.param_types import Box2, NonNegative, Range
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.gym.envs.mdp._boxes import has_solid, solid_geoms
from embodichain.lab.gym.envs.mdp._fitting import check_sizes
from embodichain.lab.gym.envs.mdp._layouts import Face, Item, Layout, Neighbour, turned
from embodichain.lab.gym.envs.mdp._parts import Part, find_part, part_of_body
from embodichain.lab.sim.compiler.names import GROUND, no_such
from embodichain.utils.arrays import contiguous
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.cfg import EnvCfg
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import Engine, EnvIndex
    from embodichain.lab.sim.sim_manager import SimulationManager
    from embodichain.utils.array_types import EnvIds, Floats

__all__ = ["ArrangeObjects", "Beside", "Placement"]

_GROUND = ("ground", GROUND)
"""Names of the ground."""
_UP = np.array([[0.0, 0.0, 1.0]])
_PLAY = 1e-3
"""Metres by which what is above an inside may reach into it."""
_AT_ONCE = 16
"""Largest number of places that are tried at once in an environment; more would need memory."""
_LAYOUTS = 8
"""How often an environment begins anew with its first object before the event fails."""


def _pair(value: Any) -> Any:
    """One number as the range of that number.

    Raises:
        ValueError: If it is text or a flag.
    """
    if isinstance(value, (str, bool)):
        raise ValueError("expected a number or [low, high]")
    return [value, value] if isinstance(value, (int, float)) else value


def _as_beside(value: Any) -> Any:
    """A name alone as the thing that an object is beside."""
    return {"of": value} if isinstance(value, str) else value


NumberOrRange = Annotated[Range, BeforeValidator(_pair)]
"""A number, or [low, high]."""


@dataclass
class Beside:
    """Beside something.

    Attributes:
        of: The entity, or ``ENTITY/NAME`` of a site, link or geom.
        by: Metres between the two, or [low, high].
        direction: Where it is as seen from `of`: degrees about the vertical, from the x axis of
            `of`, or [low, high].
    """

    __pydantic_config__ = {"extra": "forbid"}

    of: str
    by: NumberOrRange = (0.01, 0.01)
    direction: NumberOrRange = (-180.0, 180.0)


@dataclass
class Placement:
    """Where an object is placed: `on` or `in` something, and `beside` something; one is enough.

    Attributes:
        on: What it stands on: an entity, ``ENTITY/NAME`` of a site, link or geom, or ``ground``.
        in_: What it is in: an entity with a site ``inside``, or ``ENTITY/SITE``.
        beside: What it is beside. Alone: at the height of that and on what that was placed on.
        region: [[x, y] low, [x, y] high] of the middle of its box, metres from the middle of what
            it is on or in, along the axes of that; None is all of it.
        yaw: Degrees about the vertical by which it is turned from its initial orientation, besides
            the heading of what it is on, in or beside; or [low, high].
        gap: Metres to everything else; None is that of the event.
    """

    __pydantic_config__ = {"extra": "forbid"}

    on: str | None = None
    in_: Annotated[str | None, Field(alias="in")] = None
    beside: Annotated[Beside | None, BeforeValidator(_as_beside)] = None
    region: Box2 | None = None
    yaw: NumberOrRange = (-180.0, 180.0)
    gap: NonNegative | None = None

    @property
    def carrier(self) -> str:
        """What it is on or in; empty if that is not given."""
        return self.on or self.in_ or ""

    @property
    def needs(self) -> set[str]:
        """The entities that it is on, in or beside."""
        names = [self.carrier]
        if self.beside is not None:
            names.append(self.beside.of)
        return {name.partition("/")[0] for name in names if name}

    def __str__(self) -> str:
        """The relations as people say them: ``on 'table', beside 'plate'``."""
        said = {"on": self.on, "in": self.in_, "beside": self.beside and self.beside.of}
        return ", ".join(f"{relation} {name!r}" for relation, name in said.items() if name)


@register_term("event", name="arrange_objects")
class ArrangeObjects(Term):
    """Places objects on, in and beside things at random, without overlaps, with velocity 0.

    What an object is on, in or beside may be another of these objects, which is then placed first.
    A place is tried until the box around the object's collision geoms is at least `gap` away from
    all other boxes: those of objects, of the links of robots and articulations as they are then,
    and of what was placed before. Its whole footprint is on what carries it, with which it is not
    compared, nor with what carries that, but for what is above an inside. Where `max_tries` places
    do not suffice, that environment begins anew with its first object, 8 times at most; then the
    event fails and names the object. The log has x, y, z (m) and yaw (rad) of each object.

    Args:
        objects: Rigid object -> its relation: ``{on: table}``, ``{in: box}`` (the site ``inside``
            of the box), ``{beside: {of: plate, by: 0.1}}``; with ``region`` in metres, ``yaw`` in
            **degrees**, and ``gap``.
        gap: Metres between objects, sideways.
        max_tries: Places to try for an object.

    Example:
        ``{func: arrange_objects, mode: reset, params: {objects: {cube: {beside: {of: goal, by: [0.1, 0.3]}, yaw: [-45, 45]}}}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        objects: Annotated[dict[str, Placement], Field(min_length=1)],
        gap: NonNegative = 0.005,
        max_tries: Annotated[int, Field(ge=1)] = 100,
    ) -> None:
        env.arrays.require_host("searches for free places")
        self._engine = env.sim.engine
        self._tries = max_tries
        problems = [*_check_relations(objects), *_check_scene(env.sim, objects)]
        self._items: list[Item] = []
        for uid in _in_order(objects):
            if uid in env.sim.rigid_objects:
                try:
                    self._items.append(_item(env.sim, uid, objects[uid], gap, self._items))
                except ConfigError as error:
                    problems += error.problems
        problems = problems or check_sizes(self._engine, self._items)
        if problems:
            raise ConfigError(problems)
        self._obstacles = _obstacles(env.sim, objects)

    @classmethod
    def check_task(
        cls, task: EnvCfg, params: Mapping[str, Any], allow_import: bool
    ) -> list[Problem]:
        """Return the mistakes that relations have whatever the scene is."""
        return _check_relations(params["objects"])

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Find places for the objects of these environments, and write their poses."""
        manager = env.event_manager
        places: dict[str, Floats] = {}
        for item in self._items:
            place = manager.preset_draw(item.uid, (4,), env_ids)
            if place is not None:
                places[item.uid] = place
        if len(places) < len(self._items):
            ids = np.arange(env.num_envs) if env_ids is None else np.asarray(env_ids)
            places = self._search(env, ids)
        for item in self._items:
            place = places[item.uid]
            manager.log_draw(item.uid, place)
            quat = turned(item.quat0, contiguous(place[:, 3]))
            item.asset.write_pose(place[:, :3], quat, env_ids)
            if not item.asset.is_non_dynamic:
                item.asset.stop(env_ids)

    def _search(self, env: TermContext, ids: EnvIds) -> dict[str, Floats]:
        """Return x, y, z in m and yaw in rad of each object, (n, 4).

        Raises:
            ConfigError: If an environment has no place for an object.
        """
        layout = Layout(self._engine, ids, self._items, self._obstacles)
        unsolved: NDArray[np.int64] = np.arange(len(ids))
        for _ in range(_LAYOUTS):
            rows = unsolved
            for item in self._items:
                rows = self._place(env, layout, item, rows)
            unsolved = np.setdiff1d(unsolved, rows)
            if not len(unsolved):
                return layout.places
        raise ConfigError([self._no_place(layout, ids, unsolved)])

    def _place(
        self, env: TermContext, layout: Layout, item: Item, rows: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Place an object in these rows of a layout; return those where it has a place."""
        layout.last_item[rows] = self._items.index(item)
        waiting = rows
        tried = 0
        count = 1
        while len(waiting) and tried < self._tries:
            # Twice as many tries each time: few calls, and an environment's tries are its own.
            count = min(count, self._tries - tried)
            numbers = env.event_manager.try_draw((count, 3), layout.ids[waiting])
            tried_rows = np.repeat(waiting, count)
            candidates = layout.candidates(item, numbers.reshape(-1, 3), tried_rows)
            is_free = candidates.is_possible & ~layout.overlaps(item, candidates.box, tried_rows)
            is_free = is_free.reshape(-1, count)
            first = is_free.argmax(axis=1)
            every_row = np.arange(len(waiting))
            has_place = is_free[every_row, first]
            accepted = (every_row * count + first)[has_place]
            layout.accept(item, candidates.rows(accepted), waiting[has_place])
            waiting = waiting[~has_place]
            tried += count
            count = min(2 * count, _AT_ONCE)
        return np.setdiff1d(rows, waiting)

    def _no_place(self, layout: Layout, ids: EnvIds, rows: NDArray[np.int64]) -> Problem:
        """Return that an object has no place in the first of these rows of a layout."""
        item = self._items[int(layout.last_item[rows[0]])]
        message = (
            f"no free place for {item.uid!r} {item.relations} in environment {ids[rows[0]]}: "
            f"{_LAYOUTS} layouts with {self._tries} tries each; {item.region_text}"
        )
        advice = "A larger region, a smaller gap, or fewer objects."
        return Problem(f"objects.{item.uid}", message, advice)


# ---------------------------------------------------------------------------- what is placed where


def _check_relations(objects: Mapping[str, Placement]) -> list[Problem]:
    """Return the mistakes that relations have whatever the scene is."""
    problems: list[Problem] = []
    for uid, placement in objects.items():
        path = f"objects.{uid}"
        if placement.on is not None and placement.in_ is not None:
            problems.append(Problem(path, "gives both on and in: an object has one of them"))
        if not placement.needs:
            problems.append(Problem(path, "needs a relation: on, in or beside"))
        if placement.region is not None and not placement.carrier:
            message = "is measured on or in something: give on or in, too"
            problems.append(Problem(f"{path}.region", message))
        if placement.on in _GROUND and placement.region is None:
            problems.append(Problem(f"{path}.region", "missing; the ground has no end"))
        if placement.beside is not None and placement.beside.by[0] < 0:
            message = f"must not be negative, got {placement.beside.by[0]:g}"
            problems.append(Problem(f"{path}.beside.by", message))
    return problems + _check_circles(objects)


def _check_scene(sim: SimulationManager, objects: Mapping[str, Placement]) -> list[Problem]:
    """Return the names of objects that do not exist, and relations to ground that is not flat."""
    problems: list[Problem] = []
    for uid, placement in objects.items():
        path = f"objects.{uid}"
        if uid not in sim.rigid_objects:
            problems.append(no_such("object", uid, list(sim.rigid_objects), path))
        if placement.on not in _GROUND:
            continue
        if not sim.sim_config.has_ground:
            problems.append(Problem(f"{path}.on", "the scene has no ground"))
        elif sim.scene.terrain is not None:
            message = "the ground is a terrain: randomize_pose places objects there"
            problems.append(Problem(f"{path}.on", message))
    return problems


def _check_circles(objects: Mapping[str, Placement]) -> list[Problem]:
    """Return a problem for each circle of relations."""
    problems: list[Problem] = []
    reported: set[str] = set()
    for uid in objects:
        way = _way_back(uid, objects)
        if way and reported.isdisjoint(way):
            reported.update(way)
            circle = " -> ".join([*way, uid])
            message = f"is placed by itself: {circle}; something has to come first"
            problems.append(Problem(f"objects.{uid}", message))
    return problems


def _way_back(uid: str, objects: Mapping[str, Placement]) -> list[str]:
    """Return the objects on the way from an object by its relations back to it, or none."""
    ways = [[uid]]
    visited: set[str] = set()
    while ways:
        way = ways.pop()
        for name in sorted(objects[way[-1]].needs):
            if name == uid:
                return way
            if name in objects and name not in visited:
                visited.add(name)
                ways.append([*way, name])
    return []


def _in_order(objects: Mapping[str, Placement]) -> list[str]:
    """Return the objects as declared, but each after those that it needs; no circles."""
    ordered: list[str] = []
    for _ in objects:
        for uid, placement in objects.items():
            needed = [name for name in placement.needs if name in objects]
            if uid not in ordered and all(name in ordered for name in needed):
                ordered.append(uid)
                break
    return ordered


def _item(
    sim: SimulationManager, uid: str, placement: Placement, gap: float, earlier: Iterable[Item]
) -> Item:
    """Find what an object's relations name.

    Raises:
        ConfigError: If something does not exist, or has no extent.
    """
    path = f"objects.{uid}"
    asset = sim.rigid_objects[uid]
    part = part_of_body(sim.engine, uid, int(asset.entity.root_body_id))
    if not part.ids:
        raise ConfigError([Problem(path, f"{uid!r} has no end: it cannot be placed")])

    neighbour: Neighbour | None = None
    face: Face | None = None
    not_compared: frozenset[str] = frozenset()
    ceiling: tuple[Part, ...] = ()
    if placement.beside is not None:
        beside = placement.beside
        beside_part = find_part(sim, beside.of, f"{path}.beside.of", "beside")
        across = beside_part.across(sim.engine)
        neighbour = Neighbour(beside_part, across, beside.by, beside.direction)
        for item in earlier:
            if item.uid == beside_part.uid:
                face = item.face
                not_compared = item.not_compared
                ceiling = item.ceiling
    if placement.on in _GROUND:
        face = Face(None, is_inside=False, across=0)
        not_compared = frozenset()
        ceiling = ()
    elif placement.carrier:
        relation: Literal["on", "in"] = "on" if placement.on is not None else "in"
        carrier = find_part(sim, placement.carrier, f"{path}.{relation}", relation)
        face = Face(carrier, relation == "in", carrier.across(sim.engine))
        not_compared = frozenset([carrier.uid])
        ceiling = _ceiling(sim.engine, carrier) if relation == "in" else ()
        for item in earlier:
            # What is in a bowl that is in a bin is within the bin's walls, too.
            if item.uid == carrier.uid:
                not_compared |= item.not_compared
                ceiling += item.ceiling

    return Item(
        uid=uid,
        relations=str(placement),
        asset=asset,
        part=part,
        region=placement.region,
        yaw=placement.yaw,
        quat0=np.asarray(asset.entity.quat0, np.float64),
        gap=gap if placement.gap is None else placement.gap,
        face=face,
        neighbour=neighbour,
        ceiling=ceiling,
        not_compared=not_compared,
    )


def _ceiling(engine: Engine, inside: Part) -> tuple[Part, ...]:
    """The geoms of a container that are above its inside now, such as a shelf's upper board."""
    ids: EnvIds = np.zeros(1, np.int64)
    space = inside.box_now(engine, ids)
    top = space.middle[0, 2] + space.reach(_UP)[0]
    parts: list[Part] = []
    for geom in solid_geoms(engine, inside.body).tolist():
        part = Part(inside.uid, inside.body, "geom", (geom,))
        box = part.box_now(engine, ids)
        bottom = box.middle[0, 2] - box.reach(_UP)[0]
        if bottom > top - _PLAY:
            parts.append(part)
    return tuple(parts)


def _obstacles(sim: SimulationManager, objects: Collection[str]) -> list[Part]:
    """Return the boxes of everything solid but these objects, one a body."""
    parts: list[Part] = []
    handles = {**sim.robots, **sim.articulations, **sim.rigid_objects}
    for uid, handle in handles.items():
        if uid not in objects:
            bodies = [int(body) for body in handle.entity.body_ids]
            parts += [
                part_of_body(sim.engine, uid, body)
                for body in bodies
                if has_solid(sim.engine, body)
            ]
    return parts
