"""Finds files by name: `get_data_path` for robots, `resolve_package_uri` for their meshes.

`places` defines the places. Order for a relative name: the folder of the file that refers to it,
working directory, data root, bundled assets, installed packages, cached models.
"""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from urllib.parse import unquote, urlsplit

from embodichain.data.catalog import list_robots
from embodichain.data.places import (
    HOW,
    PREFIX,
    DataNotFoundError,
    find_model,
    menagerie_models,
    package_parents,
    places,
    python_package,
)
from embodichain.utils.suggest import closest

__all__ = ["fault_of", "get_data_path", "resolve_package_uri"]

# Some files have package:///NAME/x or package:/NAME/x instead of package://NAME/x.
_PACKAGE = re.compile(r"package:/+(?P<package>[^/]+)(?:/(?P<rest>.*))?$")

Searched = list[tuple[str, str]]


def get_data_path(name: str | os.PathLike[str], near: str | os.PathLike[str] | None = None) -> str:
    """Return the absolute path of a robot or object file (or folder).

    `name` is an absolute path, ``package://NAME/...`` (see `resolve_package_uri`),
    ``menagerie:NAME`` (see `places.find_model`), or a relative path. The latter is searched in the
    folder of `near`, the working directory, ``$EMBODICHAIN_DATA_ROOT`` (by default
    ``~/.cache/embodichain_data``), the assets bundled with this package, example-robot-data if
    installed, and a mujoco_menagerie cached by robot_descriptions. The first match is returned.

    Args:
        name: E.g. ``UniversalRobots/UR10/UR10.urdf``, ``panda_description/urdf/panda.urdf``,
            ``~/robots/mine.urdf``.
        near: The file that refers to it, or its folder; or None.

    Raises:
        DataNotFoundError: If it is not found. The message lists the places searched, the closest
            names, and how to get it.
        ValueError: If `name` is empty.
    """
    text = os.fspath(name)
    if not text:
        raise ValueError("name is empty: expected the path or name of a robot or object file")
    if _PACKAGE.match(text):
        return resolve_package_uri(text, near)
    if text.startswith(PREFIX):
        return str(find_model(text))
    path = Path(text).expanduser()
    if path.is_absolute():
        return _first_existing(text, [("absolute path", path)])
    tried: list[tuple[str, Path]] = []
    if near is not None:
        tried.append(("beside the file that names it", _folder_of(near) / path))
    tried.append(("working directory", Path.cwd() / path))
    for place in places():
        tried += [(place.label, candidate) for candidate in place.candidates(path.as_posix())]
    return _first_existing(text, tried)


def resolve_package_uri(uri: str, near: str | os.PathLike[str] | None = None) -> str:
    """Return the absolute path of a file that a model refers to, such as a mesh.

    Accepts ``package://NAME/rest``, ``file:///abs``, absolute paths, and paths relative to `near`.
    A package is searched among the folders above `near` and their siblings (for a model in
    ``NAME/urdf/``, its own ``NAME``), in `embodichain.data.places.package_parents`, and as a Python
    package. The first that contains the file is used.

    Args:
        uri: The reference in the model.
        near: The model file, or its folder; None is the working directory.

    Raises:
        DataNotFoundError: If no place contains the file.
        ValueError: If `uri` is empty or has a scheme other than ``package`` or ``file``.
    """
    if not uri:
        raise ValueError("empty file name: expected package://NAME/..., file:///... or a path")
    folder = Path.cwd() if near is None else _folder_of(near)
    match = _PACKAGE.match(uri)
    if match:
        return _in_package(uri, match["package"], match["rest"] or "", folder)
    scheme = urlsplit(uri).scheme if "://" in uri or uri.startswith("file:") else ""
    if scheme not in ("", "file"):
        raise ValueError(f"{uri!r}: scheme {scheme!r} is not known; use package:// or file://")
    path = Path(unquote(urlsplit(uri).path) if scheme else uri).expanduser()
    label = "absolute path" if path.is_absolute() else "relative to the model file"
    return _first_existing(uri, [(label, folder / path)])


def _in_package(uri: str, package: str, rest: str, folder: Path) -> str:
    """Return the file `rest` of a package, searched above `folder` first."""
    tried = []
    for parent in (folder, *folder.parents):
        if parent.name == package:
            tried.append(("package above the model file", parent / rest))
        elif (parent / package).is_dir():
            tried.append(("package beside the model file", parent / package / rest))
    parents = package_parents()
    tried += [(place.label, place.folder / package / rest) for place in parents]
    tried += [("Python package", found / rest) for found in python_package(package)]
    return _first_existing(uri, tried)


