"""`no_programs`: Pillow reads pictures without starting another program."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["no_programs"]


@contextmanager
def no_programs() -> Iterator[None]:
    """Let Pillow start no program while a picture is opened and read.

    Pillow finds the format of a picture in its bytes, whatever its name is, and gives PostScript to
    Ghostscript. With Pillow's setting for that, which is restored, such a picture is an `OSError`.
    """
    from PIL import EpsImagePlugin

    before = EpsImagePlugin.gs_binary
    EpsImagePlugin.gs_binary = False
    try:
        yield
    finally:
        EpsImagePlugin.gs_binary = before
