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

__all__ = ["UrdfLimits", "carriers", "check_joints", "check_text", "planar_notes", "read_limits"]

Lines = Mapping[ET.Element, int]

_LIMITED = ("revolute", "prismatic")


def check_text(path: Path, root: ET.Element, line_of: Lines) -> None:
    """Refuse what xacro or roslaunch should have replaced.

    Raises:
        ConfigError: Every place, with the file and the line.
    """
    found = [f"{path}:{line_of[element]}: {what}" for element, what in unexpanded(root)]
    if not found:
        return
    first, others = found[0], len(found) - 1
    more = f" (and {others} more)" if others else ""
    raise ConfigError(
        f"{first}{more}: xacro has to be expanded to URDF first: `xacro {path.name} > robot.urdf`, "
        "with a value for each argument, or write the values into the file"
    )


def check_joints(path: Path, root: ET.Element, line_of: Lines) -> None:
    """Refuse floating joints that are not at the root.

    Raises:
        ConfigError: Every one, with the file, the line and what to write instead.
    """
    children = {_end(joint, "child") for joint in root.findall("joint")}
    links = {link.get("name", ""): link for link in root.findall("link")}
    problems: list[Problem] = []
    for joint in root.findall("joint"):
        parent, child = _end(joint, "parent"), _end(joint, "child")
        if joint.get("type") != "floating" or parent == "world":
            continue
        told = f"joint {joint.get('name', '')!r} is floating, and only the root of a robot floats"
        below = sum(_end(other, "parent") == parent for other in root.findall("joint"))
        bare = parent in links and not len(links[parent])
        if parent not in children and bare and below == 1:
            advice = f"remove this joint and link {parent!r}, and set fix_base: false in the task"
        else:
            advice = (
                f"give it another type, such as fixed, or move {child!r} and what is below it to "
                "a file of its own, an articulation with fix_base: false"
            )
        problems.append(Problem("", f"{path}:{line_of[joint]}: {told}: {advice}"))
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
    found = joint.find(which)
    return "" if found is None else found.get("link", "")


# ----------------------------------------------------------------------------------------- limits


@dataclass(frozen=True)
class UrdfLimits:
    """What `<limit>` elements say beyond the ranges that MuJoCo reads.

    Attributes:
        velocity: Joint -> velocity limit, where the file has one.
        zero_effort, zero_velocity: Joint -> file and line of an effort or a velocity of 0.
        notes: Messages about ranges that are no limits, without the file.
    """

    velocity: dict[str, float] = field(default_factory=dict)
    zero_effort: dict[str, str] = field(default_factory=dict)
    zero_velocity: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def renamed(self, names: Mapping[str, str]) -> UrdfLimits:
        """Return them with other names of the joints; of those that `names` does not have, none."""

        def of(values: Mapping[str, Any]) -> dict[str, Any]:
            return {names[old]: value for old, value in values.items() if old in names}

        return UrdfLimits(
            of(self.velocity), of(self.zero_effort), of(self.zero_velocity), self.notes
        )

    def joined(self, other: UrdfLimits) -> UrdfLimits:
        """Return these and those of another file."""
        return UrdfLimits(
            self.velocity | other.velocity,
            self.zero_effort | other.zero_effort,
            self.zero_velocity | other.zero_velocity,
            (*self.notes, *other.notes),
        )


def read_limits(path: Path, root: ET.Element, line_of: Lines) -> UrdfLimits:
    """Read the limits of a URDF's joints.

    Raises:
        ConfigError: If one is not a number, or is negative where only its size has a meaning.
    """
    velocity, zero_effort, zero_velocity = dict[str, float](), dict[str, str](), dict[str, str]()
    problems: list[Problem] = []
    unlimited, empty, reversed_ = list[str](), list[str](), list[str]()
    for joint in root.findall("joint"):
        name, kind = joint.get("name", ""), joint.get("type", "")
        limit = joint.find("limit")
        if limit is None:
            if kind in _LIMITED:
                unlimited.append(f"{name!r} (line {line_of[joint]})")
            continue
        where = f"{path}:{line_of[limit]}"
        values: dict[str, float] = {}
        for key in ("lower", "upper", "effort", "velocity"):
            text = limit.get(key)
            value = _number(text)
            if text is not None and (value is None or math.isnan(value)):
                message = f"{where}: joint {name!r}: {key} must be a number, got {text!r}"
                problems.append(Problem("", message))
            elif value is not None and value < 0 and key in ("effort", "velocity"):
                message = f"{where}: joint {name!r}: {key} must not be negative, got {value:g}"
                problems.append(Problem("", message))
            elif value is not None:
                values[key] = value
        if "velocity" in values:
            velocity[name] = values["velocity"]
        if values.get("velocity") == 0:
            zero_velocity[name] = where
        if values.get("effort") == 0:
            zero_effort[name] = where
        low, high = values.get("lower", 0.0), values.get("upper", 0.0)
        if kind in _LIMITED and low == high:
            empty.append(f"{name!r} (line {line_of[limit]}: {low:g})")
        elif kind in _LIMITED and low > high:
            reversed_.append(f"{name!r} (line {line_of[limit]}: {low:g}, {high:g})")
    if problems:
        raise ConfigError(problems)
    notes = []
    if unlimited:
        notes.append(f"joints without <limit> move without limits: {', '.join(unlimited)}")
    if empty:
        advice = 'a joint that shall not move has type="fixed", or an entry in locked_joints'
        names = ", ".join(empty)
        notes.append(f"joints whose lower equals upper move without limits: {names}; {advice}")
    if reversed_:
        names = ", ".join(reversed_)
        notes.append(f"joints whose lower is above upper move without limits: {names}")
    return UrdfLimits(velocity, zero_effort, zero_velocity, tuple(notes))


def _number(text: str | None) -> float | None:
    """A number, or None."""
    try:
        return None if text is None else float(text)
    except ValueError:
        return None
