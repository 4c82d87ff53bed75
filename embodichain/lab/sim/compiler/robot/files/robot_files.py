"""Reads robot files into `MjSpec`: formats, meshes, one-line errors, repair of inertias."""

from __future__ import annotations

import os
import re
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np

from embodichain.data import DataNotFoundError, get_data_path
from embodichain.lab.sim.compiler.geoms.mesh_reading import MeshError
from embodichain.lab.sim.compiler.geoms.shape_geoms import collides
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.model_size import check_copies, check_depth
from embodichain.lab.sim.compiler.robot.files.file_options import given_options
from embodichain.lab.sim.compiler.robot.files.mjcf_meshes import (
    convert_meshes,
    make_absolute,
    missing_files,
    split_meshes,
)
from embodichain.lab.sim.compiler.robot.files.urdf_meshes import UrdfMeshes
from embodichain.lab.sim.compiler.robot.files.urdf_reading import (
    UrdfLimits,
    carriers,
    check_joints,
    check_links,
    check_text,
    planar_notes,
    read_limits,
)
from embodichain.lab.sim.compiler.robot.files.xml_text import XmlError, parse_xml, root_tag
from embodichain.lab.sim.engine.cpu.mujoco_process import install_log_handler
from embodichain.utils.errors import ConfigError
from embodichain.utils.math import quat_multiply

__all__ = [
    "MUJOCO_ERRORS",
    "ModelFile",
    "as_line",
    "compile_quietly",
    "compile_unlimited",
    "locate",
    "read_model",
]

MUJOCO_ERRORS = (ValueError, RuntimeError, mujoco.FatalError)
"""Exceptions of MuJoCo's bindings for a model it cannot parse or compile."""

_LINE = re.compile(r",? *\bline(?: number)? *[=:]? *(\d+)", re.IGNORECASE)
_ELEMENT = re.compile(r"\s*Element (?:name )?'(?P<name>[^']*)'(?:, id \d+)?")
_XML_CODE = re.compile(
    r"XML parse error \d+:\s*Error=XML_ERROR_(?P<code>\w+) ErrorID=\d+ *(?:\(\w+\))?"
)
_SHAPE_SUFFIXES = frozenset(
    [".stl", ".obj", ".dae", ".ply", ".glb", ".gltf", ".off", ".3mf", ".step", ".stp", ".iges"]
)
"""Of files with the shape of one part, from which a robot is made but which have no joints."""
_PREFIXES = ("Error: ", "XML Error: ", "Schema violation: ")


def as_line(error: Exception) -> tuple[str, int | None]:
    """Return a MuJoCo error as one line of text, and the XML line number it names, if any."""
    text = str(error).strip()
    line = _LINE.search(text)
    text = _LINE.sub("", text)
    text = _XML_CODE.sub(lambda m: m["code"].replace("_", " ").lower(), text)
    text = _ELEMENT.sub(lambda m: f" (element {m['name']!r})" if m["name"] else "", text)
    for prefix in _PREFIXES:
        text = text.removeprefix(prefix)
    one_line = " ".join(text.split()).rstrip(" :")
    return one_line, int(line[1]) if line else None


def _located_error(path: Path, error: Exception, line: int | None) -> ConfigError:
    """Return a MuJoCo error with the file and, if it is known, the line."""
    message, _ = as_line(error)
    place = f"{path}:{line}" if line else str(path)
    return ConfigError(f"{place}: {message}")


@dataclass
class ModelFile:
    """A robot file, parsed and compiled by MuJoCo.

    Attributes:
        path: Its path.
        is_urdf: Whether it is a URDF; else MJCF.
        spec: The parsed file, unedited; it compiles.
        model: The file's model.
        limits: Limits of its joints that the model does not have; URDF only.
        last_link: The last link in the order of the URDF text, not of the tree.
        notes: Messages for the user, one line each.
        options: The physics options that it gives, see `given_options`.
    """

    path: Path
    is_urdf: bool
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    limits: UrdfLimits = field(default_factory=UrdfLimits)
    last_link: str = ""
    notes: list[str] = field(default_factory=list)
    options: frozenset[str] = frozenset()


