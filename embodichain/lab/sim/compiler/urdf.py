"""URDF text made ready for MuJoCo: import flags, absolute mesh paths, no unreadable visuals.

`prepare_urdf` changes text only; MuJoCo parses the result in `files`.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from embodichain.data import DataNotFoundError, resolve_package_uri
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["MESH_SUFFIXES", "PreparedUrdf", "element_lines", "prepare_urdf"]

MESH_SUFFIXES = (".obj", ".stl", ".msh")
"""Mesh formats that MuJoCo reads."""

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
        notes: What was left out, one line each.
    """

    text: str
    lines: list[int | None]
    velocity_limits: dict[str, float]
    massless: frozenset[str]
    estimated: tuple[str, ...]
    notes: tuple[str, ...] = ()

    def source_line(self, line: int) -> int | None:
        """Return the line of the user's file that a line of `text` came from."""
        for (_, written), original in zip(element_lines(self.text), self.lines, strict=True):
            if written >= line:
                return original
        return None


@dataclass
class _Meshes:
    """What happened to the meshes of a file."""

    path: Path
    drop_visuals: bool
    dropped: dict[str, list[str]] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)


def prepare_urdf(
    path: Path, root: ET.Element, source: bytes, drop_visual_meshes: bool = False
) -> PreparedUrdf:
    """Return the text MuJoCo should read instead of a URDF file.

    Args:
        path: The file, for messages and relative mesh names.
        root: Its parsed ``<robot>`` element; it is changed in place.
        source: Its bytes.
        drop_visual_meshes: Leave every visual mesh out, not only those in formats MuJoCo lacks.

    Raises:
        ConfigError: If the file has no links, needs xacro, names meshes that do not exist, or
            collision meshes that MuJoCo cannot read.
    """
    written = element_lines(source)
    line_of = {element: line for element, (_, line) in zip(root.iter(), written, strict=True)}
    if any("xacro" in tag for tag, _ in written):
        raise ConfigError(
            [Problem("", f"{path}: xacro has to be expanded to URDF first: `xacro {path.name}`")]
        )
    if root.find("link") is None:
        raise ConfigError([Problem("", f"{path}: the robot has no <link>")])
    meshes = _Meshes(path, drop_visual_meshes)
    for link in root.iter("link"):
        _prepare_link(link, meshes)
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
    return PreparedUrdf(text, lines, velocity, massless, estimated, tuple(_notes(meshes)))


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


def _prepare_link(link: ET.Element, meshes: _Meshes) -> None:
    name = link.get("name", "")
    for kind in ("visual", "collision"):
        for shape in link.findall(kind):
            mesh = shape.find("geometry/mesh")
            if mesh is not None and not _prepare_mesh(mesh, kind, name, meshes):
                meshes.dropped.setdefault(name, []).append(mesh.get("filename", ""))
                link.remove(shape)


def _prepare_mesh(mesh: ET.Element, kind: str, link: str, meshes: _Meshes) -> bool:
    """Make a mesh's path absolute; return whether the shape can stay."""
    uri = mesh.get("filename", "")
    suffix = Path(uri).suffix.lower()
    visual = kind == "visual"
    if visual and (meshes.drop_visuals or suffix not in MESH_SUFFIXES):
        return False
    if suffix not in MESH_SUFFIXES:
        meshes.problems.append(
            Problem(
                "",
                f"{meshes.path}: collision mesh {uri!r} of link {link!r} has format "
                f"{suffix or 'none'}, which MuJoCo cannot read; convert it to one of: "
                f"{', '.join(MESH_SUFFIXES)}",
            )
        )
        return True
    try:
        mesh.set("filename", resolve_package_uri(uri, near=meshes.path))
    except (DataNotFoundError, ValueError) as error:
        meshes.problems.append(Problem("", f"{meshes.path}: {kind} mesh of link {link!r}: {error}"))
    return True


def _notes(meshes: _Meshes) -> Iterator[str]:
    if not meshes.dropped:
        return
    files = [file for names in meshes.dropped.values() for file in names]
    formats = sorted({Path(file).suffix or "no suffix" for file in files})
    why = (
        "MuJoCo could not read them"
        if meshes.drop_visuals
        else f"MuJoCo cannot read {', '.join(formats)}"
    )
    yield (
        f"{meshes.path}: {len(files)} visual meshes left out ({why}); collision shapes are drawn "
        f"instead for links {', '.join(meshes.dropped)}"
    )


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
