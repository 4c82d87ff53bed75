"""The registers of export formats: `FORMATS` and `EPISODE_FORMATS`.

A format is a function that writes one file, or one folder, registered where it is defined: with
`log_format` it writes what a log contains, with `episode_format` whole episodes with the task's
observations. A package outside does the same, and names its module with an entry point::

    [project.entry-points."embodichain.formats"]
    jsonl = "my_package.jsonl"

Module and entry point are called as the format, so that help texts name all formats without
importing one.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from embodichain.utils.errors import ConfigError
from embodichain.utils.register import Register

if TYPE_CHECKING:
    from embodichain.recording.export.data_set import DataSet
    from embodichain.recording.export.log_parts import Part
    from embodichain.recording.read.api import Log

__all__ = [
    "EPISODE_FORMATS",
    "FORMATS",
    "Format",
    "WriteEpisodes",
    "WriteLog",
    "episode_format",
    "log_format",
    "required",
]


class WriteLog(Protocol):
    """Writes a part of a log to a new path, with the format's suffix; see `log_format`."""

    def __call__(self, log: Log, part: Part, path: Path, **watching: Any) -> None:
        """Write the file or folder; what an exception leaves of it is removed.

        Args:
            log: The log, which has states.
            part: The part; its steps are in the log.
            path: A name that nothing has. It becomes the user's name when the function returns.
            **watching: Only for films: `progress` and `stop`, see `film_log`.
        """


class WriteEpisodes(Protocol):
    """Writes the episodes of a data set to a new path; see `episode_format`."""

    def __call__(self, data: DataSet, path: Path) -> None:
        """Write the file or folder; what an exception leaves of it is removed."""


Write = TypeVar("Write", bound=Callable[..., None])


@dataclass(frozen=True)
class Format(Generic[Write]):
    """A format of files.

    Attributes:
        write: The function that writes one.
        suffix: Suffix of the file's name; empty if the format is a folder.
        requires: What pip installs for the packages that it needs, ``embodichain[hdf5]``.
        pictures: Whether it has pictures of cameras.
        film: Whether `write` takes `progress` and `stop`, and keeps what was drawn until then.
    """

    write: Write
    suffix: str
    requires: str = ""
    pictures: bool = False
    film: bool = False


FORMATS: Register[Format[WriteLog]] = Register(
    "export format",
    group="embodichain.formats",
    modules=("embodichain.recording.export.formats.*",),
)
"""Formats of `export`: what a log contains."""
EPISODE_FORMATS: Register[Format[WriteEpisodes]] = Register(
    "export format with observations",
    group="embodichain.episode_formats",
    modules=("embodichain.recording.export.episode_formats.*",),
)
"""Formats of `export_episodes`: episodes with the task's observations."""


def log_format(
    name: str, *, suffix: str, requires: str = "", pictures: bool = False, film: bool = False
) -> Callable[[Write], Write]:
    """Register a function ``write(log, part, path)`` as a format of `export`; see `WriteLog`.

    Args:
        name: What `--format` takes; also the name of its module and its entry point.
        suffix: Suffix of the file's name, ``.csv``; empty if the format is a folder.
        requires: What pip installs for the packages that it needs, ``embodichain[hdf5]``.
        pictures: Whether it draws the part's `cameras`.
        film: Whether it takes `progress` and `stop` too, as films do, which are slow to make.

    Returns:
        A decorator that returns its argument.

    Raises:
        ValueError: If another function has the name.
    """

    def decorate(write: Write) -> Write:
        FORMATS.add(name, describes=write)(
            Format(write, suffix=suffix, requires=requires, pictures=pictures, film=film)
        )
        return write

    return decorate


def episode_format(name: str, *, suffix: str, requires: str = "") -> Callable[[Write], Write]:
    """Register a function ``write(data, path)`` as a format of `export_episodes`.

    Args:
        name: What `--format` takes; also the name of its module and its entry point.
        suffix: Suffix of the file's name, ``.hdf5``; empty if the format is a folder.
        requires: What pip installs for the packages that it needs, ``embodichain[hdf5]``.

    Returns:
        A decorator that returns its argument.

    Raises:
        ValueError: If another function has the name.
    """

    def decorate(write: Write) -> Write:
        EPISODE_FORMATS.add(name, describes=write)(Format(write, suffix=suffix, requires=requires))
        return write

    return decorate


def required(module: str, format: str, package: str = "") -> ModuleType:
    """Import what a format needs.

    Args:
        module: The module.
        format: The format, which says how its packages are installed.
        package: The distribution that has the module, if it is called otherwise.

    Raises:
        ConfigError: If the module is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        needed = package or module.partition(".")[0]
        entry = FORMATS.get(format) or EPISODE_FORMATS[format]
        raise ConfigError(
            f"--format {format} needs {needed}: pip install '{entry.requires or needed}'"
        ) from error