def locate(fpath: str | None) -> Path:
    """Return the path of a file.

    Raises:
        ConfigError: If it is missing; lists the places searched and the closest names.
    """
    if not fpath:
        raise ConfigError("no file: set fpath to a .urdf or .xml file")
    try:
        path = Path(get_data_path(fpath))
    except DataNotFoundError as error:
        raise ConfigError(str(error)) from error
    if path.is_dir():
        raise ConfigError(f"{path} is a folder, not a .urdf or .xml file")
    return path


def read_model(path: Path, convex_parts: bool = False) -> ModelFile:
    """Parse and compile a URDF or MJCF file.

    Args:
        path: The file.
        convex_parts: Whether to split collision meshes into convex parts.

    Raises:
        ConfigError: If it is malformed; names the file and, where known, the line.
    """
    install_log_handler()
    if path.suffix.lower() in _SHAPE_SUFFIXES:
        message = f"{path} is a shape, not a robot: a robot is a URDF or MJCF file (.urdf, .xml)"
        raise ConfigError(f"{message}, which names its shapes; `embodichain list robots` has some")
    try:
        source = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    if root_tag(source) == "mujoco":
        return _read_checked_mjcf(path, source, convex_parts)
    try:
        root, line_of = parse_xml(source)
    except XmlError as error:
        raise _not_xml(path, error) from error
    options = given_options(root, path.parent)
    if root.tag != "robot":
        raise ConfigError(
            f"{path}: neither URDF nor MJCF: its root is <{root.tag}>, not <robot> or <mujoco>"
        )
    return replace(_read_urdf(path, root, line_of, convex_parts), options=options)


def _not_xml(path: Path, error: XmlError) -> ConfigError:
    return ConfigError(f"{path}:{error.line}: not well-formed XML: {error}")


def _read_checked_mjcf(path: Path, source: bytes, convex_parts: bool) -> ModelFile:
    """Read an MJCF; what only MuJoCo can read of its text is not looked at before."""
    try:
        root, line_of = parse_xml(source)
    except XmlError as error:
        try:
            return _read_mjcf(path, convex_parts)
        except ConfigError:
            raise _not_xml(path, error) from error
    check_copies(path, root, line_of)
    options = given_options(root, path.parent)
    return replace(_read_mjcf(path, convex_parts), options=options)


