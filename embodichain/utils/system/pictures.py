"""`open_picture`: pictures of files that other people made, read without starting a program.

Pillow finds the format of a picture in its bytes, whatever its name is, and gives PostScript, which
is a program, to Ghostscript when the pixels are read.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL.Image import Image

__all__ = ["open_picture", "refuse_postscript"]

_HEADER = b"%!PS-Adobe"
"""In every file that Pillow takes for PostScript: its reader requires this comment."""
_DATA_URI = re.compile(rb"data:[^\"',]*;base64,([A-Za-z0-9+/=\s]+)")
_REASON = "it is PostScript, which only a program could draw"


@contextmanager
def open_picture(path: Path) -> Iterator[Image]:
    """Open a picture; its pixels are read when they are needed, as by `PIL.Image.open`.

    Args:
        path: The file.

    Raises:
        OSError: It cannot be read, is not a picture, or is PostScript.
    """
    from PIL import Image

    with Image.open(path) as image:
        if image.format == "EPS":
            raise OSError(_REASON)
        yield image


def refuse_postscript(data: bytes) -> None:
    """Check bytes in which another library will look for pictures, also those in data URIs.

    Args:
        data: The content of a file.

    Raises:
        OSError: They contain PostScript.
    """
    contents = [data, *(base64.b64decode(text) for text in _DATA_URI.findall(data))]
    if any(_HEADER in content for content in contents):
        raise OSError(_REASON)
