"""A Hydra config loader of this package's tree, beside whatever Hydra application is running."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hydra import version
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.utils import create_config_search_path
from hydra.core.config_loader import ConfigLoader

from embodichain.config.search_path import CONFIG_MODULE, user_configs

__all__ = ["VERSION_BASE", "config_loader"]

VERSION_BASE = "1.3"


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
        yield ConfigLoaderImpl(create_config_search_path(f"pkg://{CONFIG_MODULE}"))
