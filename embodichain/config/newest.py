"""Which file of a run is meant: the newest log or checkpoint, one by name. Imports nothing."""

from __future__ import annotations

from pathlib import Path

__all__ = ["CHECKPOINT", "LOG", "named_checkpoint", "newest_run"]

LOG = "rollout.mcap"
"""A run's log, in its folder."""
CHECKPOINT = "checkpoints/final.zip"
"""A training's policy, in its folder."""


def newest_run(output_root: str | Path, holding: str) -> Path | None:
    """Return the folder of the run that began last of those that hold a file, or None.

    Args:
        output_root: Where runs are; the jobs of sweeps count too.
        holding: The file's path in a run's folder; may be a pattern (``*.zip``).
    """
    runs = [file.parent for file in Path(output_root).rglob("config.yaml")]
    found = [run for run in runs if any(file.is_file() for file in run.glob(holding))]
    return max(found, key=_began).resolve() if found else None


def named_checkpoint(path: str | Path) -> Path:
    """Return what exists under a path: itself, or the checkpoint that it names without ``.zip``.

    ``RUN/best`` and ``RUN/checkpoints/best`` are both ``RUN/checkpoints/best.zip``.

    Args:
        path: As typed; is returned as it is where none of these exist.
    """
    given = Path(path)
    file = f"{given.name}.zip"
    choices = (given, given.parent / file, given.parent / Path(CHECKPOINT).parent / file)
    return next((choice for choice in choices if choice.exists()), given)


def _began(run: Path) -> tuple[int, str]:
    """A run's config is written once, when it begins."""
    return (run / "config.yaml").stat().st_mtime_ns, str(run)
