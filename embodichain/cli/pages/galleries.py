"""Pictures of a run on its page, drawn from its log: one episode, and the ends of failed ones.

The page of a policy has a film of the episode in place of pictures.
"""

from __future__ import annotations

import importlib.util
import io
import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from embodichain.cli.pages.episodes import PlayedEpisode, counted_episodes
from embodichain.cli.pages.page import data_url
from embodichain.cli.pages.run_record import RunRecord
from embodichain.utils.errors import EmbodichainError

__all__ = ["Film", "Gallery", "Still", "draw_episode", "draw_failures", "film_episode", "jpeg"]

_PICTURES = 5
"""Pictures of an episode."""
_SIZE = (480, 360)
_MOST_FAILURES = 8
_FAILURE_SIZE = (400, 300)
_START_SIZE = (1280, 960)
"""Of `scene.png`."""
_JPEG_QUALITY = 82
_FILM_TYPES = {".mp4": "video/mp4", ".gif": "image/gif"}
_FILM_PICTURES = 80
"""Pictures of a film, at most: they cost about 0.04 s each."""
_FILM_SHORTEST_GAP = 0.04
"""Seconds from one picture to the next, at least."""
_FILM_LONGEST_GAP = 0.1
"""Likewise, at most; of an episode that is longer than 80 such pictures, the beginning is drawn."""


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


@dataclass(frozen=True, slots=True)
class Film:
    """A film in a page.

    Attributes:
        source: Its content, as an address.
        caption: What it shows.
    """

    source: str
    caption: str


@dataclass(frozen=True, slots=True)
class Gallery:
    """Pictures that belong together.

    Attributes:
        stills: The pictures, in order; perhaps none.
        caption: What they show.
        note: Why there are none, or fewer; empty if nothing is missing.
    """

    stills: tuple[Still, ...] = ()
    caption: str = ""
    note: str = ""


def draw_episode(record: RunRecord, episodes: Sequence[PlayedEpisode]) -> Gallery:
    """Draw an episode of a run, from its first to its last control step in equal distances.

    It is a success if there is one, else the first that counts; of a log without ends, what it has
    of an episode. If nothing can be drawn, the picture of the start is shown, if the run has it.

    Args:
        record: The run.
        episodes: Its episodes.
    """
    if record.log is None and not any(episode.log for episode in episodes):
        return _start_picture(
            record, "no pictures: the run has no log, film or picture of its start"
        )
    try:
        episode = _best_episode(episodes) or _unfinished_episode(record)
        if episode is None:
            reason = "no pictures of the log: it has no step that could be drawn"
            return _start_picture(record, reason)
        steps = np.linspace(episode.first_step, episode.last_step, _PICTURES).round().astype(int)
        numbers = list(dict.fromkeys(steps.tolist()))
        stills = _draw(
            episode.log,
            [(episode.env, step) for step in numbers],
            captions=[f"step {step - episode.first_step}" for step in numbers],
            size=_SIZE,
        )
    except EmbodichainError as error:
        return _start_picture(record, f"no pictures of the log: {error}")
    return Gallery(stills, caption=_describe(episode))


def film_episode(
    episodes: Sequence[PlayedEpisode], begin: Callable[[], None] = lambda: None
) -> Film | None:
    """Film the episode that `draw_episode` draws: up to 80 pictures, at least 10 a second.

    Args:
        episodes: The episodes of a run.
        begin: Called before it is drawn, which takes seconds.

    Returns:
        The film, an MP4 where the extra ``video`` is installed, else a GIF. None if no episode has
        ended in a log, or nothing can be drawn: `draw_episode` says why.
    """
    from embodichain import recording
    from embodichain.recording.film.filming import film_log

    episode = _best_episode(episodes)
    if episode is None or episode.log is None:
        return None
    suffix = ".gif" if importlib.util.find_spec("imageio_ffmpeg") is None else ".mp4"
    begin()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"episode{suffix}"
        try:
            with recording.open(episode.log) as log:
                every = _steps_per_picture(episode.length, log.dt)
                last = min(episode.last_step, episode.first_step + every * _FILM_PICTURES - 1)
                film_log(
                    log,
                    path,
                    env=episode.env,
                    first=episode.first_step,
                    last=last,
                    size=_SIZE,
                    every=every,
                )
        except EmbodichainError:
            return None
        source = data_url(path.read_bytes(), _FILM_TYPES[suffix])
    caption = f"drawn from the log for this page: {_describe(episode)}"
    if last < episode.last_step:
        caption += f"; its first {last - episode.first_step + 1} steps"
    return Film(source, caption)


def _steps_per_picture(length: int, dt: float) -> int:
    """Control steps from one picture of a film to the next: of 80 pictures, at 10 to 25 a second.

    Args:
        length: Control steps of the episode.
        dt: Length of a control step in seconds.
    """
    slowest = _FILM_LONGEST_GAP / dt
    fastest = _FILM_SHORTEST_GAP / dt
    return max(1, math.ceil(max(fastest, min(length / _FILM_PICTURES, slowest)) - 1e-9))


