"""What a training says when its folder cannot be written: the disk is full, the folder is gone."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from embodichain.learning.keeper import find_resumable
from embodichain.utils.errors import ConfigError, EmbodichainError

__all__ = ["WriteError", "telling_where"]


class WriteError(EmbodichainError):
    """A training's folder cannot be written; says what is in it and how to go on."""


@contextmanager
def telling_where(run_dir: Path) -> Iterator[None]:
    """Turn the system's errors into one that names the folder and its newest checkpoint.

    Args:
        run_dir: The training's folder.

    Raises:
        WriteError: Something could not be written.
    """
    try:
        yield
    except OSError as error:
        why = f"{run_dir} could not be written: {error.strerror or error}"
        raise WriteError(f"{why}; {_what_remains(run_dir)}") from error


def _what_remains(run_dir: Path) -> str:
    try:
        checkpoint, _ = find_resumable(run_dir)
    except (ConfigError, OSError):
        return "it holds no checkpoint to go on from yet"
    command = f"embodichain train resume={run_dir}"
    return f"with room again, `{command}` goes on from its {checkpoint.name}"
