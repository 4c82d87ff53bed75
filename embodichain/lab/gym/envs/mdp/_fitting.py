"""`check_sizes`: what is certainly too small for the objects that are arranged there."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.mdp._layouts import EXACT, Frame, Item, turned
from embodichain.utils.errors import Problem
from embodichain.utils.math import quat_to_matrix

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.param_types import Box2
    from embodichain.lab.gym.envs.mdp._parts import Part
    from embodichain.lab.sim.engine.api import Engine
    from embodichain.utils.array_types import EnvIds, Floats

__all__ = ["check_sizes"]

_YAWS = 181
"""Angles at which it is tried whether an object fits at all."""


def check_sizes(engine: Engine, items: list[Item]) -> list[Problem]:
    """Return what is certainly too small: a place for an object, or for all of them together.

    Sizes are those of environment 0 when the scene is built.
    """
    problems: list[Problem] = []
    for item in items:
        if item.neighbour is None and not _fits(engine, item):
            message = f"{item.uid!r} does not fit {item.relations}: {_sizes(engine, item)}"
            key = "region" if item.region is not None else ""
            problems.append(Problem(f"objects.{item.uid}.{key}".rstrip("."), message))
    return problems or _check_pairs(engine, items) or _check_areas(engine, items)


def _fits(engine: Engine, item: Item) -> bool:
    """Whether an object fits into its region at any yaw, with nothing else there."""
    face = item.face
    if face is None or face.part is None:
        return True
    low, high = item.yaw
    yaws = np.deg2rad(np.linspace(low, high, _YAWS))
    ids: EnvIds = np.zeros(_YAWS, np.int64)
    frame = Frame.of(face.part.box_now(engine, ids), face.across, face.is_inside)
    axes = quat_to_matrix(turned(item.quat0, frame.heading + yaws))
    own = item.part.read(engine, ids).moved(np.zeros((_YAWS, 3)), axes)
    lowest, highest = frame.allowed(own, item.region)
    return bool((lowest <= highest + EXACT).all(axis=1).any())


def _sizes(engine: Engine, item: Item) -> str:
    """The sizes of an object and of what it stands on, for messages."""
    own = _footprint(engine, item.part)
    text = f"it is {_metres(own)}"
    if item.face is not None and item.face.part is not None:
        text += f", the place {_metres(_footprint(engine, item.face.part))}"
    if item.region is not None:
        text += f", the region of its middle {item.region}"
    return text


def _metres(size: Floats) -> str:
    return " x ".join(f"{edge:.3g}" for edge in size) + " m"


def _footprint(engine: Engine, part: Part) -> Floats:
    """(2,) edges in metres of the horizontal sides of a box, as it is now."""
    ids: EnvIds = np.zeros(1, np.int64)
    across = part.across(engine)
    box = part.box_now(engine, ids)
    return 2.0 * box.half[0, [across, (across + 1) % 3]]


def _check_pairs(engine: Engine, items: list[Item]) -> list[Problem]:
    """Return the objects that overlap another one wherever both are in their regions.

    Two boxes overlap if the circles within them do: if their middles are nearer than both radii.
    """
    problems: list[Problem] = []
    placed: list[Item] = []
    for item in items:
        if item.face is None or item.region is None or item.neighbour is not None:
            continue
        radius = 0.5 * float(_footprint(engine, item.part).min())
        for other in placed:
            if other.face is None or other.region is None or other.face.part != item.face.part:
                continue
            largest_distance = _largest_distance(item.region, other.region)
            if radius + 0.5 * float(_footprint(engine, other.part).min()) > largest_distance:
                message = (
                    f"the region is too small for {other.uid} and {item.uid}: they overlap "
                    f"wherever they are; {_sizes(engine, item)}"
                )
                problems.append(Problem(f"objects.{item.uid}.region", message))
                break
        placed.append(item)
    return problems


def _largest_distance(first: Box2, second: Box2) -> float:
    """The largest distance of a point in one rectangle from a point in the other."""
    upwards = np.array(first[1]) - np.array(second[0])
    downwards = np.array(second[1]) - np.array(first[0])
    return math.hypot(*np.maximum(upwards, downwards))


def _check_areas(engine: Engine, items: list[Item]) -> list[Problem]:
    """Return that objects do not fit side by side, by their areas.

    Within a region, middles are: boxes may reach beyond it by half a diagonal.
    """
    groups: dict[tuple[Part | None, str], list[Item]] = {}
    for item in items:
        if item.face is None or item.neighbour is not None:
            continue
        region = item.region
        groups.setdefault((item.face.part, ""), []).append(item)
        if region is not None:
            groups.setdefault((item.face.part, str(region)), []).append(item)

    problems: list[Problem] = []
    for (part, region_text), group in groups.items():
        sizes = [_footprint(engine, item.part) for item in group]
        needed = math.fsum(float(size[0] * size[1]) for size in sizes)
        region = group[0].region
        if region_text and region is not None:
            reach = max(math.hypot(*size) for size in sizes)
            edges = np.array(region[1]) - np.array(region[0]) + reach
        elif part is not None:
            edges = _footprint(engine, part)
        else:
            continue
        area = float(edges[0] * edges[1])
        if needed > area:
            names = ", ".join(item.uid for item in group)
            message = (
                f"the region is too small for {names}: together they cover {needed:.3g} m2 of "
                f"{area:.3g} m2"
            )
            key = "region" if region_text else ""
            path = f"objects.{group[-1].uid}.{key}".rstrip(".")
            problems.append(Problem(path, message))
    return problems
