"""One door to Hydra: a config loader of this package's tree; its global state is kept."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from hydra import initialize_config_module
from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from hydra.core.singleton import Singleton
from hydra.core.utils import JobRuntime
from hydra.version import VersionBase

from embodichain.config.search_path import CONFIG_MODULE, user_configs

__all__ = ["VERSION_BASE", "config_loader"]

VERSION_BASE = "1.3"

# Hydra keeps these as process-wide singletons, and there is one process.
_lock = threading.RLock()
_STATE: tuple[type, ...] = (GlobalHydra, JobRuntime, VersionBase)


@contextmanager
def config_loader(config_dir: str | Path | None = None) -> Iterator[ConfigLoader]:
    """Give a loader of `embodichain.conf`; works inside a Hydra application and outside of one.

    Args:
        config_dir: Searched first; None keeps the enclosing `user_configs`.

    Raises:
        ConfigError: `config_dir` does not exist.
    """
    started = partial(initialize_config_module, CONFIG_MODULE, "embodichain", VERSION_BASE)
    with _lock, _kept_state(), user_configs(config_dir), started():
        yield GlobalHydra.instance().config_loader()


@contextmanager
def _kept_state() -> Iterator[None]:
    """Hide Hydra's singletons for a while, then put the very same objects back."""
    instances = Singleton._instances
    kept = {cls: instances.pop(cls) for cls in _STATE if cls in instances}
    try:
        yield
    finally:
        for cls in _STATE:
            instances.pop(cls, None)
        instances.update(kept)
