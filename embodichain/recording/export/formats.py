"""`export`: formats, which part of a log is meant, files that are never replaced."""

from __future__ import annotations

import importlib
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

from embodichain.recording.api import Log
from embodichain.recording.episodes import LogEpisode
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.recording.film import Filmed

__all__ = ["FORMATS", "Format", "Part", "export", "required"]


@dataclass(frozen=True, slots=True)
class Part:
    """Which part of a log is meant.

    Attributes:
        env: One environment; None is all (for ROS 2 those that were viewed, for mp4 the first).
        episode: One of its episodes; needs `env`.
        start: First control step.
        stop: Control step that no longer belongs to it; None is the end.
    """

    env: int | None = None
    episode: int | None = None
    start: int = 0
    stop: int | None = None

    def steps_of(self, episode: LogEpisode) -> range:
        """The control steps of an episode that are meant; none if it is not."""
        if self.env not in (None, episode.env) or self.episode not in (None, episode.episode):
            return range(0)
        stop = episode.last_step + 1 if self.stop is None else min(self.stop, episode.last_step + 1)
        return range(max(self.start, episode.first_step), stop)


class Format(NamedTuple):
    """A format of files.

    Attributes:
        suffix: Of the file's name; empty where it is a folder.
        writer: Module of this package and its function ``(log, part, path)``; empty for films.
    """

    suffix: str
    writer: str = ""


FORMATS: Mapping[str, Format] = {
    "csv": Format(".csv", "tables:write_csv"),
    "npz": Format(".npz", "tables:write_npz"),
    "parquet": Format(".parquet", "tables:write_parquet"),
    "hdf5": Format(".hdf5", "hdf5:write"),
    "lerobot": Format("", "lerobot:write"),
    "rrd": Format(".rrd", "rrd:write"),
    "ros2": Format(".mcap", "ros2:write"),
    "mp4": Format(".mp4"),
}
_PACKAGES = {"rerun": "rerun-sdk"}
"""Packages whose names are others than their modules'."""
_EXTRAS = {"rrd": "rerun"}
"""Extras whose names are others than the formats'."""


def export(
    log: Log,
    format: str,
    output: str | Path | None = None,
    part: Part | None = None,
    *,
    progress: Callable[[Filmed], None] | None = None,
    stop: Callable[[], bool] | None = None,
) -> Path:
    """Write a log, or a part of it, in another format.

    Args:
        log: The log.
        format: Key of `FORMATS`.
        output: A new file; None puts it beside the log, under its name.
        part: Which part; None is all of it.
        progress: For films, see `film_log`.
        stop: For films, likewise: one that is stopped before its first picture is not there. Files
            of other formats are whole or not there: an exception on the way, such as a
            KeyboardInterrupt, removes them.

    Returns:
        The file, or the folder where the format is one.

    Raises:
        ConfigError: If the format is unknown or needs a package that is missing, the part does not
            exist, or the file does.
        LogError: If the log has no states, or is damaged.
        OSError: If the file cannot be written.
    """
    if format not in FORMATS:
        raise ConfigError(
            f"no format {format!r}.{did_you_mean(format, FORMATS)} Formats: {', '.join(FORMATS)}"
        )
    chosen = FORMATS[format]
    name = log.path.stem
    if chosen.suffix in ("", ".mcap"):
        name = f"{name}_{format}"
    path = Path(output) if output else log.path.with_name(name + chosen.suffix)
    part = part or Part()
    log.header.require_states(log.path)
    _require_steps(log, part)
    module, _, function = chosen.writer.partition(":")
    with _new_file(path, chosen.suffix) as partial:
        if module:
            writing = importlib.import_module(f"embodichain.recording.export.{module}")
            getattr(writing, function)(log, part, partial)
        else:
            from embodichain.recording.film import film_log

            env = part.env if part.env is not None else next(iter(log.header.view_envs), 0)
            what = env, part.episode, part.start, None if part.stop is None else part.stop - 1
            film_log(log, partial, *what, progress=progress, stop=stop)
    return path


def _require_steps(log: Log, part: Part) -> None:
    """Refuse a range in which the log has nothing."""
    if not part.start and part.stop is None:
        return
    asked = log.parts("rewards", part.env, part.episode, part.start, part.stop, steps=50)
    if next(asked, None) is None:
        end = "the end" if part.stop is None else part.stop
        raise ConfigError(f"{log.path} has no control step from {part.start} to {end}")


@contextmanager
def _new_file(path: Path, suffix: str) -> Iterator[Path]:
    """A name to write under; the file gets its own when it is whole, unless that is taken."""
    if os.path.lexists(path):
        raise ConfigError(f"{path} exists; it is never replaced")
    if not path.parent.is_dir():
        raise ConfigError(f"the folder {path.parent} does not exist")
    partial = path.with_name(f".{path.stem}.{os.getpid()}.part{suffix}")
    try:
        yield partial
        if partial.is_dir():
            partial.rename(path)  # refuses a name that is taken by anything but an empty folder
        elif partial.exists():
            os.link(partial, path)  # unlike a rename, it refuses a name that is taken
    except (FileExistsError, NotADirectoryError) as error:
        raise ConfigError(f"{path} exists; it is never replaced") from error
    finally:
        if partial.is_dir():
            shutil.rmtree(partial)
        partial.unlink(missing_ok=True)


def required(module: str, format: str) -> ModuleType:
    """Import what a format needs.

    Raises:
        ConfigError: If it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = _PACKAGES.get(module.partition(".")[0], module.partition(".")[0])
        extra = _EXTRAS.get(format, format)
        raise ConfigError(
            f"--format {format} needs {package}: pip install 'embodichain[{extra}]'"
        ) from error
