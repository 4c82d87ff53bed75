"""Model files into `MjSpec`: their format, their errors in one line, inertias that need repair."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import mujoco
import numpy as np

from embodichain.data import DataNotFoundError, get_data_path
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.robot_bodies import collides
from embodichain.lab.sim.compiler.urdf_files import PreparedUrdf, parse_xml, prepare_urdf
from embodichain.lab.sim.engine.mujoco_process import install_log_handler
from embodichain.lab.sim.meshes.mesh_conversion import convert_collision, reads
from embodichain.lab.sim.meshes.mesh_part import MeshError
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import quat_multiply

__all__ = [
    "MUJOCO_ERRORS",
    "ModelFile",
    "as_line",
    "compile_quietly",
    "locate",
    "read_model",
    "repair_inertias",
]

MUJOCO_ERRORS = (ValueError, RuntimeError, mujoco.FatalError)
"""What MuJoCo's bindings raise for a model it cannot parse or compile."""

_LINE = re.compile(r",? *\bline(?: number)? *[=:]? *(\d+)", re.IGNORECASE)
_ELEMENT = re.compile(r"\s*Element (?:name )?'(?P<name>[^']*)'(?:, id \d+)?")
_XML_CODE = re.compile(
    r"XML parse error \d+:\s*Error=XML_ERROR_(?P<code>\w+) ErrorID=\d+ *(?:\(\w+\))?"
)
_PREFIXES = ("Error: ", "XML Error: ", "Schema violation: ")


def as_line(
    error: Exception, line_of: Callable[[int], int | None] | None = None
) -> tuple[str, int | None]:
    """Return a MuJoCo error as one line of text, and the line of the file it names, if any.

    Args:
        error: What MuJoCo raised.
        line_of: Maps a line of the text MuJoCo read to one of the user's file; None: the same.
    """
    text = str(error).strip()
    found = _LINE.search(text)
    line = int(found[1]) if found else None
    if line is not None and line_of is not None:
        line = line_of(line)
    text = _LINE.sub("", text)
    text = _XML_CODE.sub(lambda m: m["code"].replace("_", " ").lower(), text)
    text = _ELEMENT.sub(lambda m: f" (element {m['name']!r})" if m["name"] else "", text)
    for prefix in _PREFIXES:
        text = text.removeprefix(prefix)
    return " ".join(text.split()).rstrip(" :"), line


_LEAST_MASS = 1e-6  # kg
_LEAST_INERTIA = 1e-9  # kg m^2


def repair_inertias(spec: mujoco.MjSpec) -> str:
    """Let MuJoCo's compiler repair inertias, and principal moments below zero here.

    MuJoCo raises masses to 1e-6 kg and moments to 1e-9 kg m^2 and, where the largest moment is more
    than the sum of the others, makes all three their mean (``boundmass``, ``boundinertia``,
    ``balanceinertia``). It refuses a tensor with a negative eigenvalue: that is raised to 1e-9.

    Args:
        spec: Edited in place.

    Returns:
        One line that names the links, without the file.
    """
    spec.compiler.balanceinertia = True
    spec.compiler.boundmass = _LEAST_MASS
    spec.compiler.boundinertia = _LEAST_INERTIA
    # By way of the spec: `body.joints` raises the error of a compilation that failed before.
    moving = {joint.parent.name for joint in spec.joints}
    shaped = {geom.parent.name for geom in spec.geoms if collides(geom)}
    names = []
    for body in spec.bodies[1:]:  # the first is the world
        if not body.explicitinertial:
            if body.name in moving - shaped:
                names.append(body.name)  # it moves, and weighs nothing
            continue
        moments, axes = _principal(body)
        if not (body.name in moving or body.mass or moments.any()):
            continue  # a frame without mass, which is fixed
        low = moments.min() < _LEAST_INERTIA
        if low or body.mass < _LEAST_MASS or 2.0 * moments.max() > moments.sum():
            names.append(body.name)
        if low and np.isfinite(body.fullinertia[0]):
            body.fullinertia = np.full(6, np.nan)
            body.inertia = np.maximum(moments, _LEAST_INERTIA)
            body.iquat = quat_multiply(np.asarray(body.iquat, np.float64), axes)
    return (
        f"masses or inertias that no body can have are repaired (at least {_LEAST_MASS:g} kg and "
        f"{_LEAST_INERTIA:g} kg m^2, balanced moments): {', '.join(names)}"
    )


def _principal(body: mujoco.MjsBody) -> tuple[F64, F64]:
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
        last_link: The last link in the order of a URDF, which is not that of the tree.
        notes: What a user should be told, one line each.
    """

    path: Path
    is_urdf: bool
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    velocity_limits: dict[str, float] = field(default_factory=dict)
    last_link: str = ""
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
    try:
        root, line_of = parse_xml(source)
    except expat.ExpatError as error:
        message = str(error).split(":")[0]
        raise ConfigError(f"{path}:{error.lineno}: not well-formed XML: {message}") from error
    if root.tag == "mujoco":
        return _read_mjcf(path)
    if root.tag != "robot":
        raise ConfigError(
            f"{path}: neither URDF nor MJCF: its root is <{root.tag}>, not <robot> or <mujoco>"
        )
    return _read_urdf(path, prepare_urdf(path, root, line_of, convex_parts))


def compile_quietly(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile without MuJoCo's Python warnings, which repeat what we report ourselves."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return spec.compile()


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


def _read_urdf(path: Path, urdf: PreparedUrdf) -> ModelFile:
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
    return ModelFile(path, True, spec, model, urdf.velocity_limits, urdf.last_link, notes)


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
