"""`open`, `inspect` and `verify` for any log: of one process, or of a batch in shards."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from embodichain.config.run_folder import LOG, SHARDS
from embodichain.recording.check import verification
from embodichain.recording.read import summary
from embodichain.recording.read.api import Log
from embodichain.recording.shards.shard_logs import SHARDS_SUFFIX

__all__ = ["inspect", "open", "shards_of", "verify"]


def shards_of(path: str | Path) -> Path | None:
    """The manifest of the shards that a path names, itself or as a run's folder; else None."""
    path = Path(path)
    if path.name.endswith(SHARDS_SUFFIX):
        return path
    manifest = path / SHARDS
    if path.is_dir() and not (path / LOG).exists() and manifest.exists():
        return manifest
    return None


def open(path: str | Path, simulate: bool = False) -> Log:
    """Open a log; its messages are read on demand. Close it, or use `with`.

    A broken file is read up to the first damage: `complete` is False, and `warnings` says why.

    Args:
        path: A log, the manifest of a log in several files or of a batch in shards, or the folder
            of a run. The first of several files opens all of them; any other is opened alone.
        simulate: With `record.state=keyframes`: whether states between keyframes are simulated
            again, from the file alone. Otherwise only keyframes are read.

    Raises:
        ConfigError: If the file is missing, empty or not MCAP.
        LogError: If it is not an embodichain log.
    """
    manifest = shards_of(path)
    if manifest is None:
        return Log(path, simulate)
    from embodichain.recording.shards.sharded_log import ShardedLog

    return ShardedLog(manifest, simulate)


def inspect(path: str | Path) -> summary.LogSummary:
    """Read a log once and return its summary; see `recording.read.summary.inspect`."""
    manifest = shards_of(path)
    if manifest is None:
        return summary.inspect(path)
    from embodichain.recording.shards.sharded_log import inspect_shards

    return inspect_shards(manifest)


def verify(
    path: str | Path,
    env: int | None = None,
    episode: int | None = None,
    num_threads: int = 0,
    progress: Callable[[int], None] | None = None,
    images: bool = False,
) -> verification.VerifyReport:
    """Simulate a log again and compare every row; see `recording.check.verification.verify`."""
    manifest = shards_of(path)
    if manifest is None:
        return verification.verify(
            path,
            env=env,
            episode=episode,
            num_threads=num_threads,
            progress=progress,
            images=images,
        )
    from embodichain.recording.shards.sharded_log import verify_shards

    return verify_shards(
        manifest,
        env=env,
        episode=episode,
        num_threads=num_threads,
        progress=progress,
        images=images,
    )
