"""`film_file`: an MP4 (`VideoFile`) or a GIF (`GifFile`), written frame by frame.

MP4 needs the extra `video` (imageio-ffmpeg).
"""

from __future__ import annotations

import errno
import importlib.util
import os
import struct
import subprocess
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import IO, TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.system.atomic import remove_abandoned, temporary_name

if TYPE_CHECKING:
    from PIL.Image import Image

__all__ = [
    "GIF",
    "Film",
    "GifFile",
    "VideoFile",
    "film_file",
    "film_suffix",
    "has_encoder",
    "need_encoder",
]

GIF = ".gif"
_UNCHANGED = 255
"""Index of a GIF's pixel that stays as it was: the palette has 255 colours before it."""
_MOST_COLORS = 8192
"""Colours that are looked at one by one; of more, one in each cell of 4 x 4 x 4 levels."""
_CELL = np.uint32(0xFCFCFC)
_FREQUENCY_POWER = 0.25
"""How much the number of pixels of a colour counts."""
_KEEP = 1
"""What is drawn stays until it is drawn over."""
_QUALITY = "25"
"""Constant rate factor of x264: 0 is lossless, 51 the worst."""
_COLORS = (
    *("-vf", "setparams=color_primaries=bt709:color_trc=iec61966-2-1"),
    *("-colorspace", "smpte170m", "-color_range", "tv"),
)
"""sRGB, and FFmpeg's conversion to YUV. Unnamed, players assume another one from 720 lines on."""


def has_encoder() -> bool:
    """Whether MP4 can be written: the extra `video` is installed."""
    return importlib.util.find_spec("imageio_ffmpeg") is not None


def film_suffix(kind: str | None) -> str:
    """The suffix of a film of a kind, ``mp4`` or ``gif``; None is MP4 if it can be written."""
    if kind is None:
        return ".mp4" if has_encoder() else GIF
    return f".{kind}"


def need_encoder(suffix: str = ".mp4", instead: str = "") -> None:
    """Check that the encoder is installed.

    Args:
        suffix: Of the file; a GIF needs none.
        instead: What else the user can do, for the hint.

    Raises:
        ConfigError: If it is not; names the extra.
    """
    if suffix != GIF and not has_encoder():
        hint = "pip install 'embodichain[video]'"
        if instead:
            hint += f", or {instead}"
        raise ConfigError([Problem("", "videos need the package imageio-ffmpeg", hint)])


