"""Encoders of pictures: JPEG and PNG by Pillow, H.264 by PyAV (extra `h264`)."""

from __future__ import annotations

import importlib.util
import io
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from embodichain.utils.errors import ConfigError, Problem

__all__ = ["Encoder", "H264Encoder", "encoder_of", "jpeg", "need_h264", "png"]

_JPEG_QUALITY = 90
_PNG_LEVEL = 3
_SLOWEST = Fraction(1, 1000)
"""Pictures a second: the encoder needs a rate above zero."""
_COLORS = "colorprim=bt709:transfer=iec61966-2-1:colormatrix=smpte170m:range=tv"
"""sRGB, and FFmpeg's conversion to YUV. Unnamed, players assume another one from 720 lines on."""
_X264 = f"scenecut=0:repeat-headers=1:annexb=1:bframes=0:{_COLORS}"


Encoder = Callable[[NDArray[np.uint8]], bytes]
"""Encodes the (H, W, 3) pictures of one camera, one after another."""


def encoder_of(name: str, width: int, height: int, rate: float) -> Encoder:
    """A new encoder: ``h264``, ``jpeg`` or ``png``.

    Args:
        name: The format.
        width: Pixels.
        height: Pixels.
        rate: About how many pictures a second there are.

    Raises:
        ConfigError: If it needs a package that is not installed.
    """
    if name == "h264":
        return H264Encoder(width, height, rate)
    if name == "jpeg":
        return jpeg
    return png


def jpeg(rgb: NDArray[np.uint8]) -> bytes:
    """A picture (H, W, 3) as JPEG."""
    stream = io.BytesIO()
    Image.fromarray(rgb).save(stream, "JPEG", quality=_JPEG_QUALITY)
    return stream.getvalue()


def png(rgb: NDArray[np.uint8]) -> bytes:
    """A picture (H, W, 3) as PNG."""
    stream = io.BytesIO()
    Image.fromarray(rgb).save(stream, "PNG", compress_level=_PNG_LEVEL)
    return stream.getvalue()


def need_h264() -> None:
    """Raise `ConfigError` if PyAV is not installed."""
    if importlib.util.find_spec("av") is None:
        hint = "pip install 'embodichain[h264]', or choose jpeg or png"
        raise ConfigError([Problem("record.images.format", "h264 needs the package av", hint)])


class H264Encoder:
    """H.264 as Foxglove needs it: Annex B, no B frames, parameter sets with every IDR picture.

    Each picture gives its own access unit at once. The first one, and one about every second, can
    be decoded without those before it.

    Args:
        width: Pixels, even.
        height: Pixels, even.
        rate: Pictures a second.

    Raises:
        ConfigError: If PyAV is not installed.
    """

    def __init__(self, width: int, height: int, rate: float) -> None:
        need_h264()
        import av

        per_second = max(_SLOWEST, Fraction(rate).limit_denominator(1000))
        self._av: Any = av
        self._codec: Any = av.CodecContext.create("libx264", "w")
        self._codec.width = width
        self._codec.height = height
        self._codec.pix_fmt = "yuv420p"
        self._codec.time_base = 1 / per_second
        self._codec.framerate = per_second
        self._codec.gop_size = max(1, round(rate))
        self._codec.thread_count = 1
        self._codec.options = {
            "preset": "veryfast",
            "tune": "zerolatency",
            "crf": "20",
            "x264-params": _X264,
        }
        self._count = 0

    def __call__(self, rgb: NDArray[np.uint8]) -> bytes:
        """Encode an (H, W, 3) picture: one access unit."""
        frame = self._av.VideoFrame.from_ndarray(rgb, format="rgb24")
        frame.pts = self._count
        self._count += 1
        return b"".join(bytes(packet) for packet in self._codec.encode(frame))
