"""URDF text made ready for MuJoCo: import flags, names, and meshes that it reads."""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import mujoco

from embodichain.data import DataNotFoundError, resolve_package_uri
from embodichain.lab.sim.meshes.mesh_conversion import (
    MAX_STL_FACES,
    MadePart,
    convert_collision,
    convert_visual,
    has_materials,
    reads,
)
from embodichain.lab.sim.meshes.mesh_decomposition import decompose
from embodichain.lab.sim.meshes.mesh_part import MeshError
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["PreparedUrdf", "UrdfMeshes", "color_geom", "parse_xml", "prepare_urdf"]

_INERTIA = mujoco.mjtMeshInertia


@dataclass
class UrdfMeshes:
    """What becomes of the meshes of one file.

    Attributes:
        path: The URDF.
        convex_parts: Split collision meshes into convex parts.
        looks: OBJ file made of a visual mesh -> its colour and texture.
        shapes: OBJ files made of collision meshes.
        notes: What of the meshes was lost, one line each.
        problems: What cannot be loaded.
    """

    path: Path
    convex_parts: bool = False
    looks: dict[str, MadePart] = field(default_factory=dict)
    shapes: set[str] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    _missing: dict[str, str] = field(default_factory=dict)

    def prepare(self, root: ET.Element) -> None:
        """Give every mesh the path of a file that MuJoCo reads; a mesh may become several."""
        for link in root.iter("link"):
            for kind in ("visual", "collision"):
                for shape in link.findall(kind):
                    self._prepare(link, shape, visual=kind == "visual")
        if self._missing:
            first, *others = self._missing.values()
            more = f"\n{len(others)} more mesh files are missing" if others else ""
            self.problems.insert(0, Problem("", f"{self.path}: {first}{more}"))

    def finish(self, spec: mujoco.MjSpec) -> None:
        """Colour what was made of visual meshes; say how volumes are to be taken of the others."""
        for mesh in spec.meshes:
            if mesh.file in self.looks:
                mesh.inertia = _INERTIA.mjMESH_INERTIA_SHELL  # weighs nothing; it may be open
            elif mesh.file in self.shapes:
                mesh.inertia = _INERTIA.mjMESH_INERTIA_CONVEX
        files = {mesh.name: mesh.file for mesh in spec.meshes}
        for geom in spec.geoms:
            look = self.looks.get(files.get(geom.meshname, ""))
            if look is not None:
                color_geom(spec, geom, look)

    def _prepare(self, link: ET.Element, shape: ET.Element, visual: bool) -> None:
        mesh = shape.find("geometry/mesh")
        if mesh is None:
            return
        uri, name = mesh.get("filename", ""), link.get("name", "")
        what = f"{'visual' if visual else 'collision'} mesh of link {name!r}"
        try:
            path = Path(resolve_package_uri(uri, near=self.path))
        except DataNotFoundError as error:
            self._missing.setdefault(uri, f"{what}: {error}")
            return
        except ValueError as error:
            self.problems.append(Problem("", f"{self.path}: {what}: {error}"))
            return
        try:
            files = self._looks(path) if visual else self._shapes(path)
        except (MeshError, OSError) as error:
            link.remove(shape)
            if visual:
                self.notes.append(f"{what} left out: {error}")
            else:
                self.problems.append(Problem("", f"{self.path}: {what}: {error}"))
            return
        _replace(link, shape, files)

    def _looks(self, path: Path) -> list[Path]:
        if reads(path) and not has_materials(path):
            return [path]
        made = convert_visual(path)
        self._tell_of_stl(path)
        self.looks.update({str(part.mesh): part for part in made.parts})
        self.notes += [note for note in made.notes if note not in self.notes]
        return [part.mesh for part in made.parts]

    def _shapes(self, path: Path) -> list[Path]:
        if self.convex_parts:
            files = list(decompose(path))
        elif reads(path):
            return [path]
        else:
            files = [convert_collision(path)]
            self._tell_of_stl(path)
        self.shapes.update(str(file) for file in files)
        return files

    def _tell_of_stl(self, path: Path) -> None:
        """Say which STL files are not what MuJoCo takes their name for."""
        note = f"{path}: not a binary STL file of at most {MAX_STL_FACES:,} faces: converted"
        if path.suffix.lower() == ".stl" and note not in self.notes:
            self.notes.append(note)


