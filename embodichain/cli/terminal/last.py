"""The word `last`: each verb says which run it took, and its record has the path."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import click

from embodichain.config.composition.locate import display_path

__all__ = ["take_last", "with_paths"]

_WORD = "last"
_TAKEN = "embodichain.last"
"""Key of the path in the context of the command."""


def take_last(path: Path) -> Path:
    """Say on stderr which run or file ``last`` is, unless the command is quiet.

    Args:
        path: What a verb has found.

    Returns:
        The path.
    """
    context = click.get_current_context(silent=True)
    shown = display_path(path)
    if context is not None:
        context = context.find_root()
        if context.meta.get(_TAKEN) == shown:
            return path
        context.meta[_TAKEN] = shown
    if context is None or not {"--quiet", "-q", "quiet=true"} & set(context.obj or ()):
        sys.stderr.write(f"last: {shown}\n")
    return path


def with_paths(command: Sequence[str]) -> list[str]:
    """Return a command line with the path that was taken in place of ``last``."""
    context = click.get_current_context(silent=True)
    path = None if context is None else context.find_root().meta.get(_TAKEN)
    if path is None:
        return list(command)
    ends = {f"{key}={_WORD}": f"{key}={path}" for key in ("policy", "resume", "dataset")}
    return [path if word == _WORD else ends.get(word, word) for word in command]
