"""Which run is the newest one that holds a certain file: a log, a checkpoint. Imports nothing."""

from __future__ import annotations

from pathlib import Path

__all__ = ["CHECKPOINT", "LOG", "newest_run"]

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


def _began(run: Path) -> tuple[int, str]:
    """A run's config is written once, when it begins."""
    return (run / "config.yaml").stat().st_mtime_ns, str(run)
