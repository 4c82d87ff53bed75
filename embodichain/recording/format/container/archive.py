"""The scene as MJZ, an archive of the XML and the files it names, for any version of MuJoCo.

MuJoCo's encoder is not used because it keeps absolute paths of the recording machine. The XML has
6 digits, enough for viewing and approximate simulation; `model.mjb` is exact.
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree

import mujoco

from embodichain.recording.format.container.unpacking import unpack_zip
from embodichain.recording.format.log_error import DamageError

__all__ = ["load_mjz", "scene_archive"]

_FOLDERS = ("assetdir", "meshdir", "texturedir")
_ROOT = "model.xml"


def scene_archive(spec: mujoco.MjSpec) -> bytes:
    """Pack a compiled spec and every file it names; paths inside are relative.

    Raises:
        OSError: If a file is missing.
    """
    root = ElementTree.fromstring(spec.to_xml())
    folders = _remove_folders(root)
    packed: dict[str, bytes] = {}  # name in the archive to content
    renamed: dict[str, str] = {}  # name in the spec to name in the archive
    for element in root.iter():
        for key, name in element.attrib.items():
            if not key.startswith("file") or element.tag == "compiler":
                continue
            if name not in renamed:
                inside = f"assets/{len(renamed):03d}_{PurePosixPath(name).name}"
                renamed[name] = inside
                packed[inside] = _content(spec, element.tag, name, folders)
            element.set(key, renamed[name])
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr(_ROOT, ElementTree.tostring(root, encoding="unicode"))
        for inside, data in packed.items():
            archive.writestr(inside, data)
    return buffer.getvalue()


def _remove_folders(root: ElementTree.Element) -> dict[str, str]:
    """Remove the folders that file names are relative to, and return them."""
    folders: dict[str, str] = {}
    for compiler in root.iter("compiler"):
        for key in _FOLDERS:
            if key in compiler.attrib:
                folders[key] = compiler.attrib.pop(key)
    return folders


def _content(spec: mujoco.MjSpec, tag: str, name: str, folders: dict[str, str]) -> bytes:
    if name in spec.assets:
        data: bytes = spec.assets[name]
        return data
    kind = "texturedir" if tag == "texture" else "meshdir"
    folder = folders.get(kind, folders.get("assetdir"))
    path = Path(spec.modelfiledir or "", folder or "", name)
    return path.read_bytes()


def load_mjz(data: bytes, stated: int | None = None) -> mujoco.MjModel:
    """Compile an archive from `scene_archive`.

    Args:
        data: The archive.
        stated: The size to which it unpacks; None if it is not known.

    Raises:
        ValueError: If it is not such an archive, is larger, or does not compile.
    """
    try:
        files = unpack_zip(data, stated)
        root = files.pop(_ROOT)
    except (DamageError, KeyError) as error:
        raise ValueError(f"not an MJZ archive with a {_ROOT}: {error}") from error
    return mujoco.MjModel.from_xml_string(root.decode(), files)
