"""Overrides as people type them, written so that Hydra's grammar reads them.

Hydra's lexer knows ASCII letters and few signs. A value such as ``output_dir=größe`` or
``policy=runs/seed=0/best`` is put in quotes, item by item; what is quoted already stays.
"""

from __future__ import annotations

import re

__all__ = ["readable"]

_UNKNOWN = re.compile(r"[^\x00-\x7f]|[!#&;<>^`~=]")
"""Characters that have no meaning without quotes in a value."""
_PIECES = re.compile(
    r"""(?P<quoted>'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*")"""
    r"""|(?P<sign>[,\[\]{}()])"""
    r"""|(?P<word>(?:\\.|\$\{[^{}]*(?:\{[^{}]*\}[^{}]*)*\}|[^,\[\]{}()'"\\])+)"""
    r"""|(?P<other>.)""",
    re.DOTALL,
)


def readable(line: str) -> str:
    """Return an override whose values Hydra can read; unchanged if it can already.

    Args:
        line: ``key=value``, as typed; sweeps, lists, maps and quotes may occur in the value.
    """
    key, equals, value = line.partition("=")
    if not equals or not _UNKNOWN.search(value):
        return line
    found: list[str] = []
    depth: list[str] = []
    for piece in _PIECES.finditer(value):
        text = piece[0]
        if piece["sign"] and text in "[{(":
            depth.append(text)
        elif piece["sign"] and text in "]})" and depth:
            depth.pop()
        if piece["word"]:
            text = _quoted_words(text, inside=depth[-1] if depth else "")
        found.append(text)
    return f"{key}={''.join(found)}"


def _quoted_words(text: str, inside: str) -> str:
    """A word with quotes if it needs them. Keys of maps cannot have any."""
    if inside == "{":
        key, colon, value = text.partition(":")
        return f"{key}{colon}{_quoted(value)}" if colon else _quoted(text)
    if inside == "(" and "=" in text:  # a named argument of a function: sort(1,2,reverse=true)
        name, _, rest = text.partition("=")
        return f"{name}={_quoted(rest)}"
    return _quoted(text)


def _quoted(text: str) -> str:
    bare = text.strip()
    if not _UNKNOWN.search(re.sub(r"\$\{[^{}]*(?:\{[^{}]*\}[^{}]*)*\}", "", bare)):
        return text
    unescaped = re.sub(r"\\([\\()\[\]{}:=, \t])", r"\1", bare)
    inner = unescaped.replace("\\", "\\\\").replace("'", "\\'")
    return text.replace(bare, f"'{inner}'", 1)
