"""How a command ends: exit codes, the exception of an interrupted run, the report of an error."""

from __future__ import annotations

import sys
import traceback

from embodichain.utils.errors import ConfigError

__all__ = ["FAILED", "INTERRUPTED", "OK", "WRONG_INPUT", "Interrupted", "report"]

OK = 0
FAILED = 1
"""The run, or the check that was asked for, failed."""
WRONG_INPUT = 2
"""The user's input is wrong; nothing was started."""
INTERRUPTED = 130
"""Ctrl-C, SIGTERM or SIGUSR2; what was written is complete up to there."""


class Interrupted(KeyboardInterrupt):
    """A signal ended the run after everything was closed.

    A KeyboardInterrupt, so that a sweep ends with its job.
    """


def report(error: BaseException, *, full: bool = False) -> int:
    """Say on stderr what went wrong and return the exit code.

    Args:
        error: What was raised.
        full: Whether to print the whole traceback (`--traceback`).

    Returns:
        2 when the user's input is wrong, 130 when somebody stopped the run, else 1.
    """
    if full and not isinstance(error, Interrupted):
        traceback.print_exception(error, file=sys.stderr)
    if isinstance(error, KeyboardInterrupt):
        _say(str(error) or "interrupted")
        return INTERRUPTED
    if isinstance(error, ConfigError):
        _say(_mistakes(error))
        return WRONG_INPUT
    hint = "" if full else "\n(--traceback shows where it happened)"
    _say(f"error: {_line(error)}{hint}")
    return FAILED


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
