"""`fault_of`: why a robot's file cannot load, as far as its text shows."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

from embodichain.data.lookup import resolve_package_uri
from embodichain.utils.errors import DataNotFoundError

__all__ = ["fault_of", "unexpanded"]

_UNEXPANDED = re.compile(r"\$\([^)]*\)?|\$\{[^}]*\}?")
_UNREAD = ("gazebo", "transmission")
"""Elements of a URDF that MuJoCo ignores, with what is in them."""


def fault_of(path: Path) -> str:
    """Return why a URDF or MJCF file cannot load, as far as its text shows, or ``""``."""
    try:
        root = ET.fromstring(path.read_bytes())
    except ET.ParseError as error:
        return f"not well-formed XML: {error}"
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    if root.tag == "mujoco":
        return _fault_of_mjcf(root)
    return _fault_of_urdf(path, root)


def _fault_of_mjcf(root: ET.Element) -> str:
    if root.find("worldbody") is not None or root.find(".//include") is not None:
        return ""
    return "it has no <worldbody>: a part that other files include"


def _fault_of_urdf(path: Path, root: ET.Element) -> str:
    if any(unexpanded(root)):
        return "xacro has to be expanded to URDF first"
    if root.find("link") is None:
        return "the robot has no <link>"
    names = {mesh.get("filename", "") for mesh in root.iterfind("link/*/geometry/mesh")}
    missing = sorted(name for name in names if not _exists(name, path))
    if not missing:
        return ""
    return f"{len(missing)} of {len(names)} mesh files are missing, such as {missing[0]}"


def unexpanded(root: ET.Element) -> Iterator[tuple[ET.Element, str]]:
    """Yield elements of a URDF with something that xacro or roslaunch replaces, and what it is."""
    if "xacro" in str(root.tag):
        yield root, f"<{root.tag}>"
    for name, value in root.attrib.items():
        match = _UNEXPANDED.search(value)
        if match is not None:
            yield root, f'{match[0]} in <{root.tag} {name}="{value}">'
        elif "xacro:" in name and not name.startswith("xmlns"):
            yield root, f"{name} in <{root.tag}>"
    for child in root:
        if child.tag not in _UNREAD:
            yield from unexpanded(child)


def _exists(name: str, path: Path) -> bool:
    try:
        resolve_package_uri(name, near=path)
    except (DataNotFoundError, ValueError):
        return False
    return True
