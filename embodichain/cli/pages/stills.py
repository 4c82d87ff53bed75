"""Pictures of pages, drawn from the log: a strip of one episode, the ends of those that failed."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from embodichain.cli.pages.episodes import PlayedEpisode
from embodichain.cli.pages.page import data_url

if TYPE_CHECKING:
    from embodichain.recording.film.moments import Moment

__all__ = ["Still", "draw_ends", "draw_strip", "jpeg"]

_STRIP = 5
"""Pictures of an episode."""
_STRIP_SIZE = (480, 360)
_END_SIZE = (400, 300)
_JPEG_QUALITY = 82


@dataclass(frozen=True, slots=True)
class Still:
    """A picture in a page.

    Attributes:
        source: Its content, as an address.
        caption: What it shows.
        width: In pixels.
        height: In pixels.
    """

    source: str
    caption: str
    width: int
    height: int


def draw_strip(episode: PlayedEpisode) -> list[Still]:
    """Draw an episode from its first to its last control step, in equal distances.

    Args:
        episode: An episode of a log.

    Raises:
        LogError: The log has no states, or is damaged.
        RenderError: Nothing can be drawn here.
    """
    steps = np.linspace(episode.first_step, episode.last_step, _STRIP).round().astype(int)
    numbers = list(dict.fromkeys(steps.tolist()))
    moments = [(episode.env, step) for step in numbers]
    captions = [f"step {step - episode.first_step}" for step in numbers]
    return _draw(episode.log, moments, captions, _STRIP_SIZE)


def draw_ends(episodes: Sequence[PlayedEpisode]) -> list[Still]:
    """Draw the last control step of episodes.

    Args:
        episodes: Episodes of logs, perhaps of several.

    Raises:
        LogError: A log has no states, or is damaged.
        RenderError: Nothing can be drawn here.
    """
    stills: list[Still] = []
    for log in dict.fromkeys(episode.log for episode in episodes):
        of_log = [episode for episode in episodes if episode.log == log]
        moments = [(episode.env, episode.last_step) for episode in of_log]
        captions = [_caption(episode) for episode in of_log]
        stills += _draw(log, moments, captions, _END_SIZE)
    return stills


def _caption(episode: PlayedEpisode) -> str:
    steps = "1 step" if episode.length == 1 else f"{episode.length} steps"
    end = f": {episode.end}" if episode.end else ""
    return f"{episode.label}, {steps}{end}"


def _draw(
    log: Path | None,
    places: Sequence[tuple[int, int]],
    captions: Sequence[str],
    size: tuple[int, int],
) -> list[Still]:
    """Draw environments at control steps; steps that are not in the log are left out."""
    from embodichain import recording
    from embodichain.recording.film.moments import Moment, draw_moments

    if log is None:
        return []
    moments: list[Moment] = [Moment(env, step) for env, step in places]
    with recording.open(log) as opened:
        pictures = draw_moments(opened, moments, size)
    return [
        Still(data_url(jpeg(picture), "image/jpeg"), caption, width=size[0], height=size[1])
        for picture, caption in zip(pictures, captions, strict=True)
        if picture is not None
    ]


def jpeg(picture: NDArray[np.uint8]) -> bytes:
    """Return an RGB picture, (height, width, 3), as JPEG."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, format="JPEG", quality=_JPEG_QUALITY, optimize=True)
    return stream.getvalue()
