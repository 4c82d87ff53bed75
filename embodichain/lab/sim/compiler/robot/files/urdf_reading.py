"""What a URDF says that MuJoCo does not read, or reads otherwise: refused or told, by name.

MuJoCo takes no limits from a joint whose `<limit>` is missing, or whose `lower` is not below
`upper`, nor an effort limit of 0, and it has floating joints at the root only.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from embodichain.data.faults import unexpanded
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = [
    "UrdfLimits",
    "carriers",
    "check_joints",
    "check_links",
    "check_text",
    "planar_notes",
    "read_limits",
]

Lines = Mapping[ET.Element, int]

_LIMITED = ("revolute", "prismatic")


def check_text(path: Path, root: ET.Element, line_of: Lines) -> None:
    """Refuse what xacro or roslaunch should have replaced.

    Raises:
        ConfigError: Every place, with the file and the line.
    """
    places = [f"{path}:{line_of[element]}: {what}" for element, what in unexpanded(root)]
    if not places:
        return
    first, *others = places
    more = f" (and {len(others)} more)" if others else ""
    raise ConfigError(
        f"{first}{more}: xacro has to be expanded to URDF first: `xacro {path.name} > robot.urdf`, "
        "with a value for each argument, or write the values into the file"
    )


def check_links(path: Path, root: ET.Element, line_of: Lines) -> None:
    """Refuse joints between links that the file does not have.

    Raises:
        ConfigError: Every one, with the file, the line and the closest link.
    """
    links = [link.get("name", "") for link in root.findall("link")]
    problems: list[Problem] = []
    for joint in root.findall("joint"):
        for which in ("parent", "child"):
            name = _end(joint, which)
            if name in links or (which == "parent" and name == "world"):
                continue
            place = joint.find(which)
            line = line_of[joint if place is None else place]
            start = f"{path}:{line}: joint {joint.get('name', '')!r}"
            if not name:
                problems.append(Problem("", f'{start} has no <{which} link="...">'))
                continue
            fault = f"{start} has the {which} {name!r}, and no link is called so"
            there = f"there are: {listing(links, name)}"
            hint = did_you_mean(name, links).strip()
            problems.append(Problem("", f"{fault}; {there}", hint).at(""))
    if problems:
        raise ConfigError(problems)


def check_joints(path: Path, root: ET.Element, line_of: Lines) -> None:
    """Refuse floating joints that are not at the root.

    Raises:
        ConfigError: Every one, with the file, the line and what to write instead.
    """
    children = {_end(joint, "child") for joint in root.findall("joint")}
    links = {link.get("name", ""): link for link in root.findall("link")}
    problems: list[Problem] = []
    for joint in root.findall("joint"):
        parent = _end(joint, "parent")
        child = _end(joint, "child")
        if joint.get("type") != "floating" or parent == "world":
            continue
        fault = f"joint {joint.get('name', '')!r} is floating, and only the root of a robot floats"
        count = sum(_end(other, "parent") == parent for other in root.findall("joint"))
        is_root = parent not in children
        is_empty = parent in links and not len(links[parent])
        if is_root and is_empty and count == 1:
            # The parent is an empty root, which stands for the world.
            advice = f"remove this joint and link {parent!r}, and set fix_base: false in the task"
        else:
            advice = (
                f"give it another type, such as fixed, or move {child!r} and what is below it to "
                "a file of its own, an articulation with fix_base: false"
            )
        problems.append(Problem("", f"{path}:{line_of[joint]}: {fault}: {advice}"))
    if problems:
        raise ConfigError(problems)


def planar_notes(root: ET.Element, line_of: Lines) -> list[str]:
    """Return a message about each planar joint, which becomes three joints."""
    notes = []
    for joint in root.findall("joint"):
        if joint.get("type") == "planar":
            name = joint.get("name", "")
            parts = ", ".join(f"{name}_{part}" for part in ("TX", "TY", "RZ"))
            notes.append(
                f"line {line_of[joint]}: planar joint {name!r} becomes two slides and a hinge, "
                f"{parts}: each has a drive of drive_pros"
            )
    return notes


def carriers(root: ET.Element) -> dict[str, str]:
    """Link -> the link that carries it, by a joint."""
    joints = root.findall("joint")
    return {_end(joint, "child"): _end(joint, "parent") for joint in joints}


def _end(joint: ET.Element, which: str) -> str:
    """The link of ``<parent>`` or ``<child>``."""
    element = joint.find(which)
    return "" if element is None else element.get("link", "")


# ----------------------------------------------------------------------------------------- limits


@dataclass(frozen=True)
class UrdfLimits:
    """What `<limit>` elements say beyond the ranges that MuJoCo reads.

    Attributes:
        velocity: Joint -> velocity limit, where the file has one that is not 0.
        zero_effort, zero_velocity: Joint -> file and line of an effort or a velocity of 0.
        notes: Messages about ranges that are not limits, without the file.
    """

    velocity: dict[str, float] = field(default_factory=dict)
    zero_effort: dict[str, str] = field(default_factory=dict)
    zero_velocity: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def renamed(self, names: Mapping[str, str]) -> UrdfLimits:
        """Return them with other names of the joints; of those that `names` does not have, none."""

        def rename(values: Mapping[str, Any]) -> dict[str, Any]:
            return {names[old]: value for old, value in values.items() if old in names}

        return UrdfLimits(
            velocity=rename(self.velocity),
            zero_effort=rename(self.zero_effort),
            zero_velocity=rename(self.zero_velocity),
            notes=self.notes,
        )

    def joined(self, other: UrdfLimits) -> UrdfLimits:
        """Return these and those of another file."""
        return UrdfLimits(
            velocity=self.velocity | other.velocity,
            zero_effort=self.zero_effort | other.zero_effort,
            zero_velocity=self.zero_velocity | other.zero_velocity,
            notes=(*self.notes, *other.notes),
        )


def read_limits(path: Path, root: ET.Element, line_of: Lines) -> UrdfLimits:
    """Read the limits of a URDF's joints.

    Raises:
        ConfigError: If one is not a number, or is negative where only its size has a meaning.
    """
    velocity: dict[str, float] = {}
    zero_effort: dict[str, str] = {}
    zero_velocity: dict[str, str] = {}
    problems: list[Problem] = []
    joints_without_limit: list[str] = []
    joints_with_equal_ends: list[str] = []
    joints_with_reversed_ends: list[str] = []
    for joint in root.findall("joint"):
        name = joint.get("name", "")
        has_range = joint.get("type", "") in _LIMITED
        limit = joint.find("limit")
        if limit is None:
            if has_range:
                joints_without_limit.append(f"{name!r} (line {line_of[joint]})")
            continue
        place = f"{path}:{line_of[limit]}"
        values, mistakes = _read_limit(limit, f"{place}: joint {name!r}")
        problems += mistakes
        # CAD exporters write 0 where they do not know a limit.
        if values.get("velocity") == 0:
            zero_velocity[name] = place
        elif "velocity" in values:
            velocity[name] = values["velocity"]
        if values.get("effort") == 0:
            zero_effort[name] = place
        low = values.get("lower", 0.0)
        high = values.get("upper", 0.0)
        if has_range and low == high:
            joints_with_equal_ends.append(f"{name!r} (line {line_of[limit]}: {low:g})")
        elif has_range and low > high:
            ends = f"{low:g}, {high:g}"
            joints_with_reversed_ends.append(f"{name!r} (line {line_of[limit]}: {ends})")
    if problems:
        raise ConfigError(problems)
    notes: list[str] = []
    if joints_without_limit:
        names = ", ".join(joints_without_limit)
        notes.append(f"joints without <limit> move without limits: {names}")
    if joints_with_equal_ends:
        advice = 'a joint that shall not move has type="fixed", or an entry in locked_joints'
        names = ", ".join(joints_with_equal_ends)
        notes.append(f"joints whose lower equals upper move without limits: {names}; {advice}")
    if joints_with_reversed_ends:
        names = ", ".join(joints_with_reversed_ends)
        notes.append(f"joints whose lower is above upper move without limits: {names}")
    return UrdfLimits(
        velocity=velocity,
        zero_effort=zero_effort,
        zero_velocity=zero_velocity,
        notes=tuple(notes),
    )


def _read_limit(limit: ET.Element, place: str) -> tuple[dict[str, float], list[Problem]]:
    """Return the numbers of a `<limit>`, and every mistake; messages begin with `place`."""
    values: dict[str, float] = {}
    problems: list[Problem] = []
    for key in ("lower", "upper", "effort", "velocity"):
        text = limit.get(key)
        if text is None:
            continue
        value = _number(text)
        if value is None or math.isnan(value):
            problems.append(Problem("", f"{place}: {key} must be a number, got {text!r}"))
        elif value < 0 and key in ("effort", "velocity"):
            problems.append(Problem("", f"{place}: {key} must not be negative, got {value:g}"))
        else:
            values[key] = value
    return values, problems


def _number(text: str) -> float | None:
    """A number, or None."""
    try:
        return float(text)
    except ValueError:
        return None
