"""EmbodiChain's message functions on Python's `logging`, with the logger ``embodichain.user``.

`log_error` raises, as in EmbodiChain.
"""

from __future__ import annotations

import logging
from typing import Any, NoReturn

__all__ = [
    "decorate_str_color",
    "format_message",
    "log_debug",
    "log_error",
    "log_info",
    "log_warning",
    "set_log_level",
]

_log = logging.getLogger("embodichain.user")
_COLOURS = {
    "red": "91",
    "green": "92",
    "yellow": "93",
    "blue": "94",
    "purple": "95",
    "cyan": "96",
    "orange": "33",
    "white": "97",
}
"""ANSI codes."""
_LEVELS = ("DEBUG", "INFO", "WARNING", "ERROR")


def decorate_str_color(msg: str, color: str | None) -> str:
    """Return text with the ANSI code of a colour around it; unchanged without a colour."""
    code = _COLOURS.get(color or "")
    return msg if code is None else f"\033[{code}m{msg}\033[0m"


def format_message(level: str, message: Any) -> str:
    """Return ``[EmbodiChain LEVEL]: message``."""
    return f"[EmbodiChain {level}]: {message}"


def set_log_level(level: str) -> None:
    """Suppress messages below a level.

    Raises:
        ValueError: If it is not DEBUG, INFO, WARNING or ERROR (in upper or lower case).
    """
    name = level.upper()
    if name not in _LEVELS:
        raise ValueError(f"unknown log level {level!r}; one of: {', '.join(_LEVELS)}")
    _log.setLevel(name)


def log_debug(message: Any, color: str | None = "blue") -> None:
    """Log at level DEBUG."""
    _log.debug("%s", decorate_str_color(format_message("DEBUG", message), color))


def log_info(message: Any, color: str | None = None) -> None:
    """Log at level INFO."""
    _log.info("%s", decorate_str_color(format_message("INFO", message), color))


def log_warning(message: Any) -> None:
    """Log at level WARNING."""
    _log.warning("%s", decorate_str_color(format_message("WARNING", message), "purple"))


def log_error(message: Any, error_type: type[Exception] = RuntimeError) -> NoReturn:
    """Raise an error.

    Args:
        message: Its text.
        error_type: Its class.

    Raises:
        Exception: Always, of class `error_type`.
    """
    raise error_type(format_message("ERROR", message))
