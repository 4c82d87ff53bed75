"""`--format mp4`: a film of one environment; `film` draws it."""

from __future__ import annotations

from pathlib import Path

from embodichain.recording.api import Log
from embodichain.recording.export.formats import Part
from embodichain.recording.film import film_log

__all__ = ["write"]


def write(log: Log, part: Part, path: Path) -> None:
    """Film the environment of `part`, or the first that was viewed, in real time.

    Raises:
        ConfigError: If the part does not exist or is empty, or the extra `video` is missing.
        RenderError: If no OpenGL library works here.
    """
    env = part.env if part.env is not None else next(iter(log.header.view_envs), 0)
    last = None if part.stop is None else part.stop - 1
    film_log(log, path, env, part.episode, part.start, last)
