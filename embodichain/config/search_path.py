"""Where YAML is searched: `--config-dir`, `./conf`, the package's own tree, plug-ins' trees.

The first that has a file wins, so a user's `task/reach.yaml` stands before the package's. A Hydra
plug-in adds the places, and only to searches of this package's tree: other Hydra applications in
the process see nothing of it.
"""

from __future__ import annotations

import importlib.metadata
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from importlib import resources
from pathlib import Path

from hydra import version
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.utils import create_config_search_path
from hydra.core.config_loader import ConfigLoader
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.object_type import ObjectType
from hydra.core.plugins import Plugins
from hydra.plugins.search_path_plugin import SearchPathPlugin

from embodichain.config.task_files import CONFIG_MODULE, ENTRY_POINTS, LOCAL
from embodichain.utils.errors import ConfigError

__all__ = ["CONFIG_MODULE", "VERSION_BASE", "config_loader", "folder_of_source", "user_configs"]

_config_dir: ContextVar[Path | None] = ContextVar("config_dir", default=None)


@contextmanager
def user_configs(config_dir: str | Path | None) -> Iterator[None]:
    """Search `config_dir` before everything else while the context lasts.

    Args:
        config_dir: A folder with groups (``task/``...) of the user's own; None changes nothing.

    Raises:
        ConfigError: The folder does not exist.
    """
    folder = _config_dir.get() if config_dir is None else Path(config_dir).resolve()
    if folder is not None and not folder.is_dir():
        raise ConfigError(f"--config-dir {config_dir}: no such folder")
    token = _config_dir.set(folder)
    try:
        yield
    finally:
        _config_dir.reset(token)


def _folder_of(module: str) -> Path:
    return Path(str(resources.files(module)))


def folder_of_source(scheme: str, path: str) -> Path | None:
    """Return the folder of a place in a search path; None for Hydra's own and for no folder."""
    if scheme == "file":
        return Path(path)
    return _folder_of(path) if scheme == "pkg" and not path.startswith("hydra") else None


class EmbodichainSearchPath(SearchPathPlugin):
    """Adds the user's folders before the package's tree, and plug-ins' trees after it."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Called by Hydra for every search path it makes."""
        paths = [element.path or "" for element in search_path.get_path()]
        if f"pkg://{CONFIG_MODULE}" not in paths:
            return
        own = _folder_of(CONFIG_MODULE).resolve()
        here = Path(LOCAL).resolve()
        for provider, folder in (("./conf", here), ("--config-dir", _config_dir.get())):
            if folder is not None and folder.is_dir() and folder != own:
                search_path.prepend(provider, f"file://{folder}")
        for entry in sorted(importlib.metadata.entry_points(group=ENTRY_POINTS)):
            search_path.append(entry.name, f"pkg://{entry.value}")


Plugins.instance().register(EmbodichainSearchPath)


VERSION_BASE = "1.3"


class _Loader(ConfigLoaderImpl):
    """Asks its sources for the options of a group; Hydra's copies them all each time, 10 ms."""

    def get_group_options(
        self,
        group_name: str,
        results_filter: ObjectType | None = ObjectType.CONFIG,
        config_name: str | None = None,
        overrides: list[str] | None = None,
    ) -> list[str]:
        return self.repository.get_group_options(group_name, results_filter)


@contextmanager
def config_loader(config_dir: str | Path | None = None) -> Iterator[ConfigLoader]:
    """Give a loader of `embodichain.conf`.

    `hydra.initialize` would replace the loader of an application that is running; this one is
    separate from it.

    Args:
        config_dir: Searched first; None keeps the enclosing `user_configs`.

    Raises:
        ConfigError: `config_dir` does not exist.
    """
    if not hasattr(version.getbase(), "major"):
        version.setbase(VERSION_BASE)  # what Hydra leaves unset until an application starts
    with user_configs(config_dir):
        yield _Loader(create_config_search_path(f"pkg://{CONFIG_MODULE}"))