def _start_picture(record: RunRecord, reason: str) -> Gallery:
    """The picture of the start, and why there are no others."""
    start = record.folder / "scene.png"
    if not start.is_file():
        return Gallery(note=reason)
    note = "" if record.log is None else reason
    source = data_url(start.read_bytes(), "image/png")
    width, height = _START_SIZE
    return Gallery((Still(source, "the scene at the start", width, height),), note=note)


def _best_episode(episodes: Sequence[PlayedEpisode]) -> PlayedEpisode | None:
    of_log = [episode for episode in counted_episodes(episodes) if episode.log is not None]
    successes = [episode for episode in of_log if episode.success]
    return next(iter(successes or of_log), None)


def _unfinished_episode(record: RunRecord) -> PlayedEpisode | None:
    """The first episode of a log in which none has ended."""
    if record.log is None:
        return None
    from embodichain import recording

    with recording.open(record.log) as log:
        episode = next(iter(log.episodes), None)
    if episode is None:
        return None
    return PlayedEpisode(
        env=episode.env,
        episode=episode.episode,
        length=episode.steps,
        total_reward=episode.total_reward,
        success=None,
        end="" if episode.terminated or episode.truncated else "did not end",
        log=record.log,
        first_step=episode.first_step,
    )


def _describe(episode: PlayedEpisode) -> str:
    """``environment 0, episode 0, 100 control steps: success, time limit``."""
    ends = ["success"] if episode.success else []
    if episode.end and episode.end != "success":
        ends.append(episode.end)
    end = f": {', '.join(ends)}" if ends else ""
    return f"{episode.label}, {episode.length} control steps{end}"


def draw_failures(episodes: Sequence[PlayedEpisode]) -> Gallery:
    """Draw the last control step of failed episodes, at least one of each kind of failure.

    Args:
        episodes: The episodes of a run, perhaps of several logs.
    """
    counted = counted_episodes(episodes)
    failed = [episode for episode in counted if episode.has_failed]
    of_log = [episode for episode in failed if episode.log is not None]
    if not of_log:
        return Gallery()
    try:
        stills = _draw_ends(_choose(of_log))
    except EmbodichainError as error:
        return Gallery(note=f"no pictures of failed episodes: {error}")
    share = f"{len(failed):,} of {len(counted):,} episodes failed"
    if len(stills) < len(failed):
        share += f"; {len(stills)} of them"
    return Gallery(stills, caption=f"{share}, each at its last control step")


def _choose(failed: Sequence[PlayedEpisode]) -> list[PlayedEpisode]:
    """The first of each kind of failure, then others, in their order."""
    kinds: set[str] = set()
    firsts: list[int] = []
    others: list[int] = []
    for index, episode in enumerate(failed):
        (others if episode.end in kinds else firsts).append(index)
        kinds.add(episode.end)
    chosen = [*firsts, *others][:_MOST_FAILURES]
    return [failed[index] for index in sorted(chosen)]


def _draw_ends(episodes: Sequence[PlayedEpisode]) -> tuple[Still, ...]:
    stills: list[Still] = []
    for log in dict.fromkeys(episode.log for episode in episodes):
        of_log = [episode for episode in episodes if episode.log == log]
        stills += _draw(
            log,
            [(episode.env, episode.last_step) for episode in of_log],
            captions=[_describe_failure(episode) for episode in of_log],
            size=_FAILURE_SIZE,
        )
    return tuple(stills)


def _describe_failure(episode: PlayedEpisode) -> str:
    steps = "1 step" if episode.length == 1 else f"{episode.length} steps"
    end = f": {episode.end}" if episode.end else ""
    return f"{episode.label}, {steps}{end}"


def _draw(
    log: Path | None,
    places: Sequence[tuple[int, int]],
    *,
    captions: Sequence[str],
    size: tuple[int, int],
) -> tuple[Still, ...]:
    """Draw environments at control steps; steps that are not in the log are left out.

    Raises:
        LogError: The log has no states, or is damaged.
        RenderError: Nothing can be drawn here.
    """
    from embodichain import recording
    from embodichain.recording.film.moments import Moment, draw_moments

    if log is None:
        return ()
    with recording.open(log) as opened:
        pictures = draw_moments(opened, [Moment(env, step) for env, step in places], size)
    width, height = size
    return tuple(
        Still(data_url(jpeg(picture), "image/jpeg"), caption, width, height)
        for picture, caption in zip(pictures, captions, strict=True)
        if picture is not None
    )


def jpeg(picture: NDArray[np.uint8]) -> bytes:
    """Return an RGB picture, (height, width, 3), as JPEG."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, format="JPEG", quality=_JPEG_QUALITY, optimize=True)
    return stream.getvalue()
