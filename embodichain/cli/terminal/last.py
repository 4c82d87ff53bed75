"""The word `last`, the link `latest`: verbs say which run it is, and their record has its path."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import click

from embodichain.config.composition.locate import display_path
from embodichain.config.run_folder import LATEST

__all__ = ["announce_last", "replace_last", "resolve_links"]

_WORD = "last"
_PATH_KEY = "embodichain.last"
"""Key of the path in the context of the command."""


def announce_last(path: Path) -> Path:
    """Say on stderr which run or file ``last`` is, unless the command is quiet.

    Args:
        path: The run or file that a verb has found.

    Returns:
        The path.
    """
    context = click.get_current_context(silent=True)
    shown = display_path(path)
    is_quiet = False
    if context is not None:
        root = context.find_root()
        if root.meta.get(_PATH_KEY) == shown:  # said already
            return path
        root.meta[_PATH_KEY] = shown
        is_quiet = bool({"--quiet", "-q", "quiet=true"} & set(root.obj or ()))
    if not is_quiet:
        sys.stderr.write(f"last: {shown}\n")
    return path


def replace_last(command: Sequence[str]) -> list[str]:
    """Return a command line with the path that was taken in place of ``last``."""
    context = click.get_current_context(silent=True)
    path = None if context is None else context.find_root().meta.get(_PATH_KEY)
    if path is None:
        return list(command)
    replacements = {_WORD: path}
    for key in ("policy", "resume", "dataset"):
        replacements[f"{key}={_WORD}"] = f"{key}={path}"
    return [replacements.get(word, word) for word in command]


def resolve_links(command: Sequence[str]) -> list[str]:
    """Return a command line with the run's path in place of the link ``latest``.

    To be called before the run of this command has a folder: then the link leads to that.
    """
    return [_without_link(word) for word in command]


def _without_link(word: str) -> str:
    """``policy=outputs/latest`` as ``policy=outputs/2026-01-31/12-00-00_reach``."""
    key, separator, value = word.rpartition("=")
    parts = Path(value).parts
    if LATEST not in parts:
        return word
    end = parts.index(LATEST) + 1
    link = Path(*parts[:end])
    if not link.is_symlink() or not link.exists():
        return word
    path = Path(display_path(link), *parts[end:])
    return f"{key}{separator}{path}"