def _replace(link: ET.Element, shape: ET.Element, files: list[Path]) -> None:
    """Put one copy of a shape for each file where the shape stands."""
    at = list(link).index(shape)
    link.remove(shape)
    for file, copied in zip(files, _copies(shape, len(files)), strict=True):
        mesh = copied.find("geometry/mesh")
        if mesh is not None:
            mesh.set("filename", str(file))
        link.insert(at, copied)
        at += 1


def _copies(shape: ET.Element, number: int) -> Iterator[ET.Element]:
    yield shape  # the first is the file's own: messages know its line
    for _ in range(number - 1):
        yield copy.deepcopy(shape)


def color_geom(spec: mujoco.MjSpec, geom: mujoco.MjsGeom, look: MadePart) -> None:
    """Give a shape the colour and the texture of its mesh; those win over a URDF's, as in RViz."""
    if look.rgba is not None:
        geom.rgba, geom.material = look.rgba, ""
    if look.texture is None:
        return
    name = f"{look.mesh.stem}-{look.texture.stem}"
    if spec.material(name) is None:
        texture = spec.texture(look.texture.stem)
        if texture is None:
            texture = spec.add_texture(
                name=look.texture.stem,
                type=mujoco.mjtTexture.mjTEXTURE_2D,
                file=str(look.texture),
            )
        material = spec.add_material(name=name, specular=0.2, shininess=0.3)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture.name
    geom.material, geom.rgba = name, (1.0, 1.0, 1.0, 1.0)


# Fixed links keep their bodies, visual shapes stay, and file names are used as resolved here.
_FLAGS = {"fusestatic": "false", "discardvisual": "false", "strippath": "false", "meshdir": ""}


@dataclass(frozen=True)
class PreparedUrdf:
    """A URDF that MuJoCo reads as meant.

    Attributes:
        text: XML for MuJoCo.
        lines: For each element of `text`, in order, its line in the user's file; None: ours.
        velocity_limits: Joint name -> rad/s or m/s, where the file has one.
        last_link: The last link in the order of the file.
        massless: Links without an inertial that no joint moves (fixed joint, or root): by URDF's
            rule they have no mass.
        estimated: Links without an inertial that move: their mass comes from their shapes.
        meshes: What became of its meshes.
    """

    text: str
    lines: list[int | None]
    velocity_limits: dict[str, float]
    last_link: str
    massless: frozenset[str]
    estimated: tuple[str, ...]
    meshes: UrdfMeshes

    def source_line(self, line: int) -> int | None:
        """Return the line of the user's file that a line of `text` came from."""
        _, lines = parse_xml(self.text.encode())
        for written, original in zip(lines.values(), self.lines, strict=True):
            if written >= line:
                return original
        return None


def prepare_urdf(
    path: Path, root: ET.Element, line_of: Mapping[ET.Element, int], convex_parts: bool = False
) -> PreparedUrdf:
    """Return the text MuJoCo should read instead of a URDF file.

    Args:
        path: The file, for messages and relative mesh names.
        root: Its parsed ``<robot>`` element; it is changed in place.
        line_of: The line of each element.
        convex_parts: Split collision meshes into convex parts.

    Raises:
        ConfigError: If the file has no links, needs xacro, names meshes that do not exist, or
            collision meshes that cannot be read.
    """
    if any("xacro" in element.tag for element in line_of):
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
    last = root.findall("link")[-1].get("name", "")
    return PreparedUrdf(text, lines, velocity, last, massless, estimated, meshes)


def parse_xml(source: bytes) -> tuple[ET.Element, dict[ET.Element, int]]:
    """Return the root of an XML text, and the line of every element, in document order.

    Prefixes of namespaces stay in tags and attributes.

    Raises:
        xml.parsers.expat.ExpatError: If it is not well-formed.
    """
    builder, lines = ET.TreeBuilder(), dict[ET.Element, int]()
    parser = expat.ParserCreate()

    def begin(tag: str, attributes: dict[str, str]) -> None:
        lines[builder.start(tag, attributes)] = parser.CurrentLineNumber

    parser.StartElementHandler = begin
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.Parse(source, True)
    return builder.close(), lines


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
