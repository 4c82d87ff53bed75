"""What there is to load: robots and other files of every place, by listing folders.

Files are told apart by name and by their first bytes; none is parsed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from embodichain.data.places import Place, places

__all__ = ["Asset", "list_assets", "list_robots"]

_MODEL_DEPTH = 4  # folders below a place that are looked into: deeper ones hold meshes
_MODEL_SUFFIXES = {".urdf", ".xml", ".mjcf"}
_HEAD_BYTES = 4096


@dataclass(frozen=True, slots=True)
class Asset:
    """One file that `get_data_path` finds.

    Attributes:
        name: What to write as ``fpath``.
        path: The file.
        source: The place it lies in: ``bundled``, ``example-robot-data``, ...
        format: ``urdf`` or ``mjcf`` for a model, else the suffix without its dot.
    """

    name: str
    path: Path
    source: str
    format: str


def list_robots() -> list[Asset]:
    """Return every robot model (URDF or MJCF), sorted by place and name.

    A name that a place before it already has is left out, as `get_data_path` would not find it.
    """
    return list(_unique(_models(place) for place in places()))


def list_assets() -> list[Asset]:
    """Return every file of the data root and the bundled assets, and all robots of the packages."""
    own = [place for place in places() if not place.prefix]
    robots = [asset for asset in list_robots() if asset.source not in {p.label for p in own}]
    return [*_unique(_files(place) for place in own), *robots]


def _unique(groups: Iterator[Iterator[Asset]]) -> Iterator[Asset]:
    """Yield the assets of all groups, the first of each name."""
    seen: set[str] = set()
    for group in groups:
        for asset in group:
            if asset.name not in seen:
                seen.add(asset.name)
                yield asset


def _models(place: Place) -> Iterator[Asset]:
    """Yield the URDF and MJCF models of a place."""
    for path in _walk(place.folder, _MODEL_DEPTH):
        if path.suffix.lower() in _MODEL_SUFFIXES:
            kind = _model_format(path)
            # menagerie keeps scene.xml beside each robot: a floor and lights that include it
            if kind and not path.stem.startswith("scene"):
                yield Asset(path.relative_to(place.folder).as_posix(), path, place.label, kind)


def _files(place: Place) -> Iterator[Asset]:
    """Yield every file of a place."""
    for path in _walk(place.folder, depth=16):
        kind = _model_format(path) if path.suffix.lower() in _MODEL_SUFFIXES else ""
        kind = kind or path.suffix.lower().removeprefix(".")
        yield Asset(path.relative_to(place.folder).as_posix(), path, place.label, kind)


def _walk(folder: Path, depth: int) -> Iterator[Path]:
    """Yield the files below `folder`, at most `depth` folders down, sorted, no hidden ones."""
    if not folder.is_dir():
        return
    for entry in sorted(folder.iterdir()):
        if entry.name.startswith("."):
            continue
        if entry.is_dir():
            if depth > 0:
                yield from _walk(entry, depth - 1)
        elif entry.is_file():
            yield entry


def _model_format(path: Path) -> str:
    """Return ``urdf``, ``mjcf``, or an empty string when the file is neither."""
    if path.suffix.lower() == ".urdf":
        return "urdf"
    with path.open("rb") as file:
        return "mjcf" if b"<mujoco" in file.read(_HEAD_BYTES) else ""
