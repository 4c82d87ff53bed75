"""`export`: writes a log in another format, without replacing files."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.recording.export.format_register import EPISODE_FORMATS, FORMATS
from embodichain.recording.export.log_parts import Part
from embodichain.recording.read.api import Log
from embodichain.utils.errors import ConfigError
from embodichain.utils.system.atomic import move_new, named_errors, remove_abandoned, temporary_name

if TYPE_CHECKING:
    from embodichain.recording.film.filming import Filmed

__all__ = ["export", "new_file"]


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
        output: A new file; None: next to the log, with the log's name.
        part: The part to write; None is the whole log.
        progress: For films only, see `film_log`.
        stop: For films only, see `film_log`: without a picture, no file is written. In other
            formats, an exception such as KeyboardInterrupt removes the incomplete file.

    Returns:
        The file, or the folder if the format is one.

    Raises:
        ConfigError: If the format is unknown or needs a package that is missing, the part does not
            exist, or the file already exists.
        LogError: If the log has no states, or is damaged.
        OSError: If the file cannot be written.
    """
    if format not in FORMATS and format in EPISODE_FORMATS.names():
        raise ConfigError(f"{format} has the task's observations: use export_episodes")
    file_format = FORMATS[format]
    part = part or Part()
    if (part.cameras or part.size) and not file_format.pictures:
        names = ", ".join(name for name, entry in FORMATS.items() if entry.pictures)
        raise ConfigError(f"{format} has no pictures; formats with cameras: {names}")
    path = Path(output) if output else _path_beside(log, format, file_format.suffix)
    log.header.require_states(log.path)
    _require_steps(log, part)
    with new_file(path, file_format.suffix) as partial:
        if file_format.film:
            file_format.write(log, part, partial, progress=progress, stop=stop)
        else:
            file_format.write(log, part, partial)
    return path


def _path_beside(log: Log, format: str, suffix: str) -> Path:
    """Return a path next to the log, with the log's name."""
    name = log.path.stem
    if suffix in ("", ".mcap"):  # else it would be the name of the log or of its run
        name += f"_{format}"
    return log.path.with_name(name + suffix)


def _require_steps(log: Log, part: Part) -> None:
    """Refuse a range of steps that are not in the log."""
    if part.start or part.stop is not None:
        recorded = log.parts(
            "rewards",
            env=part.env,
            episode=part.episode,
            start=part.start,
            stop=part.stop,
            steps=50,
        )
        if next(recorded, None) is None:
            end = "the end" if part.stop is None else part.stop
            raise ConfigError(f"{log.path} has no control step from {part.start} to {end}")


@contextmanager
def new_file(path: Path, suffix: str) -> Iterator[Path]:
    """Yield a temporary name to write to; the complete file gets the name `path`.

    If the writer makes no file, there is none at `path` either.

    Args:
        path: The name of the complete file, or folder.
        suffix: Suffix of the temporary name.

    Raises:
        ConfigError: If `path` exists, before or after, or its folder does not.
        OSError: If the file cannot be written; it names `path`.
    """
    if os.path.lexists(path):
        raise ConfigError(f"{path} exists; it is never replaced")
    if not path.parent.is_dir():
        raise ConfigError(f"the folder {path.parent} does not exist")
    remove_abandoned(path.parent)
    partial = path.with_name(temporary_name(f"{path.stem}{suffix}"))
    try:
        with named_errors(partial, path):
            yield partial
            if partial.exists():
                move_new(partial, path)
    except (FileExistsError, NotADirectoryError) as error:
        raise ConfigError(f"{path} exists; it is never replaced") from error
    finally:
        if partial.is_dir():
            shutil.rmtree(partial)
        partial.unlink(missing_ok=True)
