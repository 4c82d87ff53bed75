"""Model files into `MjSpec`: which format, where it lies, what is wrong with it.

What the spec then becomes in a scene is decided in `articulation`.
"""

from __future__ import annotations

import re
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import mujoco

from embodichain.data import DataNotFoundError, get_data_path
from embodichain.lab.sim.compiler.inertia_repair import repair_inertias
from embodichain.lab.sim.compiler.messages import MUJOCO_ERRORS, as_line
from embodichain.lab.sim.compiler.urdf import PreparedUrdf, prepare_urdf
from embodichain.lab.sim.engine.mujoco_process import install_log_handler
from embodichain.lab.sim.meshes.conversion import convert_collision, reads
from embodichain.lab.sim.meshes.part import MeshError
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["ModelFile", "compile_quietly", "locate", "read_model"]

_FLAT = re.compile(r"mesh volume is too small: (\S+)")
_SHELL = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL


@dataclass
class ModelFile:
    """A robot file as MuJoCo sees it.

    Attributes:
        path: Where it lies.
        is_urdf: URDF, else MJCF.
        spec: Parsed, not edited; it compiles.
        model: Compiled as it is in the file.
        velocity_limits: Joint name -> limit; URDF only.
        notes: What a user should be told, one line each.
    """

    path: Path
    is_urdf: bool
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    velocity_limits: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def locate(fpath: str | None) -> Path:
    """Return where a file lies.

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
        convex_parts: Split collision meshes of a URDF into convex parts.

    Raises:
        ConfigError: If it is malformed; names the file and, where known, the line.
    """
    install_log_handler()
    try:
        source = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    root = _parse_xml(path, source)
    if root.tag == "mujoco":
        return _read_mjcf(path)
    if root.tag != "robot":
        raise ConfigError(
            f"{path}: neither URDF nor MJCF: its root is <{root.tag}>, not <robot> or <mujoco>"
        )
    return _read_urdf(path, root, source, convex_parts)


def compile_quietly(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile without MuJoCo's Python warnings, which repeat what we report ourselves."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return spec.compile()


def _parse_xml(path: Path, source: bytes) -> ET.Element:
    try:
        return ET.fromstring(source)
    except ET.ParseError as error:
        line = error.position[0]
        raise ConfigError(
            f"{path}:{line}: not well-formed XML: {str(error).split(':')[0]}"
        ) from error


def _fail(path: Path, error: Exception, urdf: PreparedUrdf | None = None) -> ConfigError:
    text, line = as_line(error, urdf.source_line if urdf else None)
    where = f"{path}:{line}" if line else str(path)
    return ConfigError([Problem("", f"{where}: {text}")])


def _read_mjcf(path: Path) -> ModelFile:
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compiler.fusestatic = False  # tool frames keep their bodies
        _name_elements(spec)
        _make_absolute(spec, path.parent)
        notes = [f"{path}: {note}" for note in _convert_meshes(spec)]
        return ModelFile(path, False, spec, compile_quietly(spec), notes=notes)
    except (MeshError, *MUJOCO_ERRORS) as error:
        raise _fail(path, error) from error


def _make_absolute(spec: mujoco.MjSpec, folder: Path) -> None:
    """Make file names of assets absolute, so that two files with a ``part.stl`` stay apart."""
    for directory, assets in (
        (spec.meshdir, spec.meshes),
        (spec.texturedir, spec.textures),
        (spec.meshdir, spec.hfields),
    ):
        for asset in assets:
            # What an <include> in another folder names is left to MuJoCo.
            path = folder / directory / asset.file
            if asset.file and path.is_file():
                asset.file = str(path.resolve())


def _convert_meshes(spec: mujoco.MjSpec) -> Iterator[str]:
    """Convert the meshes that MuJoCo does not read, such as ASCII STL; their shapes alone."""
    for mesh in spec.meshes:
        file = Path(mesh.file)
        if mesh.file and file.is_file() and not reads(file):
            mesh.file = str(convert_collision(file))
            yield f"{file}: not a mesh that MuJoCo reads: converted, its shape alone"


def _name_elements(spec: mujoco.MjSpec) -> None:
    """Name bodies, joints, geoms, actuators and cameras that the file leaves without a name."""
    for what, elements in (
        ("body", spec.bodies),
        ("joint", spec.joints),
        ("geom", spec.geoms),
        ("actuator", spec.actuators),
        ("camera", spec.cameras),
    ):
        taken = {element.name for element in elements}
        for number, element in enumerate(elements):
            if not element.name:
                name = f"{what}_{number}"
                while name in taken:
                    name += "_"
                element.name = name
                taken.add(name)


def _read_urdf(path: Path, root: ET.Element, source: bytes, convex_parts: bool) -> ModelFile:
    urdf = prepare_urdf(path, root, source, convex_parts)
    try:
        spec = mujoco.MjSpec.from_string(urdf.text)
    except MUJOCO_ERRORS as error:
        raise _fail(path, error, urdf) from error
    _name_elements(spec)
    urdf.meshes.finish(spec)
    notes = [f"{path}: {note}" for note in urdf.meshes.notes]
    if urdf.estimated:
        notes.append(
            f"{path}: links {', '.join(urdf.estimated)} have no <inertial>: taken from their "
            "shapes at 1000 kg/m^3"
        )
    for link in urdf.massless:
        body = spec.body(link)
        for geom in body.geoms if body is not None else ():
            geom.mass, geom.density = 0.0, 0.0
    model = _compile_repaired(urdf, path, spec, notes)
    return ModelFile(path, True, spec, model, urdf.velocity_limits, notes)


def _compile_repaired(
    urdf: PreparedUrdf, path: Path, spec: mujoco.MjSpec, notes: list[str]
) -> mujoco.MjModel:
    """Compile; meshes without volume and inertias that cannot be are repaired, which notes say."""
    repaired = False
    while True:
        try:
            return compile_quietly(spec)
        except MUJOCO_ERRORS as error:
            text, _ = as_line(error)
            flat = _FLAT.search(text)
            mesh = spec.mesh(flat[1]) if flat else None
            if mesh is not None and mesh.inertia != _SHELL:
                mesh.inertia = _SHELL
                notes.append(f"{path}: mesh {mesh.name!r} has no volume: taken as a shell")
            elif not repaired and ("inertia" in text or "mjMINVAL" in text):
                repaired = True
                notes.append(f"{path}: {repair_inertias(spec)}")
            else:
                raise _fail(path, error, urdf) from error
