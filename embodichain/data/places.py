"""The places where files are kept: the user's data root, bundled assets, installed packages.

Which file a name means is decided in `lookup`; what there is to choose from in `catalog`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

__all__ = [
    "Place",
    "data_root",
    "descriptions_cache",
    "package_parents",
    "places",
    "python_package",
]

ASSETS = Path(__file__).parent / "assets"


@dataclass(frozen=True, slots=True)
class Place:
    """One folder that is searched.

    Attributes:
        label: What the folder is, for messages and listings.
        folder: The folder. It need not exist.
        prefix: First part of a name that may be left out: ``example-robot-data/robots/x`` and ``x``
            are the same file of the place whose prefix is ``example-robot-data/robots``.
    """

    label: str
    folder: Path
    prefix: str = ""

    def candidates(self, name: str) -> Iterator[Path]:
        """Yield where `name` would lie in this place, with and without the prefix."""
        if self.prefix and name.startswith(self.prefix + "/"):
            yield self.folder / name.removeprefix(self.prefix + "/")
        yield self.folder / name


def data_root() -> Path:
    """Return the user's folder of robots and objects.

    It is ``$EMBODICHAIN_DATA_ROOT``, else ``~/.cache/embodichain_data``; it need not exist.
    """
    root = os.environ.get("EMBODICHAIN_DATA_ROOT") or "~/.cache/embodichain_data"
    return Path(root).expanduser()


def places() -> list[Place]:
    """Return every place that is searched for a relative name, in order."""
    root = data_root()
    found = [
        Place("EMBODICHAIN_DATA_ROOT", root),
        Place("EMBODICHAIN_DATA_ROOT, extracted archives", root / "extract"),
        Place("bundled", ASSETS),
    ]
    for share in _share_folders():
        robots = share / "example-robot-data" / "robots"
        if robots.is_dir():
            found.append(Place("example-robot-data", robots, "example-robot-data/robots"))
    menagerie = descriptions_cache() / "mujoco_menagerie"
    found.append(Place("mujoco_menagerie", menagerie, "mujoco_menagerie"))
    return found


def package_parents() -> list[Place]:
    """Return the folders that ``package://NAME`` is looked for in, in order; all exist.

    The data root, the bundled assets, what Python packages (cmeel among them) and ROS packages
    install as data, and descriptions in the cache of robot_descriptions.
    """
    root, shares = data_root(), _share_folders()
    parents = [
        Place("EMBODICHAIN_DATA_ROOT", root),
        Place("EMBODICHAIN_DATA_ROOT, extracted archives", root / "extract"),
        Place("bundled", ASSETS),
        *(Place("data of installed packages", share) for share in shares),
        *(Place("example-robot-data", share / "example-robot-data/robots") for share in shares),
        *(Place("ROS packages", folder) for folder in _ros_folders()),
        Place("cache of robot_descriptions", descriptions_cache()),
    ]
    return [place for place in parents if place.folder.is_dir()]


def python_package(name: str) -> list[Path]:
    """Return the folders of the Python package of that name, without importing it."""
    module = name.replace("-", "_")
    if not module.isidentifier() or module == "__main__":
        return []
    spec = find_spec(module)
    return [Path(folder) for folder in (spec.submodule_search_locations or ())] if spec else []


def _share_folders() -> list[Path]:
    """Return the ``share`` folders that Python packages install data into."""
    folders = [Path(entry, "cmeel.prefix", "share") for entry in sys.path if entry]
    folders.append(Path(sys.prefix, "share"))
    return [folder for folder in dict.fromkeys(folders) if folder.is_dir()]


def _ros_folders() -> list[Path]:
    """Return the folders that hold ROS packages, from the variables that ROS sets."""
    ament = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    ros = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    return [Path(prefix, "share") for prefix in ament if prefix] + [Path(p) for p in ros if p]


def descriptions_cache() -> Path:
    """Return the cache of the robot_descriptions package, which clones mujoco_menagerie into it."""
    cache = os.environ.get("ROBOT_DESCRIPTIONS_CACHE") or "~/.cache/robot_descriptions"
    return Path(cache).expanduser()
