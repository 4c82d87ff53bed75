"""Films as the command line makes them: with progress, and ended by a signal.

`video=true` is here: a film of the first environment, made from a run's log once that is whole.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from embodichain.cli.jobs import Job
    from embodichain.cli.progress import ProgressDisplay
    from embodichain.cli.stopping import StopFlag
    from embodichain.recording.film import Filmed

__all__ = ["VIDEO", "check_film", "ended_early", "film_job", "shown"]

VIDEO = "rollout.mp4"
"""A run's film, in its folder."""
_log = logging.getLogger(__name__)


def check_film(run: Job) -> None:
    """Refuse before anything is simulated where a film is wanted and cannot be encoded.

    Raises:
        ConfigError: The encoder is not installed; names the extra.
    """
    if run.root.video:
        from embodichain.utils.video import need_encoder

        need_encoder()


def shown(display: ProgressDisplay) -> Callable[[Filmed], None]:
    """Return what shows how far a film is."""

    def show(filmed: Filmed) -> None:
        if display.due:
            display.show(filmed.pictures, {"step": f"{filmed.step}"})

    return show


def ended_early(stop: StopFlag, filmed: Filmed, out: Path) -> str:
    """Say what a film holds that a signal ended."""
    if not filmed.pictures:
        return f"interrupted ({stop.stopped}); {out} was not begun"
    till = f"{filmed.pictures} pictures, up to control step {filmed.step}"
    return f"interrupted ({stop.stopped}); {out} is a whole film of the first {till}"


def film_job(run: Job, stop: StopFlag, log: str | Path | None) -> dict[str, str]:
    """Film what a job has logged, if its config says so; comes last, for all else is safe then.

    Args:
        run: The job.
        stop: Its flag ends the film after a picture, and begins none; that is a warning.
        log: Its log, finished; None without.

    Returns:
        ``video``, its path; nothing without a film. If a signal ended it, `stop` says so.

    Raises:
        RenderError: No picture can be drawn here.
    """
    if not run.root.video or log is None:
        return {}
    from embodichain.cli.progress import ProgressDisplay
    from embodichain.recording.film import film_log

    out = run.folder / VIDEO
    quiet = run.root.quiet or run.root.json
    with ProgressDisplay("film", None, "pictures", quiet=quiet) as display:
        filmed = film_log(log, out, progress=shown(display), stop=lambda: stop.stopped is not None)
    if filmed.whole:
        _log.info("%s: %d pictures", out, filmed.pictures)
    else:
        _log.warning("%s", ended_early(stop, filmed, out))
    return {"video": str(out)} if filmed.pictures else {}
