"""How an exception becomes a readable report and an exit code. Finds no mistakes itself."""

from __future__ import annotations

import sys
import traceback

from embodichain.cli import exits
from embodichain.utils.errors import ConfigError

__all__ = ["report"]


def report(error: BaseException, *, full: bool = False) -> int:
    """Say on stderr what went wrong and return the exit code.

    Args:
        error: What was raised.
        full: Whether to print the whole traceback (`--traceback`).

    Returns:
        2 when the user's input is wrong, 130 when somebody stopped the run, else 1.
    """
    if full and not isinstance(error, exits.Interrupted):
        traceback.print_exception(error, file=sys.stderr)
    if isinstance(error, KeyboardInterrupt):
        _say(str(error) or "interrupted")
        return exits.INTERRUPTED
    if isinstance(error, ConfigError):
        _say(_mistakes(error))
        return exits.WRONG_INPUT
    hint = "" if full else "\n(--traceback shows where it happened)"
    _say(f"error: {_line(error)}{hint}")
    return exits.FAILED


def _mistakes(error: ConfigError) -> str:
    """Every mistake, one paragraph each; what a mistake lists is indented below it."""
    if len(error.problems) < 2:
        return f"error: {error}"
    texts = (str(problem).replace("\n", "\n    ") for problem in error.problems)
    return "\n".join([f"{len(error.problems)} mistakes:", *(f"  {text}" for text in texts)])


def _line(error: BaseException) -> str:
    """The exception in one line: its type, unless it is our own and says enough."""
    text = " ".join(str(error).split())
    name = type(error).__name__
    if type(error).__module__.startswith("embodichain."):
        return text or name
    return f"{name}: {text}" if text else name


def _say(text: str) -> None:
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()
