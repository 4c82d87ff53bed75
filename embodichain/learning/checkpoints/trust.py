"""`NeedsTrust`: a file that can only be read by running code of it."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from pathlib import Path

from embodichain.utils.errors import ConfigError, Problem

__all__ = ["TRUST", "NeedsTrust", "listed", "needs_trust", "say_trusted"]

TRUST = "trust=true"
"""Override of the command line that runs code of a policy's file."""
_MOST_NAMES = 12
_log = logging.getLogger(__name__)


class NeedsTrust(ConfigError):
    """A file was not read, as that would run code of it."""


def needs_trust(file: Path, why: str, names: Iterable[str]) -> NeedsTrust:
    """Return the error about a file that needs trust.

    Args:
        file: The file.
        why: What in it is not data.
        names: Functions and classes that would be run.
    """
    message = f"{file} cannot be read without running code of it: {why}. "
    hint = f"{TRUST} (replay: --trust) runs it, as a program of whoever made the file."
    return NeedsTrust([Problem("policy", f"{message}It would run {listed(names)}", hint)])


def say_trusted(file: Path, names: Iterable[str]) -> None:
    """Log that code of a file is run, and which."""
    _log.warning("%s: %s runs %s", TRUST, file, listed(names))


def listed(names: Iterable[str]) -> str:
    """Return the first names of functions and classes as a list in words."""
    all_names = list(names)
    text = ", ".join(all_names[:_MOST_NAMES]) or "what cannot be told"
    more = len(all_names) - _MOST_NAMES
    if more > 0:
        return f"{text} and {more} more"
    return text
