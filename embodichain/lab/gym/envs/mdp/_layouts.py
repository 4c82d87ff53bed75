"""`Layout`: where objects are placed in n environments, and candidates for further places."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.mdp._boxes import Boxes
from embodichain.lab.gym.envs.mdp._parts import Part
from embodichain.utils.arrays import contiguous
from embodichain.utils.math import quat_multiply, quat_to_matrix

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.param_types import Box2, Range
    from embodichain.lab.sim.engine.api import Engine
    from embodichain.lab.sim.objects.rigid_object import RigidObject
    from embodichain.utils.array_types import EnvIds, Floats

__all__ = ["EXACT", "Candidates", "Face", "Frame", "Item", "Layout", "Neighbour", "turned"]

EXACT = 1e-9
"""Metres by which rounding may make a thing larger than the place that it fits exactly."""
_UP = np.array([[0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Face:
    """What things stand on: the upper face of a part, or the lower one of an inside; the ground.

    Attributes:
        part: The part; None is the ground.
        is_inside: Whether things are in it.
        across: The column of its axes from which its heading is measured.
    """

    part: Part | None
    is_inside: bool
    across: int


@dataclass(frozen=True, eq=False)
class Neighbour:
    """What an object is beside.

    Attributes:
        part: The part.
        across: The column of its axes from which its heading is measured.
        by: Metres between the two, [low, high].
        direction: Degrees from that heading, [low, high].
    """

    part: Part
    across: int
    by: Range
    direction: Range


@dataclass(frozen=True, eq=False)
class Item:
    """An object and where it is placed.

    Attributes:
        uid: The object.
        relations: Those that hold there, in words.
        asset: Its handle.
        part: The box around it.
        region: [[x, y] low, [x, y] high] of its middle on the face, or None.
        yaw: Degrees by which it is turned, [low, high].
        quat0: (4,) its initial orientation.
        gap: Metres to everything else, sideways.
        face: What it stands on; None if that is not known.
        neighbour: What it is beside, or None.
        ceiling: The geoms of what it is in that are above the inside.
        not_compared: Entities that it may touch.
    """

    uid: str
    relations: str
    asset: RigidObject
    part: Part
    region: Box2 | None
    yaw: Range
    quat0: Floats
    gap: float
    face: Face | None
    neighbour: Neighbour | None
    ceiling: tuple[Part, ...]
    not_compared: frozenset[str]

    @property
    def region_text(self) -> str:
        """Its region, for messages."""
        region = self.region
        return "it may be anywhere there" if region is None else f"its region is {region}"


@dataclass(frozen=True, eq=False)
class Candidates:
    """Places that are tried, one in each of n rows.

    Attributes:
        place: (n, 4) x, y, z in m, and yaw in rad from the initial orientation.
        body_axes: (n, 3, 3) rotation matrix of the object there.
        box: Its box there, (n,).
        is_possible: (n,) whether the relation holds.
    """

    place: Floats
    body_axes: Floats
    box: Boxes
    is_possible: NDArray[np.bool_]

    def rows(self, rows: NDArray[np.int64]) -> Candidates:
        """Return those of some rows."""
        return Candidates(
            place=self.place[rows],
            body_axes=self.body_axes[rows],
            box=self.box.rows(rows),
            is_possible=self.is_possible[rows],
        )


class Layout:
    """Where the objects are in n environments, as far as they are placed.

    Args:
        engine: The engine.
        ids: (n,) the environments.
        items: The objects.
        obstacles: Everything else that is solid.

    Attributes:
        places: (n, 4) of each object, see `Candidates`.
        last_item: (n,) the number of the object that was placed last, or has no place.
    """

    def __init__(
        self, engine: Engine, ids: EnvIds, items: Iterable[Item], obstacles: Iterable[Part]
    ) -> None:
        self.ids = ids
        self.places: dict[str, Floats] = {}
        self.last_item: NDArray[np.int64] = np.zeros(len(ids), np.int64)
        self._engine = engine
        self._local: dict[Part, Boxes] = {}
        self._axes: dict[str, Floats] = {}
        self._boxes: dict[str, Boxes] = {}
        self._items = list(items)
        self._is_placed: dict[str, NDArray[np.bool_]] = {}
        count = len(ids)
        for item in self._items:
            self.places[item.uid] = np.zeros((count, 4))
            self._axes[item.uid] = np.zeros((count, 3, 3))
            self._boxes[item.uid] = Boxes(
                middle=np.zeros((count, 3)),
                axes=np.zeros((count, 3, 3)),
                half=np.zeros((count, 3)),
            )
        parts = list(obstacles)
        self._owners = np.array([part.uid for part in parts])
        self._obstacles = self._read_obstacles(parts)

    def _read_obstacles(self, parts: list[Part]) -> Boxes | None:
        """Boxes (n, K) of everything that is not placed."""
        if not parts:
            return None
        boxes = [self._world(part, np.arange(len(self.ids))) for part in parts]
        return Boxes(
            middle=np.stack([box.middle for box in boxes], axis=1),
            axes=np.stack([box.axes for box in boxes], axis=1),
            half=np.stack([box.half for box in boxes], axis=1),
        )

    def _local_box(self, part: Part, rows: NDArray[np.int64]) -> Boxes:
        """The box of a part in the frame of its body."""
        if part not in self._local:
            self._local[part] = part.read(self._engine, self.ids)
        return self._local[part].rows(rows)

    def _pose(self, part: Part, rows: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Position and rotation matrix of the body of a part: placed, or as it is."""
        if part.uid in self.places:
            return self.places[part.uid][rows, :3], self._axes[part.uid][rows]
        return part.pose(self._engine, self.ids[rows])

    def _world(self, part: Part, rows: NDArray[np.int64]) -> Boxes:
        """The box of a part where it is."""
        pos, axes = self._pose(part, rows)
        box = self._local_box(part, rows)
        return box.moved(pos, axes)

    def candidates(self, item: Item, numbers: Floats, rows: NDArray[np.int64]) -> Candidates:
        """Return places where an object's relations hold, made of numbers (n, 3) in [0, 1)."""
        count = len(rows)
        first, second, third = (contiguous(numbers[:, i]) for i in range(3))
        frame = self._frame(item, rows)
        heading = frame.heading
        if item.neighbour is not None:
            heading = _heading(self._world(item.neighbour.part, rows), item.neighbour.across)
        yaw = heading + np.deg2rad(_between(item.yaw, first))
        axes = quat_to_matrix(turned(item.quat0, yaw))
        own = self._local_box(item.part, rows).moved(np.zeros((count, 3)), axes)

        low, high = frame.allowed(own, item.region)
        if item.neighbour is None:
            share = np.stack([second, third], axis=1)
            middle = frame.point(low + share * (high - low))
            is_within = low <= high + EXACT
            is_possible = is_within[:, 0] & is_within[:, 1]
        else:
            middle = self._beside(item.neighbour, own, second, third, rows)
            along = frame.coordinates(middle)
            is_within = (along >= low - EXACT) & (along <= high + EXACT)
            is_possible = is_within[:, 0] & is_within[:, 1]
        middle[:, 2] = frame.height + own.reach(_UP)
        pos = middle - own.middle
        place = np.concatenate([pos, yaw[:, None]], axis=1)
        box = Boxes(middle, own.axes, own.half)
        return Candidates(place, body_axes=axes, box=box, is_possible=is_possible)

    def _frame(self, item: Item, rows: NDArray[np.int64]) -> Frame:
        """What an object stands on; without an end where only its neighbour is known."""
        frame = Frame.unlimited(len(rows))
        face = item.face
        if face is not None and face.part is not None:
            return Frame.of(self._world(face.part, rows), face.across, face.is_inside)
        if face is None and item.neighbour is not None:
            box = self._world(item.neighbour.part, rows)
            frame.height = box.middle[:, 2] - box.reach(_UP)
        return frame

    def _beside(
        self,
        neighbour: Neighbour,
        own: Boxes,
        first: Floats,
        second: Floats,
        rows: NDArray[np.int64],
    ) -> Floats:
        """Return middles (n, 3) of an object's box beside its neighbour."""
        box = self._world(neighbour.part, rows)
        angle = _heading(box, neighbour.across)
        angle = angle + np.deg2rad(_between(neighbour.direction, first))
        flat = [np.cos(angle), np.sin(angle), np.zeros(len(rows))]
        direction = np.stack(flat, axis=1)
        # The direction separates the two boxes.
        distance = box.reach(direction) + own.reach(direction) + _between(neighbour.by, second)
        return box.middle + direction * distance[:, None]

    def overlaps(self, item: Item, box: Boxes, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(n,) whether an object's box overlaps anything that it must not touch."""
        wide = box.widened(item.gap)
        is_hit = np.zeros(len(rows), np.bool_)
        if self._obstacles is not None:
            counts = ~np.isin(self._owners, list(item.not_compared))
            others = self._obstacles.rows(rows).rows((slice(None), counts))
            is_hit |= wide.overlap(others).any(axis=1)
        for other in self._items:
            if other is item:
                break
            if other.uid not in item.not_compared:
                gap = max(item.gap, other.gap)
                others = self._boxes[other.uid].rows(rows).rows((slice(None), None))
                is_hit |= box.widened(gap).overlap(others)[:, 0]
        for part in item.ceiling:
            others = self._world(part, rows).rows((slice(None), None))
            is_hit |= box.overlap(others)[:, 0]
        return is_hit

    def accept(self, item: Item, candidates: Candidates, rows: NDArray[np.int64]) -> None:
        """Place an object where it is in candidates (n,), in n rows."""
        box = self._boxes[item.uid]
        self.places[item.uid][rows] = candidates.place
        self._axes[item.uid][rows] = candidates.body_axes
        box.middle[rows] = candidates.box.middle
        box.axes[rows] = candidates.box.axes
        box.half[rows] = candidates.box.half


@dataclass(eq=False)
class Frame:
    """A horizontal rectangle in n environments that things stand on.

    Attributes:
        middle: (n, 3) metres.
        heading: (n,) rad about the vertical.
        half: (n, 2) half edges, metres; infinite without an end.
        height: (n,) metres.
    """

    middle: Floats
    heading: Floats
    half: Floats
    height: Floats

    @staticmethod
    def unlimited(count: int) -> Frame:
        """The ground."""
        return Frame(
            middle=np.zeros((count, 3)),
            heading=np.zeros(count),
            half=np.full((count, 2), np.inf),
            height=np.zeros(count),
        )

    @staticmethod
    def of(box: Boxes, across: int, is_inside: bool) -> Frame:
        """The upper face of a box, or the lower one of an inside."""
        frame = Frame.unlimited(len(box.middle))
        frame.middle = box.middle
        frame.heading = _heading(box, across)
        x, y = frame.directions()
        frame.half = np.stack([box.reach(x), box.reach(y)], axis=1)
        upwards = box.reach(_UP)
        frame.height = box.middle[:, 2] + (-upwards if is_inside else upwards)
        return frame

    def directions(self) -> tuple[Floats, Floats]:
        """Unit vectors along its edges, (n, 3) each."""
        cosine = np.cos(self.heading)
        sine = np.sin(self.heading)
        zero = np.zeros(len(cosine))
        return np.stack([cosine, sine, zero], axis=1), np.stack([-sine, cosine, zero], axis=1)

    def allowed(self, box: Boxes, region: Box2 | None) -> tuple[Floats, Floats]:
        """Lowest and highest coordinates (n, 2) of the middle of a box that is wholly on it."""
        x, y = self.directions()
        room = self.half - np.stack([box.reach(x), box.reach(y)], axis=1)
        if region is None:
            return -room, room
        return np.maximum(np.array(region[0]), -room), np.minimum(np.array(region[1]), room)

    def point(self, along: Floats) -> Floats:
        """Points (n, 3) at coordinates (n, 2)."""
        x, y = self.directions()
        return self.middle + x * along[:, :1] + y * along[:, 1:]

    def coordinates(self, points: Floats) -> Floats:
        """Coordinates (n, 2) of points (n, 3)."""
        offset = points - self.middle
        columns = [offset[:, 0] * e[:, 0] + offset[:, 1] * e[:, 1] for e in self.directions()]
        return np.stack(columns, axis=1)


def _heading(box: Boxes, across: int) -> Floats:
    """(n,) rad about the vertical of an edge of boxes."""
    edge = box.axes[..., across]
    return np.arctan2(contiguous(edge[:, 1]), contiguous(edge[:, 0]))


def _between(bounds: Range, share: Floats) -> Floats:
    """Numbers of a range for shares in [0, 1)."""
    low, high = bounds
    return low + share * (high - low)


def turned(quat0: Floats, yaw: Floats) -> Floats:
    """(n, 4) an orientation (4,) turned about the vertical by angles (n,) in rad."""
    zero = np.zeros(len(yaw))
    turn = np.stack([np.cos(0.5 * yaw), zero, zero, np.sin(0.5 * yaw)], axis=1)
    return quat_multiply(turn, np.tile(quat0, (len(yaw), 1)))
