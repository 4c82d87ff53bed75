"""Exit codes, and the exception of a run that somebody stopped. Says nothing on the terminal."""

from __future__ import annotations

__all__ = ["FAILED", "INTERRUPTED", "OK", "WRONG_INPUT", "Interrupted"]

OK = 0
FAILED = 1
"""The run, or the check that was asked for, failed."""
WRONG_INPUT = 2
"""What the user gave is wrong; nothing was started."""
INTERRUPTED = 130
"""Ctrl-C, SIGTERM or SIGUSR2; what was written is complete up to there."""


class Interrupted(KeyboardInterrupt):
    """A signal ended the run after everything was closed.

    A KeyboardInterrupt, so that a sweep ends with its job.
    """
