"""Lists the robots and other files that can be loaded.

Files are recognized by name and first bytes; none is parsed.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from embodichain.data.places import (
    PREFIX,
    Place,
    main_file,
    menagerie_models,
    places,
    robot_files,
)

__all__ = ["Asset", "list_assets", "list_robots"]

_MODEL_DEPTH = 4  # folder depth searched below a place: deeper folders contain meshes
_MODEL_SUFFIXES = {".urdf", ".xml", ".mjcf"}
_HEAD_BYTES = 4096


@dataclass(frozen=True, slots=True)
class Asset:
    """A file that `get_data_path` finds.

    Attributes:
        name: The value for ``fpath``.
        path: The file.
        source: The place it is in: ``bundled``, ``example-robot-data``, ...
        format: ``urdf`` or ``mjcf`` for a model, else the suffix without its dot.
    """

    name: str
    path: Path
    source: str
    format: str


def list_robots() -> list[Asset]:
    """Return every robot model (URDF or MJCF), by place and name; Menagerie's come last.

    A model with the name of an earlier one is left out: `get_data_path` would not find it.
    """
    own = (_models(place) for place in places() if place.label != "mujoco_menagerie")
    return list(_unique(itertools.chain(own, [_menagerie()])))


def list_assets() -> list[Asset]:
    """Return all files of the data root and bundled assets, and all robots of packages."""
    own = [place for place in places() if not place.prefix]
    robots = [asset for asset in list_robots() if asset.source not in {p.label for p in own}]
    return [*_unique(_files(place) for place in own), *robots]


def _unique(groups: Iterable[Iterable[Asset]]) -> Iterator[Asset]:
    """Yield the first asset of each name in all groups."""
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
            # Menagerie has a scene.xml beside each robot: the robot with floor and lights
            if kind and not path.stem.startswith("scene"):
                yield Asset(path.relative_to(place.folder).as_posix(), path, place.label, kind)


def _menagerie() -> Iterator[Asset]:
    """Yield Menagerie's robots: main files by the model's name, others also by file name."""
    for name, folder in menagerie_models().items():
        main = main_file(name, folder)
        for path in robot_files(folder):
            if _model_format(path):
                file = "" if path == main else f"/{path.name}"
                yield Asset(f"{PREFIX}{name}{file}", path.absolute(), "menagerie", "mjcf")


def _files(place: Place) -> Iterator[Asset]:
    """Yield every file of a place."""
    for path in _walk(place.folder, depth=16):
        kind = _model_format(path) if path.suffix.lower() in _MODEL_SUFFIXES else ""
        kind = kind or path.suffix.lower().removeprefix(".")
        yield Asset(path.relative_to(place.folder).as_posix(), path, place.label, kind)


def _walk(folder: Path, depth: int) -> Iterator[Path]:
    """Yield the files at most `depth` folders below `folder`, sorted, without hidden ones."""
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
    """Return ``urdf`` or ``mjcf``; an empty string for other files."""
    if path.suffix.lower() == ".urdf":
        return "urdf"
    with path.open("rb") as file:
        return "mjcf" if b"<mujoco" in file.read(_HEAD_BYTES) else ""
