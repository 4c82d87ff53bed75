"""A film of one environment, in real time, of one camera."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from embodichain.recording.export.format_register import log_format
from embodichain.recording.export.log_parts import Part
from embodichain.recording.film.filming import Filmed, film_log
from embodichain.recording.read.api import Log
from embodichain.utils.errors import ConfigError

__all__ = ["write_mp4"]

_SIZE = (640, 480)


@log_format("mp4", suffix=".mp4", requires="embodichain[video]", pictures=True, film=True)
def write_mp4(
    log: Log,
    part: Part,
    path: Path,
    *,
    progress: Callable[[Filmed], None] | None = None,
    stop: Callable[[], bool] | None = None,
) -> None:
    """Write a film of the selected environment, or of the first viewed one; see `film_log`.

    Raises:
        ConfigError: If several cameras are selected, or there is no such camera or no encoder.
        RenderError: If no OpenGL library works here.
    """
    if part.cameras is not None and len(part.cameras) != 1:
        raise ConfigError(f"a film has one camera, not {', '.join(part.cameras) or 'none'}")
    film_log(
        log,
        path,
        env=part.envs_of(log)[0],
        episode=part.episode,
        first=part.start,
        last=part.last,
        size=part.size or _SIZE,
        camera=part.cameras[0] if part.cameras else None,
        progress=progress,
        stop=stop,
    )
