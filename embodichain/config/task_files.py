"""Names of YAML tasks, read off folders: no YAML, no Hydra, and no package is imported.

Hydra decides which file is meant when several have the same name (`search_path`).
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
from collections.abc import Iterator
from pathlib import Path

__all__ = ["CONFIG_MODULE", "ENTRY_POINTS", "LOCAL", "task_names"]

CONFIG_MODULE = "embodichain.conf"
"""The package's own tree."""
ENTRY_POINTS = "embodichain.conf"
"""The entry point group with which packages name theirs."""
LOCAL = "conf"
"""The user's tree, in the working directory."""


def task_names() -> list[str]:
    """Return the names of this package's tasks, of packages' and of those in ``./conf``, sorted."""
    return sorted({file.stem for folder in _folders() for file in (folder / "task").glob("*.yaml")})


def _folders() -> Iterator[Path]:
    yield Path(LOCAL)
    plugins = importlib.metadata.entry_points(group=ENTRY_POINTS)
    for module in (CONFIG_MODULE, *(entry.value for entry in plugins)):
        package, *rest = module.split(".")
        spec = importlib.util.find_spec(package)  # of a top-level name: nothing is imported
        for place in (spec and spec.submodule_search_locations) or ():
            yield Path(place, *rest)