def compile_quietly(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile without MuJoCo's Python warnings, which this package reports itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return spec.compile()


_SAME_FILES = "/proc/self/root"
"""Below it, Linux has every file under a second path (proc(5))."""


def compile_unlimited(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile as `compile_quietly`, before hulls are limited (`limit_hulls`).

    MuJoCo caches a mesh by the path of its file, with the hull of the first compilation: a second
    limit is never cached, and each later compilation would make all hulls again, 0.3 s for a
    humanoid. So files have a second path here, where there is one.
    """
    meshes = [mesh for mesh in spec.meshes if mesh.maxhullvert < 0 and os.path.isabs(mesh.file)]
    if not (meshes and os.path.exists(_SAME_FILES)):
        return compile_quietly(spec)
    paths = [mesh.file for mesh in meshes]
    try:
        for mesh, path in zip(meshes, paths, strict=True):
            mesh.file = f"{_SAME_FILES}{path}"
        return compile_quietly(spec)
    except MUJOCO_ERRORS as error:
        if _SAME_FILES not in str(error):
            raise
        # The compilation below raises it with the path that the reader knows.
    finally:
        for mesh, path in zip(meshes, paths, strict=True):
            mesh.file = path
    return compile_quietly(spec)


def _name_elements(spec: mujoco.MjSpec) -> None:
    """Name bodies, joints, geoms, actuators and cameras that have no name in the file."""
    for what, elements in (
        ("body", spec.bodies),
        ("joint", spec.joints),
        ("geom", spec.geoms),
        ("actuator", spec.actuators),
        ("camera", spec.cameras),
    ):
        used_names = {element.name for element in elements}
        for number, element in enumerate(elements):
            if element.name:
                continue
            name = f"{what}_{number}"
            while name in used_names:
                name += "_"
            element.name = name
            used_names.add(name)


# -------------------------------------------------------------------------------------------- MJCF


def _read_mjcf(path: Path, convex_parts: bool) -> ModelFile:
    spec: mujoco.MjSpec | None = None
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compiler.fusestatic = False  # tool frames keep their bodies
        spec.nkey = 0  # `<size nkey>` would add keyframes without values
        _name_elements(spec)
        make_absolute(spec, path.parent)
        notes = [f"{path}: {note}" for note in convert_meshes(spec)]
        model = compile_unlimited(spec)
        if convex_parts:
            split_meshes(spec)
            model = compile_unlimited(spec)
        return ModelFile(path=path, is_urdf=False, spec=spec, model=model, notes=notes)
    except (MeshError, *MUJOCO_ERRORS) as error:
        missing = [] if spec is None else missing_files(spec, path)
        if missing:
            raise ConfigError(missing) from error
        _, line = as_line(error)
        raise _located_error(path, error, line) from error


# -------------------------------------------------------------------------------------------- URDF

# Keep bodies of fixed links and visual shapes, and use the file names resolved here.
_FLAGS = {"fusestatic": "false", "discardvisual": "false", "strippath": "false", "meshdir": ""}


def _read_urdf(
    path: Path, root: ET.Element, line_of: Mapping[ET.Element, int], convex_parts: bool
) -> ModelFile:
    """Compile a URDF, after editing its tree in place so that MuJoCo reads it correctly."""
    check_text(path, root, line_of)
    links = root.findall("link")
    if not links:
        raise ConfigError(f"{path}: the robot has no <link>")
    check_links(path, root, line_of)
    check_joints(path, root, line_of)
    check_depth(path, carriers(root))
    limits = read_limits(path, root, line_of)
    planar = planar_notes(root, line_of)
    meshes = UrdfMeshes(path, convex_parts)
    meshes.prepare(root)
    _drop_repeated_names(root)
    _set_flags(root)
    text = ET.tostring(root, encoding="unicode")
    try:
        spec = mujoco.MjSpec.from_string(text)
        _name_elements(spec)
        meshes.finish(spec)
        notes = [f"{path}: {note}" for note in (*limits.notes, *planar, *meshes.notes)]
        notes += [f"{path}: {note}" for note in _set_masses(spec, root)]
        model = _compile_repaired(path, spec, notes)
    except MUJOCO_ERRORS as error:
        raise _located_error(path, error, _line_in_file(error, text, root, line_of)) from error
    return ModelFile(
        path=path,
        is_urdf=True,
        spec=spec,
        model=model,
        limits=limits,
        last_link=links[-1].get("name", ""),
        notes=notes,
    )


def _line_in_file(
    error: Exception, text: str, root: ET.Element, line_of: Mapping[ET.Element, int]
) -> int | None:
    """Return the line of a file that a MuJoCo error is about, if it names one.

    Args:
        error: The error, which names a line of `text`.
        text: What MuJoCo has read: the elements of `root` in their order.
        root: The edited file.
        line_of: Lines of the elements that are in the file.
    """
    _, line_of_text = as_line(error)
    if line_of_text is None:
        return None
    _, lines = parse_xml(text.encode())
    for line, element in zip(lines.values(), root.iter(), strict=True):
        if line >= line_of_text:
            return line_of.get(element)
    return None


def _set_flags(root: ET.Element) -> None:
    """Write our import flags into the file's ``<mujoco><compiler>`` extension."""
    extension = root.find("mujoco")
    if extension is None:
        extension = ET.Element("mujoco")
        root.insert(0, extension)
    compiler = extension.find("compiler")
    if compiler is None:
        compiler = ET.SubElement(extension, "compiler")
    compiler.attrib.update(_FLAGS)


def _drop_repeated_names(root: ET.Element) -> None:
    """Remove names that several shapes share; MuJoCo would only warn about them."""
    seen: set[str] = set()
    for shape in (*root.iter("visual"), *root.iter("collision")):
        name = shape.get("name", "")
        if name in seen:
            shape.attrib.pop("name", None)
        seen.add(name)


def _set_masses(spec: mujoco.MjSpec, root: ET.Element) -> list[str]:
    """Set masses of links without an inertial by URDF's rule; return messages about estimates.

    The mass is zero if no joint moves the link (fixed joint or root), else that of its shapes.
    """
    moving_links: set[str] = set()
    for joint in root.findall("joint"):
        child = joint.find("child")
        if joint.get("type") != "fixed" and child is not None:
            moving_links.add(child.get("link", ""))

    estimated_links: list[str] = []
    for link in root.findall("link"):
        if link.find("inertial") is not None:
            continue
        name = link.get("name", "")
        if name in moving_links:
            if link.find("collision") is not None:
                estimated_links.append(name)
            continue
        body = spec.body(name)
        if body is None:
            continue
        for geom in body.geoms:
            geom.mass = 0.0
            geom.density = 0.0
    if not estimated_links:
        return []
    rule = "have no <inertial>: taken from their shapes at 1000 kg/m^3"
    return [f"links {', '.join(estimated_links)} {rule}"]


_SHELL = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
_WITHOUT_VOLUME = re.compile(r"mesh volume is too small: (\S+)")


def _compile_repaired(path: Path, spec: mujoco.MjSpec, notes: list[str]) -> mujoco.MjModel:
    """Compile; repair meshes without volume and invalid inertias, and add notes about it."""
    is_repaired = False
    while True:
        try:
            return compile_unlimited(spec)
        except MUJOCO_ERRORS as error:
            text, _ = as_line(error)
            flat_mesh = _mesh_without_volume(spec, text)
            if flat_mesh is not None:
                flat_mesh.inertia = _SHELL
                notes.append(f"{path}: mesh {flat_mesh.name!r} has no volume: taken as a shell")
            elif not is_repaired and ("inertia" in text or "mjMINVAL" in text):
                is_repaired = True
                notes.append(f"{path}: {_repair_inertias(spec)}")
            else:
                raise


def _mesh_without_volume(spec: mujoco.MjSpec, error: str) -> mujoco.MjsMesh | None:
    """Return the mesh of which an error says that its volume is too small.

    None if there is no such mesh, or it is a shell already.
    """
    named = _WITHOUT_VOLUME.search(error)
    if named is None:
        return None
    mesh = spec.mesh(named[1])
    if mesh is None or mesh.inertia == _SHELL:
        return None
    return mesh


_LEAST_MASS = 1e-6  # kg
_LEAST_INERTIA = 1e-9  # kg m^2


def _repair_inertias(spec: mujoco.MjSpec) -> str:
    """Repair inertias by options of MuJoCo's compiler, and negative principal moments here.

    MuJoCo raises masses to 1e-6 kg and moments to 1e-9 kg m^2 and, where the largest moment is more
    than the sum of the others, sets all three to their mean (``boundmass``, ``boundinertia``,
    ``balanceinertia``). It refuses negative eigenvalues, which are raised to 1e-9 here.

    Returns:
        One line that names the links, without the file.
    """
    spec.compiler.balanceinertia = True
    spec.compiler.boundmass = _LEAST_MASS
    spec.compiler.boundinertia = _LEAST_INERTIA
    # Use the spec: `body.joints` raises the error of an earlier failed compilation.
    moving_bodies = {joint.parent.name for joint in spec.joints}
    shaped_bodies = {geom.parent.name for geom in spec.geoms if collides(geom)}
    names: list[str] = []
    for body in spec.bodies[1:]:  # the first is the world
        is_moving = body.name in moving_bodies
        if not body.explicitinertial:
            if is_moving and body.name not in shaped_bodies:
                names.append(body.name)  # a moving body without mass
            continue
        moments, axes = _principal_moments(body)
        if not (is_moving or body.mass or moments.any()):
            continue  # a fixed frame without mass
        is_small = moments.min() < _LEAST_INERTIA
        is_light = body.mass < _LEAST_MASS
        is_unbalanced = 2.0 * moments.max() > moments.sum()
        if is_small or is_light or is_unbalanced:
            names.append(body.name)
        if is_small and np.isfinite(body.fullinertia[0]):
            body.fullinertia = np.full(6, np.nan)
            body.inertia = np.maximum(moments, _LEAST_INERTIA)
            body.iquat = quat_multiply(np.asarray(body.iquat, np.float64), axes)
    return (
        f"masses or inertias that no body can have are repaired (at least {_LEAST_MASS:g} kg and "
        f"{_LEAST_INERTIA:g} kg m^2, balanced moments): {', '.join(names)}"
    )


def _principal_moments(body: mujoco.MjsBody) -> tuple[F64, F64]:
    """Return (3,) principal moments, and the orientation of their axes, wxyz."""
    quat = np.array([1.0, 0.0, 0.0, 0.0])
    xx, yy, zz, xy, xz, yz = np.asarray(body.fullinertia, np.float64)
    if not np.isfinite(xx):
        return np.asarray(body.inertia, np.float64), quat
    moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1.0
    mujoco.mju_mat2Quat(quat, axes.ravel())
    return moments, quat
