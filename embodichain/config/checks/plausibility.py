"""`implausible_values`: values that are allowed, but look as if they were in another unit.

Lengths are in metres and times in seconds: an object of 20 m, or a place at 110 m, is mostly one in
millimetres, centimetres or degrees. Positions of joints are in rad, and Euler angles in degrees.
That is a warning: there may be such a scene.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from embodichain.lab.sim.cfg import HaloCfg, RigidObjectCfg
from embodichain.lab.sim.configs.scene_cfg import ObjectBaseCfg
from embodichain.lab.sim.shapes import CapsuleCfg, CubeCfg, CylinderCfg, SphereCfg
from embodichain.utils.errors import Problem
from embodichain.utils.fields.no_effect import config_nodes

__all__ = ["implausible_values"]

_LONGEST_TIME_STEP = 0.05
_LARGEST = 10.0
_SMALLEST = 1e-4
_FARTHEST = 20.0
_LENGTHS: tuple[tuple[type, tuple[str, ...]], ...] = (
    (CubeCfg, ("size",)),
    (SphereCfg, ("radius",)),
    (CylinderCfg, ("radius", "height")),
    (CapsuleCfg, ("radius", "height")),
    (HaloCfg, ("radius",)),
)
_TURN = 2 * math.pi
_STEP_OF_ANGLES = math.pi / 12
_ANGLE_TOLERANCE = 0.005
"""What 3.14 and 1.57 lack of pi and of half of it, and a bit."""
_JOINT_TERMS = (
    ("actions", ("joint_action", "joint_position"), "scale"),
    ("events", ("reset_joints",), "position_range"),
)
"""Section, terms, and their parameter with positions of joints or differences of them."""
_PLACES_OF_TERMS = ("position_range", "pose_range", "position", "pos", "offset")
"""Parameters of events and commands with places, whatever the term."""


def implausible_values(root: Any, tree: Mapping[str, Any]) -> list[Problem]:
    """Return a note for each value that is probably in another unit than the one it is read in.

    Args:
        root: A config as data classes.
        tree: The plain values it was read from; values that are not given are not looked at.
    """
    notes = list(_time_step(root))
    # What cannot move may be as large as a building.
    static_paths: list[str] = []
    for path, cfg, given in config_nodes(root, tree):
        if isinstance(cfg, RigidObjectCfg) and cfg.body_type == "static":
            static_paths.append(f"{path}.")
        is_static = path.startswith(tuple(static_paths))
        notes += [note.below(path) for note in _lengths(cfg, given, is_static=is_static)]
        if isinstance(cfg, ObjectBaseCfg):
            notes += [note.below(path) for note in _place("init_pos", given.get("init_pos"))]
            notes += [note.below(path) for note in _euler_angles("init_rot", given.get("init_rot"))]
    notes += _places_of_terms(tree.get("task"))
    notes += _joint_positions_of_terms(tree.get("task"))
    return notes


def _time_step(root: Any) -> Iterator[Problem]:
    physics = root.task.physics
    time_step = None if physics is None else physics.physics_dt
    if time_step is not None and time_step > _LONGEST_TIME_STEP:
        fact = f"{time_step:g} s is a long physics step: most scenes are unstable above"
        advice = f"{_LONGEST_TIME_STEP:g} s, usual are 0.001 to 0.01 s"
        yield Problem("task.physics.physics_dt", f"{fact} {advice}")


def _lengths(cfg: Any, given: Mapping[str, Any], *, is_static: bool) -> Iterator[Problem]:
    """Given lengths of one shape that are very large or very small."""
    for kind, names in _LENGTHS:
        if not isinstance(cfg, kind):
            continue
        for name in names:
            sizes = list(_numbers(given.get(name)))
            if not sizes:
                continue
            if max(sizes) > _LARGEST and not is_static:
                yield Problem(name, f"{max(sizes):g} m is very large: lengths are in metres")
            if min(sizes) < _SMALLEST:
                yield Problem(name, f"{min(sizes):g} m is very small: lengths are in metres")


def _places_of_terms(task: Any) -> Iterator[Problem]:
    """Places in the parameters of events and commands that are far away."""
    if not isinstance(task, Mapping):
        return
    for section in ("events", "commands"):
        terms = task.get(section)
        if not isinstance(terms, Mapping):
            continue
        for name, term in terms.items():
            params = term.get("params") if isinstance(term, Mapping) else None
            if not isinstance(params, Mapping):
                continue
            path = f"task.{section}.{name}.params"
            yield from _euler_angles(f"{path}.rotation_range", params.get("rotation_range"))
            if term.get("func") == "reset_joints":
                continue
            for key in _PLACES_OF_TERMS:
                yield from _place(f"{path}.{key}", params.get(key))


def _joint_positions_of_terms(task: Any) -> Iterator[Problem]:
    """Positions of joints, or differences of them, of more than a turn."""
    if not isinstance(task, Mapping):
        return
    for section, funcs, key in _JOINT_TERMS:
        terms = task.get(section)
        if not isinstance(terms, Mapping):
            continue
        for name, term in terms.items():
            params = term.get("params") if isinstance(term, Mapping) else None
            if not isinstance(params, Mapping) or term.get("func") not in funcs:
                continue
            if params.get("control", "position") != "position":
                continue
            largest = max((abs(number) for number in _numbers(params.get(key))), default=0.0)
            if largest > _TURN:
                fact = f"{largest:g} rad is more than a turn: positions of joints are in rad or m"
                radians = f"{largest:g} degrees are {math.radians(largest):.4g} rad"
                yield Problem(f"task.{section}.{name}.params.{key}", f"{fact}; {radians}")


def _euler_angles(path: str, value: Any) -> Iterator[Problem]:
    """Euler angles that are all multiples of 15 degrees, in rad."""
    angles = [angle for angle in _numbers(value) if angle]
    if not angles or not all(_is_in_radians(angle) for angle in angles):
        return
    degrees = 15 * round(angles[0] / _STEP_OF_ANGLES)
    key = path.rpartition(".")[2]
    fact = f"{angles[0]:g} degrees? {key} is in degrees"
    yield Problem(path, f"{fact}: {angles[0]:g} rad are {degrees}")


def _is_in_radians(angle: float) -> bool:
    """Whether an angle is written as a multiple of pi / 12 up to a turn."""
    steps = round(angle / _STEP_OF_ANGLES)
    is_rounded = abs(angle - steps * _STEP_OF_ANGLES) < _ANGLE_TOLERANCE
    return is_rounded and 0 < abs(steps) <= 24


def _place(path: str, value: Any) -> Iterator[Problem]:
    """A place, or limits of places, with a number that is far from the origin."""
    distance = max((abs(number) for number in _numbers(value)), default=0.0)
    if distance > _FARTHEST:
        fact = f"{distance:g} m is far away: positions are in metres"
        yield Problem(path, f"{fact}, joint positions in rad")


def _numbers(value: Any) -> Iterator[float]:
    """The numbers in a value, such as a nested list."""
    if isinstance(value, bool):
        return
    if isinstance(value, int | float):
        yield float(value)
    elif isinstance(value, Sequence) and not isinstance(value, str):
        for item in value:
            yield from _numbers(item)
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from _numbers(item)
