"""Which log a word on the command line means. Opens none."""

from __future__ import annotations

from pathlib import Path

from embodichain.config.newest import LOG, newest_run
from embodichain.utils.errors import ConfigError

__all__ = ["log_of"]


def log_of(name: str) -> Path:
    """The log that is meant: a file, the one in a run's folder, or the newest one (``last``).

    Raises:
        ConfigError: There is no log yet, or the folder has none.
    """
    path = newest_run("outputs", LOG) if name == "last" else Path(name)
    if path is None:
        raise ConfigError("no run in outputs has a log yet: embodichain run task=NAME")
    if not path.is_dir():
        return path
    log = path.resolve() / LOG
    if not log.exists():
        raise ConfigError(f"{path.resolve()} has no {LOG}: it was run with record=none")
    return log
