"""`require_open`: what an environment says when it is used after `close`."""

from __future__ import annotations

from gymnasium.error import ClosedEnvironmentError

__all__ = ["require_open"]


def require_open(closed: bool) -> None:
    """Raise Gymnasium's error if an environment is closed.

    Raises:
        gymnasium.error.ClosedEnvironmentError: If it is.
    """
    if closed:
        raise ClosedEnvironmentError(
            "the environment was closed, which freed its simulation: make another one, and "
            "close() each after its last use"
        )
