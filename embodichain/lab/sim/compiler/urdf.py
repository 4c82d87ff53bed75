"""URDF text made ready for MuJoCo: import flags, names, and meshes that it reads (`urdf_meshes`).

`prepare_urdf` changes text only; MuJoCo parses the result in `files`.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

from embodichain.lab.sim.compiler.urdf_meshes import UrdfMeshes
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["PreparedUrdf", "element_lines", "prepare_urdf"]

# Fixed links keep their bodies, visual shapes stay, and file names are used as resolved here.
_FLAGS = {"fusestatic": "false", "discardvisual": "false", "strippath": "false", "meshdir": ""}


@dataclass(frozen=True)
class PreparedUrdf:
    """A URDF that MuJoCo reads as meant.

    Attributes:
        text: XML for MuJoCo.
        lines: For each element of `text`, in order, its line in the user's file; None: ours.
        velocity_limits: Joint name -> rad/s or m/s, where the file has one.
        massless: Links without an inertial that no joint moves (fixed joint, or root): by URDF's
            rule they have no mass.
        estimated: Links without an inertial that move: their mass comes from their shapes.
        meshes: What became of its meshes.
    """

    text: str
    lines: list[int | None]
    velocity_limits: dict[str, float]
    massless: frozenset[str]
    estimated: tuple[str, ...]
    meshes: UrdfMeshes

    def source_line(self, line: int) -> int | None:
        """Return the line of the user's file that a line of `text` came from."""
        for (_, written), original in zip(element_lines(self.text), self.lines, strict=True):
            if written >= line:
                return original
        return None


def prepare_urdf(
    path: Path, root: ET.Element, source: bytes, convex_parts: bool = False
) -> PreparedUrdf:
    """Return the text MuJoCo should read instead of a URDF file.

    Args:
        path: The file, for messages and relative mesh names.
        root: Its parsed ``<robot>`` element; it is changed in place.
        source: Its bytes.
        convex_parts: Split collision meshes into convex parts.

    Raises:
        ConfigError: If the file has no links, needs xacro, names meshes that do not exist, or
            collision meshes that cannot be read.
    """
    written = element_lines(source)
    line_of = {element: line for element, (_, line) in zip(root.iter(), written, strict=True)}
    if any("xacro" in tag for tag, _ in written):
        raise ConfigError(
            [Problem("", f"{path}: xacro has to be expanded to URDF first: `xacro {path.name}`")]
        )
    if root.find("link") is None:
        raise ConfigError([Problem("", f"{path}: the robot has no <link>")])
    meshes = UrdfMeshes(path, convex_parts)
    meshes.prepare(root)
    if meshes.problems:
        raise ConfigError(meshes.problems)
    _drop_repeated_names(root)
    massless, estimated = _without_inertial(root)
    velocity = {
        joint.get("name", ""): float(value)
        for joint in root.iter("joint")
        if (limit := joint.find("limit")) is not None and (value := limit.get("velocity"))
    }
    _set_flags(root)
    text = ET.tostring(root, encoding="unicode")
    lines = [line_of.get(element) for element in root.iter()]
    return PreparedUrdf(text, lines, velocity, massless, estimated, meshes)


def element_lines(source: bytes | str) -> list[tuple[str, int]]:
    """Return (tag, line) of every element of an XML text, in document order."""
    found: list[tuple[str, int]] = []
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda tag, _: found.append((tag, parser.CurrentLineNumber))
    parser.Parse(source.encode() if isinstance(source, str) else source, True)
    return found


def _set_flags(root: ET.Element) -> None:
    """Write our import flags into the file's ``<mujoco><compiler>`` extension, which may exist."""
    extension = root.find("mujoco")
    if extension is None:
        extension = ET.Element("mujoco")
        root.insert(0, extension)
    compiler = extension.find("compiler")
    if compiler is None:
        compiler = ET.SubElement(extension, "compiler")
    compiler.attrib.update(_FLAGS)


def _drop_repeated_names(root: ET.Element) -> None:
    """Take the name off shapes whose name another shape has: MuJoCo would only complain of it."""
    seen: set[str] = set()
    for shape in (*root.iter("visual"), *root.iter("collision")):
        name = shape.get("name", "")
        if name in seen:
            shape.attrib.pop("name", None)
        seen.add(name)


def _without_inertial(root: ET.Element) -> tuple[frozenset[str], tuple[str, ...]]:
    """Return links without an inertial: those held by fixed joints, and those that move."""
    moved = {
        child.get("link", "")
        for joint in root.findall("joint")
        if joint.get("type") != "fixed" and (child := joint.find("child")) is not None
    }
    bare = [link.get("name", "") for link in root.findall("link") if link.find("inertial") is None]
    shaped = {
        link.get("name", "") for link in root.findall("link") if link.find("collision") is not None
    }
    return (
        frozenset(name for name in bare if name not in moved),
        tuple(name for name in bare if name in moved and name in shaped),
    )