class Film(ABC):
    """A film, renamed to its path when complete.

    As a context manager it is closed at exit, or discarded after an exception.

    Args:
        path: The file; a number is added to the name if it exists at closing.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._path = path
        remove_abandoned(path.parent)
        self._part = path.with_name(temporary_name(path.name))

    @abstractmethod
    def write(self, picture: NDArray[np.uint8]) -> None:
        """Append an RGB frame, (height, width, 3)."""

    @abstractmethod
    def _end(self) -> None:
        """Write what is left."""

    def close(self) -> Path:
        """Finish the file and return its path; if that fails, no file remains."""
        try:
            self._end()
            path = self._path
            number = 1
            while os.path.lexists(path):
                number += 1
                path = self._path.with_name(f"{self._path.stem}_{number}{self._path.suffix}")
            self._part.replace(path)
        finally:
            self._part.unlink(missing_ok=True)
        return path

    def discard(self) -> None:
        """Stop and remove the file."""
        self._end()
        self._part.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        """Return the file."""
        return self

    def __exit__(self, kind: object, *error: object) -> None:
        """Close the file, or discard it after an exception."""
        if kind is None:
            self.close()
        else:
            self.discard()


class VideoFile(Film):
    """One MP4 (H.264, yuv420p).

    Args:
        path: As of `Film`.
        size: Width and height in pixels, both even.
        fps: Frames per second.
        options: Further command-line options of ffmpeg.
    """

    def __init__(
        self, path: Path, size: tuple[int, int], fps: float, options: Sequence[str] = ()
    ) -> None:
        import imageio_ffmpeg

        super().__init__(path)
        rate = str(Fraction(fps).limit_denominator())
        command = [
            *(imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "warning"),
            *("-f", "rawvideo", "-vcodec", "rawvideo", "-s", f"{size[0]}x{size[1]}"),
            *("-pix_fmt", "rgb24", "-r", rate, "-i", "-", "-an"),
            *("-vcodec", "libx264", "-pix_fmt", "yuv420p", "-crf", _QUALITY),
            *("-preset", "veryfast", "-threads", "1", *_COLORS, *options, str(self._part)),
        ]
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  (open as long as the encoder)
        self._encoder = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=self._said,
            start_new_session=True,  # Ctrl-C ends it after the picture that is written
        )

    def write(self, picture: NDArray[np.uint8]) -> None:
        """Append an RGB frame, (height, width, 3).

        Raises:
            OSError: The encoder has ended, for example because the disk is full.
        """
        try:
            self._pipe.write(np.ascontiguousarray(picture).data)
        except BrokenPipeError as error:
            self._encoder.wait()
            raise self._failed() from error

    def discard(self) -> None:
        """Stop the encoder and remove the file."""
        self._encoder.kill()
        self._wait()
        self._said.close()
        self._part.unlink(missing_ok=True)

    def _end(self) -> None:
        self._wait()
        try:
            if self._encoder.returncode:
                raise self._failed()
        finally:
            self._said.close()

    @property
    def _pipe(self) -> IO[bytes]:
        if self._encoder.stdin is None:
            raise RuntimeError("the encoder has no pipe")
        return self._encoder.stdin

    def _wait(self) -> None:
        with suppress(BrokenPipeError):  # it has ended: its exit code says why
            self._pipe.close()
        self._encoder.wait()

    def _failed(self) -> OSError:
        """The error of an encoder that has ended: the first line that it said."""
        self._said.seek(0)
        lines = self._said.read().decode(errors="replace").split("\n")
        first_line = next((line for line in lines if line.strip()), "it says nothing")
        reason = first_line.rpartition("] ")[2].strip()
        for number in (errno.ENOSPC, errno.EIO, errno.EDQUOT, errno.EFBIG, errno.EROFS):
            if os.strerror(number) in first_line:
                return OSError(number, os.strerror(number), str(self._path))
        code = self._encoder.returncode
        text = f"the encoder ended with code {code}: {reason}"
        return OSError(errno.EIO, text, str(self._path))


class GifFile(Film):
    """One GIF that repeats; each picture has a palette of its own, and is dithered.

    A picture holds only what changed since the one before, so what stands still costs nothing.

    Args:
        path: As of `Film`.
        size: Width and height in pixels.
        fps: Frames per second; a frame lasts a multiple of 10 ms.
    """

    def __init__(self, path: Path, size: tuple[int, int], fps: float) -> None:
        super().__init__(path)
        self._fps = fps
        self._count = 0
        self._previous: NDArray[np.uint8] | None = None
        self._stream = self._part.open("wb")
        self._stream.write(_gif_header(size))

    def write(self, picture: NDArray[np.uint8]) -> None:
        """Append an RGB frame, (height, width, 3)."""
        from PIL.GifImagePlugin import getdata

        if self._previous is None:
            changed = np.ones(picture.shape[:2], np.bool_)
        else:
            changed = np.any(picture != self._previous, axis=2)
        top, bottom = _extent(changed, axis=0)
        left, right = _extent(changed, axis=1)
        part = _with_palette(picture[top:bottom, left:right], changed[top:bottom, left:right])
        data = getdata(
            part,
            offset=(left, top),
            include_color_table=True,
            duration=self._duration(),
            transparency=_UNCHANGED,
            disposal=_KEEP,
        )
        self._stream.writelines(data)
        self._previous = picture.copy()
        self._count += 1

    def discard(self) -> None:
        """Remove the file."""
        self._stream.close()
        self._part.unlink(missing_ok=True)

    def _duration(self) -> int:
        """Milliseconds of the next picture: rounded ends, so that the film as a whole is exact."""
        start = round(self._count * 100.0 / self._fps)
        end = round((self._count + 1) * 100.0 / self._fps)
        return 10 * (end - start)

    def _end(self) -> None:
        with self._stream:
            self._stream.write(b";")


def _gif_header(size: tuple[int, int]) -> bytes:
    """The first bytes of a GIF without a palette for all pictures, which repeats for ever."""
    width, height = size
    screen = struct.pack("<6sHHBBB", b"GIF89a", width, height, 0x70, 0, 0)
    return screen + b"\x21\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00"


def _extent(changed: NDArray[np.bool_], axis: int) -> tuple[int, int]:
    """The first row or column that changed, and the one behind the last; (0, 1) without any."""
    used = np.flatnonzero(np.any(changed, axis=1 - axis))
    if not len(used):
        return 0, 1  # a picture has at least one pixel
    return int(used[0]), int(used[-1]) + 1


def _with_palette(picture: NDArray[np.uint8], changed: NDArray[np.bool_]) -> Image:
    """A picture with its own 255 colours; pixels that did not change are transparent."""
    from PIL import Image

    colors = _palette_of(picture)
    count = len(colors)
    entries = [*colors.tobytes(), *(256 - count) * colors[0].tobytes()]
    palette = Image.new("P", (1, 1))
    palette.putpalette(entries)
    dithered = Image.fromarray(np.ascontiguousarray(picture)).quantize(
        palette=palette, dither=Image.Dither.FLOYDSTEINBERG
    )
    indices = np.array(dithered)
    indices[indices >= count] = 0  # the rest of the palette repeats the first colour
    indices[~changed] = _UNCHANGED
    part = Image.fromarray(indices, mode="P")
    part.putpalette(entries)
    return part


def _palette_of(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(n, 3) at most 255 colours of a picture, such that each of its pixels is near to one.

    Each is the farthest one from those before it. Far counts much and frequent little: a small red
    cube in front of a brown wall keeps its red.
    """
    red, green, blue = picture.reshape(-1, 3).astype(np.uint32).T
    codes, counts = np.unique(red << 16 | green << 8 | blue, return_counts=True)
    if len(codes) > _MOST_COLORS:
        _, first, cell = np.unique(codes & _CELL, return_index=True, return_inverse=True)
        counts = np.bincount(cell, weights=counts)
        codes = codes[first]
    colors = np.stack([codes >> 16, codes >> 8 & 255, codes & 255], axis=1).astype(np.float32)
    weights = counts**_FREQUENCY_POWER
    chosen = [int(np.argmax(counts))]
    squares = np.full(len(colors), np.inf, np.float32)
    for _ in range(min(_UNCHANGED, len(colors)) - 1):
        offsets = colors - colors[chosen[-1]]
        squares = np.minimum(squares, np.einsum("ij,ij->i", offsets, offsets))
        chosen.append(int(np.argmax(weights * squares)))
    return colors[chosen].astype(np.uint8)


def film_file(path: Path, size: tuple[int, int], fps: float) -> Film:
    """Return a new film: a GIF if the path ends in ``.gif``, else an MP4.

    Args:
        path: As of `Film`.
        size: Width and height in pixels, both even.
        fps: Frames per second.
    """
    if path.suffix == GIF:
        return GifFile(path, size, fps)
    return VideoFile(path, size, fps)