def _folder_of(near: str | os.PathLike[str]) -> Path:
    """Return the absolute path of a folder, or of a file's folder."""
    path = Path(near).expanduser().absolute()
    return path if path.is_dir() else path.parent


def _first_existing(name: str, tried: list[tuple[str, Path]]) -> str:
    """Return the first existing path, without ``..``; else raise with all that were tried."""
    for _, path in tried:
        if path.exists():
            return os.path.abspath(path)
    searched: Searched = [(label, os.path.abspath(path)) for label, path in tried]
    raise DataNotFoundError(name, searched, _closest_names(name, tried), _advice(name))


def _closest_names(name: str, tried: list[tuple[str, Path]]) -> list[str]:
    """Return existing names similar to `name`, in full, by file name, or in its folder."""
    match = _PACKAGE.match(name)
    if match:
        return _closest_packages(match["package"], match["rest"] or "", tried)
    robots = [robot.name for robot in list_robots()]
    found = closest(name, robots, n=2, cutoff=0.75)
    stem = Path(name).stem.casefold()
    found += [robot for robot in robots if Path(robot).stem.casefold() == stem]
    found += [str(Path(name).parent / sibling) for sibling in _siblings(tried)]
    if not found:
        by_file = {Path(robot).name: robot for robot in robots}
        found = [by_file[file] for file in closest(Path(name).name, by_file, n=1, cutoff=0.7)]
    return list(dict.fromkeys(found))[:3]


def _closest_packages(package: str, rest: str, tried: list[tuple[str, Path]]) -> list[str]:
    """Return existing URIs similar to ``package://<package>/<rest>``."""
    base = f"package://{package}"
    found = [f"{base}/{Path(rest).parent / sibling}" for sibling in _siblings(tried)]
    if not found:
        entries = [entry for place in package_parents() for entry in place.folder.iterdir()]
        packages = [entry.name for entry in entries if entry.is_dir()]
        found = [f"package://{other}/{rest}" for other in closest(package, packages)]
    return list(dict.fromkeys(found))[:3]


def _siblings(tried: list[tuple[str, Path]]) -> list[str]:
    """Return similar names in the folders of the tried paths."""
    folders = [path for _, path in tried if path.parent.is_dir()]
    return [
        name
        for path in folders
        for name in closest(path.name, (entry.name for entry in path.parent.iterdir()))
    ]


def _advice(name: str) -> str:
    """Return the command that would provide `name`, guessed from the name."""
    installed = {place.label: place for place in places()}
    if "menagerie" in name and not menagerie_models():
        return HOW
    if "example-robot-data" not in installed:
        return (
            'More robots: `pip install "embodichain[robots]"`. '
            "What is here: `embodichain list robots`."
        )
    return "What is here: `embodichain list robots`. Your own files: $EMBODICHAIN_DATA_ROOT."


# -- why a model cannot load ----------------------------------------------------------------------


def fault_of(path: Path) -> str:
    """Return why a URDF or MJCF file cannot load, as far as its text shows, or ``""``."""
    try:
        root = ET.fromstring(path.read_bytes())
    except ET.ParseError as error:
        return f"not well-formed XML: {error}"
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    return _of_mjcf(root) if root.tag == "mujoco" else _of_urdf(path, root)


def _of_mjcf(root: ET.Element) -> str:
    whole = root.find("worldbody") is not None or root.find(".//include") is not None
    return "" if whole else "it has no <worldbody>: a part that other files include"


def _of_urdf(path: Path, root: ET.Element) -> str:
    if any("xacro" in str(element.tag) for element in root.iter()):
        return "xacro has to be expanded to URDF first"
    if root.find("link") is None:
        return "the robot has no <link>"
    names = {mesh.get("filename", "") for mesh in root.iterfind("link/*/geometry/mesh")}
    missing = sorted(name for name in names if not _exists(name, path))
    if not missing:
        return ""
    return f"{len(missing)} of {len(names)} mesh files are missing, such as {missing[0]}"


def _exists(name: str, path: Path) -> bool:
    try:
        resolve_package_uri(name, near=path)
    except (DataNotFoundError, ValueError):
        return False
    return True
