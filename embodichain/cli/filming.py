"""`video=true`: a film of the first environment, made from a run's log once that is whole."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from embodichain.cli.jobs import Job

__all__ = ["VIDEO", "check_film", "film_job"]

VIDEO = "rollout.mp4"
"""A run's film, in its folder."""


def check_film(run: Job) -> None:
    """Refuse before anything is simulated where a film is wanted and cannot be encoded.

    Raises:
        ConfigError: The encoder is not installed; names the extra.
    """
    if run.root.video:
        from embodichain.utils.video import need_encoder

        need_encoder()


def film_job(run: Job, log: str | Path | None) -> dict[str, str]:
    """Film what a job has logged, if its config says so; comes last, for all else is safe then.

    Args:
        run: The job.
        log: Its log, finished; None without.

    Returns:
        ``video``, its path; nothing without a film.

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

        def progress(pictures: int) -> None:
            if display.due:
                display.show(pictures, {})

        film_log(log, out, progress=progress)
    return {"video": str(out)}
