"""The places of robot and object files: the user's data root, bundled assets, installed packages.

Models of MuJoCo Menagerie, by folder name (``menagerie:unitree_go2``), come from a checkout
(``$MENAGERIE_PATH``) or from the caches of the packages mujoco-menagerie and robot_descriptions.
Nothing is downloaded here, and neither package is imported. `lookup` finds a file by name,
`catalog` lists all files.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from embodichain.utils.errors import EmbodichainError
from embodichain.utils.suggest import closest

__all__ = [
    "HOW",
    "PREFIX",
    "DataNotFoundError",
    "Place",
    "data_root",
    "find_model",
    "main_file",
    "menagerie_models",
    "package_parents",
    "places",
    "python_package",
    "robot_files",
]

ASSETS = Path(__file__).parent / "assets"
PREFIX = "menagerie:"
HOW = (
    "MuJoCo Menagerie: set MENAGERIE_PATH to a checkout of it, or "
    "`pip install mujoco-menagerie && mujoco-menagerie prefetch unitree_go2`"
)
"""How to install it."""

_COMPLETE = ".complete"  # mujoco-menagerie writes it last
_CACHE = "cache of mujoco-menagerie"


class DataNotFoundError(EmbodichainError, FileNotFoundError):
    """A robot or object file was not found in any place.

    Args:
        name: The requested name.
        searched: Every path that was tried, in order, each with its place.
        closest: The most similar existing names, best first.
        command: How to get the file.
    """

    def __init__(
        self,
        name: str,
        searched: Sequence[tuple[str, str]],
        closest: Sequence[str] = (),
        command: str = "",
    ) -> None:
        self.name = name
        self.searched = tuple(searched)
        self.closest = tuple(closest)
        self.command = command
        lines = [f"no file or folder for {name!r}. Searched, in this order:"]
        lines += [f"  {path}  ({place})" for place, path in self.searched]
        if self.closest:
            lines.append("Did you mean " + " or ".join(repr(match) for match in self.closest) + "?")
        if command:
            lines.append(command)
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle with all four arguments, not only the message as by default."""
        return type(self), (self.name, self.searched, self.closest, self.command)


@dataclass(frozen=True, slots=True)
class Place:
    """A folder that is searched.

    Attributes:
        label: Description for messages and listings.
        folder: The folder. It need not exist.
        prefix: Optional first part of a name: ``example-robot-data/robots/x`` and ``x``
            are the same file of a place with the prefix ``example-robot-data/robots``.
    """

    label: str
    folder: Path
    prefix: str = ""

    def candidates(self, name: str) -> Iterator[Path]:
        """Yield the possible paths of `name` in this place, with and without the prefix."""
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
    """Return the places searched for a relative name, in order."""
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
    menagerie = _descriptions_cache() / "mujoco_menagerie"
    found.append(Place("mujoco_menagerie", menagerie, "mujoco_menagerie"))
    return found


def package_parents() -> list[Place]:
    """Return the existing folders that are searched for ``package://NAME``, in order.

    The data root, the bundled assets, data folders of Python packages (cmeel among them) and ROS
    packages, and the cache of robot_descriptions.
    """
    root, shares = data_root(), _share_folders()
    parents = [
        Place("EMBODICHAIN_DATA_ROOT", root),
        Place("EMBODICHAIN_DATA_ROOT, extracted archives", root / "extract"),
        Place("bundled", ASSETS),
        *(Place("data of installed packages", share) for share in shares),
        *(Place("example-robot-data", share / "example-robot-data/robots") for share in shares),
        *(Place("ROS packages", folder) for folder in _ros_folders()),
        Place("cache of robot_descriptions", _descriptions_cache()),
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
    """Return the folders with ROS packages, from the variables that ROS sets."""
    ament = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    ros = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    return [Path(prefix, "share") for prefix in ament if prefix] + [Path(p) for p in ros if p]


def _descriptions_cache() -> Path:
    """Return the cache of the robot_descriptions package, which clones mujoco_menagerie into it."""
    cache = os.environ.get("ROBOT_DESCRIPTIONS_CACHE") or "~/.cache/robot_descriptions"
    return Path(cache).expanduser()


# -- MuJoCo Menagerie -----------------------------------------------------------------------------


def menagerie_models() -> dict[str, Path]:
    """Return the folder of every available model, by name; the first place takes precedence."""
    found: dict[str, Path] = {}
    for name, folder in _menagerie_folders():
        found.setdefault(name, folder)
    return dict(sorted(found.items()))


def find_model(text: str) -> Path:
    """Return the file of ``menagerie:NAME`` or ``menagerie:NAME/FILE.xml``.

    Raises:
        DataNotFoundError: If there is no such model or file, or NAME has several files and none is
            the main one; lists the choices.
    """
    name, _, file = text.removeprefix(PREFIX).partition("/")
    models = menagerie_models()
    if name not in models:
        searched = [(label, str(folder)) for label, folder in _menagerie_places()]
        near = [PREFIX + match for match in closest(name, models)]
        advice = (
            f"{len(models)} of its models are here: `embodichain list robots`" if models else HOW
        )
        raise DataNotFoundError(text, searched, near, advice)
    folder = models[name]
    path = folder / file if file else main_file(name, folder)
    if path is not None and path.is_file():
        return path.absolute()
    choices = [f"{PREFIX}{name}/{model.name}" for model in robot_files(folder)]
    advice = "The model has several robots: name one of its files." if not file else ""
    raise DataNotFoundError(text, [("model folder", str(folder))], choices, advice)


def main_file(name: str, folder: Path) -> Path | None:
    """Return the XML file that a model's name refers to; None if ambiguous.

    It is the file named like the folder without the maker (``go2.xml`` of ``unitree_go2``), or the
    only robot file.
    """
    files = robot_files(folder)
    named = [f for f in files if name == f.stem or name.endswith(f"_{f.stem}")]
    if named:
        return max(named, key=lambda f: len(f.stem))
    return files[0] if len(files) == 1 else None


def robot_files(folder: Path) -> list[Path]:
    """Return the XML files of a model that are not scenes (a robot with a floor and lights)."""
    return sorted(f for f in folder.glob("*.xml") if not f.stem.startswith("scene"))


def _menagerie_folders() -> Iterator[tuple[str, Path]]:
    for label, place in _menagerie_places():
        if not place.is_dir():
            continue
        for folder in sorted(place.iterdir()):
            if label == _CACHE:
                if (folder / _COMPLETE).is_file():
                    yield folder.name.rpartition("-")[0], folder  # NAME-DIGEST
            elif folder.is_dir() and robot_files(folder):
                yield folder.name, folder


def _menagerie_places() -> list[tuple[str, Path]]:
    """Return the folders searched for models, in order; they need not exist."""
    places = []
    for variable in ("MENAGERIE_PATH", "MENAGERIE_ROOT"):  # ours, and mujoco-menagerie's
        if root := os.environ.get(variable):
            places.append((variable, Path(root).expanduser()))
    own = os.environ.get("MENAGERIE_CACHE_DIR")
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    cache = Path(own) if own else Path(base, "mujoco_menagerie")
    places.append((_CACHE, cache.expanduser() / "models"))
    places.append(("cache of robot_descriptions", _descriptions_cache() / "mujoco_menagerie"))
    return places
