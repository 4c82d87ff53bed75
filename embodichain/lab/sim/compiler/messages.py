"""MuJoCo's error texts, made readable: one line, and the line of the file if it names one.

Raised by callers as `ConfigError`; nothing here parses models.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import mujoco

__all__ = ["MUJOCO_ERRORS", "as_line"]

MUJOCO_ERRORS = (ValueError, RuntimeError, mujoco.FatalError)
"""What MuJoCo's bindings raise for a model it cannot parse or compile."""

_LINE = re.compile(r",? *\bline(?: number)? *[=:]? *(\d+)", re.IGNORECASE)
_ELEMENT = re.compile(r"\s*Element (?:name )?'(?P<name>[^']*)'(?:, id \d+)?")
_XML_CODE = re.compile(
    r"XML parse error \d+:\s*Error=XML_ERROR_(?P<code>\w+) ErrorID=\d+ *(?:\(\w+\))?"
)
_PREFIXES = ("Error: ", "XML Error: ", "Schema violation: ")


def as_line(
    error: Exception, line_of: Callable[[int], int | None] | None = None
) -> tuple[str, int | None]:
    """Return a MuJoCo error as one line of text, and the line of the file it names, if any.

    Args:
        error: What MuJoCo raised.
        line_of: Maps a line of the text MuJoCo read to one of the user's file; None: the same.
    """
    text = str(error).strip()
    found = _LINE.search(text)
    line = int(found[1]) if found else None
    if line is not None and line_of is not None:
        line = line_of(line)
    text = _LINE.sub("", text)
    text = _XML_CODE.sub(lambda m: m["code"].replace("_", " ").lower(), text)
    text = _ELEMENT.sub(lambda m: f" (element {m['name']!r})" if m["name"] else "", text)
    for prefix in _PREFIXES:
        text = text.removeprefix(prefix)
    return " ".join(text.split()).rstrip(" :"), line
