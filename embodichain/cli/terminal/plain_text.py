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
    **{"±": "+-", "×": "x", "…": "...", "–": "-", "—": "-", "→": "->", "≤": "<=", "≥": ">="},
    **{"≈": "~", "°": " deg", "µ": "u", "μ": "u", "·": ".", "•": "*", "²": "^2", "³": "^3"},
    **dict.fromkeys("─━╸╺═", "-"),
    **dict.fromkeys("│┃║", "|"),
    **dict.fromkeys("‘’", "'"),
    **dict.fromkeys("“”„", '"'),
    **dict(zip("▁▂▃▄▅▆▇█", "_.-=+*##", strict=True)),
}
"""What is written for characters that this program prints, where they cannot be encoded."""
_FIRST_BYTE, _LAST_BYTE = 0xDC80, 0xDCFF
"""Surrogates by which Python represents bytes of a path that are not text."""


def _replace(error: UnicodeError) -> tuple[str | bytes, int]:
    r"""Return what is written for characters that an encoding lacks: plain ones, or ``\xNN``."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    wrong = error.object[error.start]
    end = error.start + 1
    if wrong in _PLAIN:
        return _PLAIN[wrong], end
    if _FIRST_BYTE <= ord(wrong) <= _LAST_BYTE:
        return bytes([ord(wrong) - 0xDC00]), end
    return wrong.encode("ascii", "backslashreplace"), end


codecs.register_error(_HANDLER, _replace)


@contextmanager
def degrading_text() -> Iterator[None]:
    """Within it, stdout and stderr take every text: what they cannot encode is written plainly."""
    streams = [s for s in (sys.stdout, sys.stderr) if isinstance(s, io.TextIOWrapper)]
    before = [stream.errors for stream in streams]
    for stream in streams:
        stream.reconfigure(errors=_HANDLER)
    try:
        yield
    finally:
        for stream, errors in zip(streams, before, strict=True):
            if not stream.closed:
                with suppress(OSError):  # reconfigure flushes, and the pipe may be closed
                    stream.reconfigure(errors=errors)
