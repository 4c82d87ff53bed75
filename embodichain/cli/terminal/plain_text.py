"""`degrading_text`: output on terminals whose encoding lacks a character, such as ASCII."""

from __future__ import annotations

import codecs
import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

__all__ = ["degrading_text"]

_HANDLER = "embodichain.plain"
_PLAIN = {
    "±": "+-",
    "×": "x",
    "…": "...",
    "–": "-",
    "—": "-",
    "→": "->",
    "≤": "<=",
    "≥": ">=",
    "≈": "~",
    "°": " deg",
    "µ": "u",
    "μ": "u",
    "·": ".",
    "•": "*",
    "²": "^2",
    "³": "^3",
    **dict.fromkeys("─━╸╺═", "-"),
    **dict.fromkeys("│┃║", "|"),
    **dict.fromkeys("‘’", "'"),
    **dict.fromkeys("“”„", '"'),
    **dict(zip("▁▂▃▄▅▆▇█", "_.-=+*##", strict=True)),
}
"""Replacements of characters that this program prints, where they cannot be encoded."""
_BYTE_SURROGATES = range(0xDC80, 0xDCFF + 1)
"""Surrogates by which Python represents bytes of a path that are not text (PEP 383)."""


def _replace(error: UnicodeError) -> tuple[str | bytes, int]:
    r"""Replace a character that an encoding lacks: by a plain one, or by ``\xNN``.

    Returns:
        The replacement, and the index from which encoding continues.
    """
    if not isinstance(error, UnicodeEncodeError):
        raise error
    character = error.object[error.start]
    end = error.start + 1
    if character in _PLAIN:
        return _PLAIN[character], end
    if ord(character) in _BYTE_SURROGATES:
        return bytes([ord(character) - 0xDC00]), end
    return character.encode("ascii", "backslashreplace"), end


codecs.register_error(_HANDLER, _replace)


@contextmanager
def degrading_text() -> Iterator[None]:
    """Let stdout and stderr replace characters that they cannot encode by plain ones."""
    streams = [
        stream for stream in (sys.stdout, sys.stderr) if isinstance(stream, io.TextIOWrapper)
    ]
    handlers = [stream.errors for stream in streams]
    for stream in streams:
        stream.reconfigure(errors=_HANDLER)
    try:
        yield
    finally:
        for stream, errors in zip(streams, handlers, strict=True):
            if not stream.closed:
                with suppress(OSError):  # reconfigure flushes, and the pipe may be closed
                    stream.reconfigure(errors=errors)
