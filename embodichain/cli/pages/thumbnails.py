"""`Thumbnails`: a small picture of each run of an index."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from embodichain.cli.pages.galleries import jpeg
from embodichain.cli.pages.page import data_url
from embodichain.cli.pages.run_record import RunRecord
from embodichain.utils.errors import EmbodichainError
from embodichain.utils.system.atomic import atomic_file

__all__ = ["Thumbnail", "Thumbnails"]

_FILE = "thumbnail.jpg"
"""Name of a picture that was drawn from a run's log, in the run's folder."""
_SIZE = (192, 144)
_DRAWN_SIZE = (384, 288)


@dataclass(frozen=True, slots=True)
class Thumbnail:
    """A small picture, as the address of its content."""

    source: str


class Thumbnails:
    """Finds or draws pictures of runs.

    A run has the picture of its start, or the first one of its film; otherwise its log is drawn,
    which takes a second, and the picture stays in its folder.

    Args:
        say: Called with a line before the first log is drawn.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say: Callable[[str], None] | None = say
        self._problems: dict[str, list[str]] = {}

    @property
    def notes(self) -> list[str]:
        """Why runs have no picture."""
        return [
            f"no picture of {', '.join(names[:3])}{' and more' if len(names) > 3 else ''}: {text}"
            for text, names in self._problems.items()
        ]

    def of(self, record: RunRecord) -> Thumbnail | None:
        """Return the picture of a run; None if it has nothing to draw."""
        folder = record.folder
        drawn = folder / _FILE
        if drawn.is_file() and not _is_older(drawn, record.log):
            return Thumbnail(data_url(drawn.read_bytes(), "image/jpeg"))
        for path in (folder / "scene.png", *sorted(folder.glob("[!.]*.gif"))):
            if path.is_file():
                picture = _reduced(path)
                if picture is not None:
                    return Thumbnail(data_url(picture, "image/jpeg"))
        if record.log is None:
            return None
        if self._say is not None:
            self._say(f"drawing pictures of runs, once: they stay in their folders, as {_FILE}")
            self._say = None
        try:
            picture = _draw(record.log)
        except EmbodichainError as error:
            text = str(error).replace(f"{record.log}", "the log")
            self._problems.setdefault(text, []).append(folder.name)
            return None
        if picture is None:
            return None
        # A folder that only may be read has its picture drawn each time.
        with suppress(OSError), atomic_file(drawn) as temporary:
            temporary.write_bytes(picture)
        return Thumbnail(data_url(picture, "image/jpeg"))


def _is_older(path: Path, log: Path | None) -> bool:
    """Whether a file is older than the log, which a resumed run continues."""
    return log is not None and path.stat().st_mtime_ns < log.stat().st_mtime_ns


def _reduced(path: Path) -> bytes | None:
    """A picture, or the first one of a GIF, as a small JPEG; None if it is damaged."""
    import numpy as np
    from PIL import Image

    try:
        with Image.open(path) as image:
            return jpeg(np.asarray(image.convert("RGB").resize(_SIZE)))
    except (OSError, ValueError, Image.DecompressionBombError):
        return None


def _draw(log: Path) -> bytes | None:
    """The middle of the first episode of a log, which shows more of a task than its start."""
    import numpy as np
    from PIL import Image

    from embodichain import recording
    from embodichain.recording.film.moments import Moment, draw_moments

    with recording.open(log) as opened:
        episode = next(iter(opened.episodes), None)
        if episode is None:
            return None
        moment = Moment(episode.env, (episode.first_step + episode.last_step) // 2)
        picture = draw_moments(opened, [moment], _DRAWN_SIZE)[0]
    if picture is None:
        return None
    return jpeg(np.asarray(Image.fromarray(picture).resize(_SIZE, Image.Resampling.LANCZOS)))
