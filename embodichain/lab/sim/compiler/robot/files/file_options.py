"""`given_options`: the physics options that a robot's or a scene's file gives.

`MjSpec` does not say whether a value was given or is MuJoCo's default: this reads it from the XML.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

from embodichain.lab.sim.compiler.robot.files.xml_text import XmlError, parse_xml

__all__ = ["given_options"]

_OPTIONS = {"actuatorgroupdisable": "disableactuator"}
"""Attributes of ``<option>`` that have another name in MuJoCo's `mjOption`."""


def given_options(root: ET.Element, folder: Path) -> frozenset[str]:
    """Return the names of the options in all ``<option>`` elements, and ``flag.NAME`` of flags.

    Args:
        root: The file's root element, of an MJCF or of a URDF with MuJoCo's extension.
        folder: The file's folder, in which included files are looked up.
    """
    names: set[str] = set()
    for element in _option_elements(root, folder, set()):
        names |= {_OPTIONS.get(name, name) for name in element.attrib}
        for flag in element.iter("flag"):
            names |= {f"flag.{name}" for name in flag.attrib}
    return frozenset(names)


def _option_elements(root: ET.Element, folder: Path, seen: set[Path]) -> Iterator[ET.Element]:
    """Yield the ``<option>`` elements of a file and of those that it includes."""
    yield from root.iter("option")
    for include in root.iter("include"):
        path = (folder / include.get("file", "")).resolve()
        if path in seen or not path.is_file():
            continue
        seen.add(path)
        try:
            inner, _ = parse_xml(path.read_bytes())
        except XmlError:
            continue  # MuJoCo's reader is more lenient; its options then count if not its defaults
        yield from _option_elements(inner, folder, seen)
