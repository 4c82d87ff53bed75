"""Models of MuJoCo Menagerie, by the name of their folder: ``menagerie:unitree_go2``.

A checkout (``$MENAGERIE_PATH``), or what the packages mujoco-menagerie and robot_descriptions have
downloaded into their caches. Nothing is downloaded here, and neither package is imported.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from embodichain.data.errors import DataNotFoundError
from embodichain.data.places import descriptions_cache
from embodichain.utils.suggest import closest

__all__ = ["HOW", "PREFIX", "find_model", "main_file", "menagerie_models", "robot_files"]

PREFIX = "menagerie:"
HOW = (
    "MuJoCo Menagerie: set MENAGERIE_PATH to a checkout of it, or "
    "`pip install mujoco-menagerie && mujoco-menagerie prefetch unitree_go2`"
)
"""How to have it."""

_COMPLETE = ".complete"  # mujoco-menagerie writes it last


def menagerie_models() -> dict[str, Path]:
    """Return the folder of every model that is here, by name; the first place that has it wins."""
    found: dict[str, Path] = {}
    for name, folder in _models():
        found.setdefault(name, folder)
    return dict(sorted(found.items()))


def find_model(text: str) -> Path:
    """Return the file that ``menagerie:NAME`` or ``menagerie:NAME/FILE.xml`` means.

    Raises:
        DataNotFoundError: There is no such model or file, or NAME has several and none is its main
            one; lists the choices.
    """
    name, _, file = text.removeprefix(PREFIX).partition("/")
    models = menagerie_models()
    if name not in models:
        searched = [(label, str(folder)) for label, folder in _places()]
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
    """Return the XML that is meant by a model's name alone; None if that is not clear.

    It is the file that the folder is named after, less the maker (``go2.xml`` of ``unitree_go2``),
    or the only robot there is.
    """
    files = robot_files(folder)
    named = [f for f in files if name == f.stem or name.endswith(f"_{f.stem}")]
    if named:
        return max(named, key=lambda f: len(f.stem))
    return files[0] if len(files) == 1 else None


def robot_files(folder: Path) -> list[Path]:
    """Return the XML files of a model that are not scenes (a robot with a floor and lights)."""
    return sorted(f for f in folder.glob("*.xml") if not f.stem.startswith("scene"))


def _models() -> Iterator[tuple[str, Path]]:
    for label, place in _places():
        if not place.is_dir():
            continue
        for folder in sorted(place.iterdir()):
            if label == _CACHE:
                if (folder / _COMPLETE).is_file():
                    yield folder.name.rpartition("-")[0], folder  # NAME-DIGEST
            elif folder.is_dir() and robot_files(folder):
                yield folder.name, folder


_CACHE = "cache of mujoco-menagerie"


def _places() -> list[tuple[str, Path]]:
    """Return where models are looked for, in order; the folders need not exist."""
    places = []
    for variable in ("MENAGERIE_PATH", "MENAGERIE_ROOT"):  # ours, and mujoco-menagerie's
        if root := os.environ.get(variable):
            places.append((variable, Path(root).expanduser()))
    own = os.environ.get("MENAGERIE_CACHE_DIR")
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    cache = Path(own) if own else Path(base, "mujoco_menagerie")
    places.append((_CACHE, cache.expanduser() / "models"))
    places.append(("cache of robot_descriptions", descriptions_cache() / "mujoco_menagerie"))
    return places
