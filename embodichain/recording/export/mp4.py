"""`--format mp4`: a film of one environment; `film` draws it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from embodichain.recording.api import Log
from embodichain.recording.export.formats import Part
from embodichain.recording.film import Filmed, film_log

__all__ = ["write"]


def write(
    log: Log,
    part: Part,
    path: Path,
    progress: Callable[[Filmed], None] | None = None,
    stop: Callable[[], bool] | None = None,
) -> Filmed:
    """Film the environment of `part`, or the first that was viewed, in real time.

    Args:
        log: The log.
        part: Which part of it.
        path: A new file.
        progress: See `film_log`.
        stop: See `film_log`.

    Raises:
        ConfigError: If the part does not exist or is empty, or the extra `video` is missing.
        RenderError: If no OpenGL library works here.
    """
    env = part.env if part.env is not None else next(iter(log.header.view_envs), 0)
    last = None if part.stop is None else part.stop - 1
    what = env, part.episode, part.start, last
    return film_log(log, path, *what, progress=progress, stop=stop)
