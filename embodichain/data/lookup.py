"""Finds robot and object files by name, and lists them.

`get_data_path` finds files, `resolve_package_uri` the meshes of models; `list_robots` and
`list_assets` list files. Order for a relative name: the folder of the file that refers to it,
working directory, data root, bundled assets, installed packages, cached models. Models of MuJoCo
Menagerie, by folder name (``menagerie:unitree_go2``), come from a checkout (``$MENAGERIE_PATH``) or
from the caches of the packages mujoco-menagerie and robot_descriptions. Nothing is downloaded, no
package is imported, and no model is parsed.
"""

from __future__ import annotations

import os
import posixpath
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote, urlsplit

from embodichain.utils.errors import DataNotFoundError, OutsideError
from embodichain.utils.suggest import closest

__all__ = [
    "HOW",
    "Asset",
    "data_root",
    "get_data_path",
    "list_assets",
    "list_robots",
    "resolve_package_uri",
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
# Some files have package:///NAME/x or package:/NAME/x instead of package://NAME/x.
_PACKAGE = re.compile(r"package:/+(?P<package>[^/]+)(?:/(?P<rest>.*))?$")
_MODEL_DEPTH = 4  # folder depth searched below a place: deeper folders contain meshes
_MODEL_SUFFIXES = {".urdf", ".xml", ".mjcf"}
_HEAD_BYTES = 4096


def get_data_path(name: str | os.PathLike[str], near: str | os.PathLike[str] | None = None) -> str:
    """Return the absolute path of a robot or object file (or folder).

    `name` is an absolute path, ``package://NAME/...`` (see `resolve_package_uri`),
    ``menagerie:NAME`` or ``menagerie:NAME/FILE.xml``, or a relative path. The latter is searched in
    the folder of `near`, the working directory, ``$EMBODICHAIN_DATA_ROOT`` (by default
    ``~/.cache/embodichain_data``), the assets bundled with this package, example-robot-data if
    installed, and a mujoco_menagerie cached by robot_descriptions. The first match is returned.

    Args:
        name: E.g. ``UniversalRobots/UR10/UR10.urdf``, ``panda_description/urdf/panda.urdf``,
            ``~/robots/mine.urdf``.
        near: The file that refers to it, or its folder; or None.

    Raises:
        DataNotFoundError: If it is not found. The message lists the places searched, the closest
            names, and how to get it.
        OutsideError: If a ``package://`` or ``menagerie:`` name leads out of its folder.
        ValueError: If `name` is empty.
    """
    text = os.fspath(name)
    if not text:
        raise ValueError("name is empty: expected the path or name of a robot or object file")
    if _PACKAGE.match(text):
        return resolve_package_uri(text, near)
    if text.startswith(PREFIX):
        return str(_find_model(text))
    path = Path(text).expanduser()
    if path.is_absolute():
        return _first_existing(text, [("absolute path", path)])
    tried: list[tuple[str, Path]] = []
    if near is not None:
        tried.append(("beside the file that names it", _folder_of(near) / path))
    tried.append(("working directory", Path.cwd() / path))
    if text.startswith(("./", "../")):  # it says where it is
        return _first_existing(text, tried)
    for place in places():
        tried += [(place.label, candidate) for candidate in place.candidates(path.as_posix())]
    return _first_existing(text, tried)


def resolve_package_uri(uri: str, near: str | os.PathLike[str] | None = None) -> str:
    """Return the absolute path of a file that a model refers to, such as a mesh.

    Accepts ``package://NAME/rest``, ``file:///abs``, absolute paths, and paths relative to `near`.
    A package is searched among the folders above `near` and their siblings (for a model in
    ``NAME/urdf/``, its own ``NAME``), in the places, ROS and data packages, and as a Python
    package. The first that contains the file is used. The rest of the path stays in the package:
    neither ``..`` nor a link in a package beside the model leads out of it, but for a link into the
    source of the same package, as ``colcon build --symlink-install`` makes.

    Args:
        uri: The reference in the model.
        near: The model file, or its folder; None is the working directory.

    Raises:
        DataNotFoundError: If no place contains the file.
        OutsideError: If the URI leads out of its package.
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
    if package in (".", ".."):
        raise OutsideError(f"{uri!r} names no package: {package!r} is a folder above or itself")
    _check_inside(uri, rest)
    tried: list[tuple[str, Path]] = []
    for parent in (folder, *folder.parents):
        if parent.name == package:
            root = parent
            label = "package above the model file"
        elif (parent / package).is_dir():
            root = parent / package
            label = "package beside the model file"
        else:
            continue
        if (root / rest).exists():
            _check_link(uri, root / rest, root, package)
        tried.append((label, root / rest))
    beside = _existing(tried)
    if beside is not None:  # as most meshes: the places need not be looked for
        return beside
    for place in _package_parents():
        tried.append((place.label, place.folder / package / rest))
    for root in _python_package(package):
        tried.append(("Python package", root / rest))
    return _first_existing(uri, tried)


def _check_inside(name: str, rest: str) -> None:
    """Refuse a path in a folder that leads out of the folder.

    Args:
        name: The whole name, for the message.
        rest: The path.
    """
    plain = posixpath.normpath(rest.replace("\\", "/")) if rest else ""
    if plain == ".." or plain.startswith(("../", "/")):
        raise OutsideError(f"{name!r} leads out of its folder: no .. and no absolute path in it")


def _check_link(uri: str, path: Path, root: Path, package: str) -> None:
    """Refuse a file of a package that a link leads out of it, except to the package's source."""
    target = path.resolve()
    if target.is_relative_to(root.resolve()):
        return
    for parent in target.parents:
        about = parent / "package.xml"
        if about.is_file() and f"<name>{package}</name>" in about.read_text("utf-8", "replace"):
            return
    raise OutsideError(f"{uri!r} leads out of its folder {root}: a link in it leads to {target}")


def _folder_of(near: str | os.PathLike[str]) -> Path:
    """Return the absolute path of a folder, or of a file's folder."""
    path = Path(near).expanduser().absolute()
    return path if path.is_dir() else path.parent


def _existing(tried: list[tuple[str, Path]]) -> str | None:
    """Return the first existing path, without ``..``; None if there is none."""
    for _, path in tried:
        if path.exists():
            return os.path.abspath(path)
    return None


def _first_existing(name: str, tried: list[tuple[str, Path]]) -> str:
    """Return the first existing path, without ``..``; else raise with all that were tried."""
    existing = _existing(tried)
    if existing is not None:
        return existing
    searched = [(label, os.path.abspath(path)) for label, path in tried]
    raise DataNotFoundError(name, searched, _closest_names(name, tried), _advice(name))


def _closest_names(name: str, tried: list[tuple[str, Path]]) -> list[str]:
    """Return existing names similar to `name`, in full, by file name, or in its folder."""
    match = _PACKAGE.match(name)
    if match:
        return _closest_packages(match["package"], match["rest"] or "", tried)
    siblings = [str(Path(name).parent / sibling) for sibling in _siblings(tried)]
    if siblings or name.startswith(("./", "../")) or Path(name).expanduser().is_absolute():
        return list(dict.fromkeys(siblings))[:3]
    robots = [robot.name for robot in list_robots()]
    stem = Path(name).stem.casefold()
    # Another robot of the same maker has a similar name, too: the file name decides where it can.
    same_file = [robot for robot in robots if Path(robot).stem.casefold() == stem]
    similar = closest(name, same_file or robots, n=2, cutoff=0.75)
    similar += same_file
    if not similar:
        by_file = {Path(robot).name: robot for robot in robots}
        similar = [by_file[file] for file in closest(Path(name).name, by_file, n=1, cutoff=0.8)]
    return list(dict.fromkeys(similar))[:3]


def _closest_packages(package: str, rest: str, tried: list[tuple[str, Path]]) -> list[str]:
    """Return existing URIs similar to ``package://<package>/<rest>``."""
    base = f"package://{package}"
    similar = [f"{base}/{Path(rest).parent / sibling}" for sibling in _siblings(tried)]
    if not similar:
        packages: list[str] = []
        for place in _package_parents():
            packages += [entry.name for entry in place.folder.iterdir() if entry.is_dir()]
        similar = [f"package://{other}/{rest}" for other in closest(package, packages)]
    return list(dict.fromkeys(similar))[:3]


def _siblings(tried: list[tuple[str, Path]]) -> list[str]:
    """Return similar names in the folders of the tried paths."""
    names: list[str] = []
    for _, path in tried:
        if path.parent.is_dir():
            entries = [entry.name for entry in path.parent.iterdir()]
            names += closest(path.name, entries, cutoff=0.7)
    return names


def _advice(name: str) -> str:
    """Return the command that would provide `name`, guessed from the name."""
    installed = {place.label for place in places()}
    if "menagerie" in name and not _menagerie_models():
        return HOW
    if "example-robot-data" not in installed:
        return (
            'More robots: `pip install "embodichain[robots]"`. '
            "What is here: `embodichain list robots`."
        )
    return "What is here: `embodichain list robots`. Your own files: $EMBODICHAIN_DATA_ROOT."


# -- places ----------------------------------------------------------------------------------------


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
    in_order = [
        Place("EMBODICHAIN_DATA_ROOT", root),
        Place("EMBODICHAIN_DATA_ROOT, extracted archives", root / "extract"),
        Place("bundled", ASSETS),
    ]
    for share in _share_folders():
        robots = share / "example-robot-data" / "robots"
        if robots.is_dir():
            in_order.append(Place("example-robot-data", robots, "example-robot-data/robots"))
    menagerie = _descriptions_cache() / "mujoco_menagerie"
    in_order.append(Place("mujoco_menagerie", menagerie, "mujoco_menagerie"))
    return in_order


def _package_parents() -> list[Place]:
    """Return the existing folders that are searched for ``package://NAME``, in order.

    The data root, the bundled assets, data folders of Python packages (cmeel among them) and ROS
    packages, and the cache of robot_descriptions.
    """
    root = data_root()
    shares = _share_folders()
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


def _python_package(name: str) -> list[Path]:
    """Return the folders of the Python package of that name, without importing it."""
    module = name.replace("-", "_")
    if not module.isidentifier() or module == "__main__":
        return []
    spec = find_spec(module)
    if spec is None:
        return []
    return [Path(folder) for folder in spec.submodule_search_locations or ()]


def _share_folders() -> list[Path]:
    """Return the ``share`` folders that Python packages install data into."""
    folders = [Path(entry, "cmeel.prefix", "share") for entry in sys.path if entry]
    folders.append(Path(sys.prefix, "share"))
    return [folder for folder in dict.fromkeys(folders) if folder.is_dir()]


def _ros_folders() -> list[Path]:
    """Return the folders with ROS packages, from the variables that ROS sets."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    folders = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    shares = [Path(prefix, "share") for prefix in prefixes if prefix]
    return shares + [Path(folder) for folder in folders if folder]


def _descriptions_cache() -> Path:
    """Return the cache of the robot_descriptions package, which clones mujoco_menagerie into it."""
    cache = os.environ.get("ROBOT_DESCRIPTIONS_CACHE") or "~/.cache/robot_descriptions"
    return Path(cache).expanduser()


# -- MuJoCo Menagerie ------------------------------------------------------------------------------


def _menagerie_models() -> dict[str, Path]:
    """Return the folder of every available model, by name; the first place takes precedence."""
    models: dict[str, Path] = {}
    for name, folder in _menagerie_folders():
        models.setdefault(name, folder)
    return dict(sorted(models.items()))


def _find_model(text: str) -> Path:
    """Return the file of ``menagerie:NAME`` or ``menagerie:NAME/FILE.xml``.

    Raises:
        DataNotFoundError: If there is no such model or file, or NAME has several files and none is
            the main one; lists the choices.
        OutsideError: If the file is not in the model's folder.
    """
    name, _, file = text.removeprefix(PREFIX).partition("/")
    models = _menagerie_models()
    _check_inside(text, file)
    if name not in models:
        searched = [(label, str(folder)) for label, folder in _menagerie_places()]
        similar = [PREFIX + model for model in closest(name, models)]
        advice = HOW
        if models:
            advice = f"{len(models)} of its models are here: `embodichain list robots`"
        raise DataNotFoundError(text, searched, similar, advice)
    folder = models[name]
    path = folder / file if file else _main_file(name, folder)
    if path is not None and path.is_file():
        return path.absolute()
    choices = [f"{PREFIX}{name}/{model.name}" for model in _robot_files(folder)]
    advice = "The model has several robots: name one of its files." if not file else ""
    raise DataNotFoundError(text, [("model folder", str(folder))], choices, advice)


def _main_file(name: str, folder: Path) -> Path | None:
    """Return the XML file that a model's name refers to; None if ambiguous.

    It is the file named like the folder without the maker (``go2.xml`` of ``unitree_go2``), or the
    only robot file.
    """
    files = _robot_files(folder)
    named = [file for file in files if name == file.stem or name.endswith(f"_{file.stem}")]
    if named:
        return max(named, key=lambda file: len(file.stem))
    if len(files) == 1:
        return files[0]
    return None


def _robot_files(folder: Path) -> list[Path]:
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
            elif folder.is_dir() and _robot_files(folder):
                yield folder.name, folder


def _menagerie_places() -> list[tuple[str, Path]]:
    """Return the folders searched for models, in order; they need not exist."""
    places = []
    for variable in ("MENAGERIE_PATH", "MENAGERIE_ROOT"):  # ours, and mujoco-menagerie's
        if root := os.environ.get(variable):
            places.append((variable, Path(root).expanduser()))
    cache = os.environ.get("MENAGERIE_CACHE_DIR")
    if not cache:
        base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
        cache = os.path.join(base, "mujoco_menagerie")
    places.append((_CACHE, Path(cache).expanduser() / "models"))
    places.append(("cache of robot_descriptions", _descriptions_cache() / "mujoco_menagerie"))
    return places


# -- catalogue -------------------------------------------------------------------------------------


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
    groups = [_models(place) for place in places() if place.label != "mujoco_menagerie"]
    groups.append(_menagerie())
    return list(_unique(groups))


def list_assets() -> list[Asset]:
    """Return all files of the data root and bundled assets, and all robots of packages."""
    searched = [place for place in places() if not place.prefix]
    labels = {place.label for place in searched}
    robots = [asset for asset in list_robots() if asset.source not in labels]
    return [*_unique(_files(place) for place in searched), *robots]


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
    for name, folder in _menagerie_models().items():
        main = _main_file(name, folder)
        for path in _robot_files(folder):
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
