"""Overrides as people type them: written for Hydra's grammar, or refused in plain words.

Hydra's lexer knows ASCII letters and few signs. A value such as ``output_dir=größe`` or
``policy=runs/seed=0/best`` is put in quotes, item by item; what is quoted already stays.
"""

from __future__ import annotations

import re

from embodichain.config.composition.locate import COMMAND_LINE
from embodichain.utils.errors import Problem

__all__ = ["malformed", "readable"]

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
    texts: list[str] = []
    open_brackets: list[str] = []
    for piece in _PIECES.finditer(value):
        text = piece[0]
        if piece["sign"] and text in "[{(":
            open_brackets.append(text)
        elif piece["sign"] and text in "]})" and open_brackets:
            open_brackets.pop()
        if piece["word"]:
            text = _quoted_words(text, inside=open_brackets[-1] if open_brackets else "")
        texts.append(text)
    return f"{key}={''.join(texts)}"


def _quoted_words(text: str, inside: str) -> str:
    """A word with quotes if it needs them. Keys of maps cannot have any."""
    if inside == "{":
        key, colon, value = text.partition(":")
        if not colon:
            return _quoted(text)
        return f"{key}:{_quoted(value)}"
    if inside == "(" and "=" in text:  # a named argument of a function: sort(1,2,reverse=true)
        name, _, rest = text.partition("=")
        return f"{name}={_quoted(rest)}"
    return _quoted(text)


def _quoted(text: str) -> str:
    """A text with quotes, if Hydra cannot read it without."""
    bare = text.strip()
    if not _UNKNOWN.search(re.sub(r"\$\{[^{}]*(?:\{[^{}]*\}[^{}]*)*\}", "", bare)):
        return text
    unescaped = re.sub(r"\\([\\()\[\]{}:=, \t])", r"\1", bare)
    inner = unescaped.replace("\\", "\\\\").replace("'", "\\'")
    return text.replace(bare, f"'{inner}'", 1)


def malformed(line: str, error: Exception | str) -> Problem:
    """Return the mistake of an override that Hydra cannot parse.

    Args:
        line: As typed.
        error: Hydra's error, or the reason.
    """
    key, _, value = line.partition("=")
    reason = str(error).splitlines()[0]
    if not key.isascii():
        reason = "names of keys are ASCII letters here; others can be written in a file"
    elif "=" not in line:
        reason = "it has no ="
    elif any(value.count(a) != value.count(b) for a, b in ("[]", "{}", "()")):
        reason = "it has a bracket without its other one"
    elif value.rstrip().endswith(","):
        reason = "it ends with a comma"
    elif value.count("'") % 2 or value.count('"') % 2:
        reason = "it has a quote without its other one"
    else:
        reason = reason.partition(" expecting {")[0]  # a list of the grammar's own names
    message = f"malformed override {line!r}: {reason}; expected key=value, +key=value or ~key"
    return Problem("", message, source=COMMAND_LINE)
