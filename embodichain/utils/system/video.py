"""`film_file`: an MP4 (`VideoFile`) or a GIF (`GifFile`), written frame by frame.

MP4 needs the extra `video` (imageio-ffmpeg).
"""

from __future__ import annotations

import errno
import importlib.util
import os
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

__all__ = ["GIF", "Film", "GifFile", "VideoFile", "film_file", "need_encoder"]

GIF = ".gif"
_QUALITY = "25"
"""Constant rate factor of x264: 0 is lossless, 51 the worst."""
_COLORS = (
    *("-vf", "setparams=color_primaries=bt709:color_trc=iec61966-2-1"),
    *("-colorspace", "smpte170m", "-color_range", "tv"),
)
"""sRGB, and FFmpeg's conversion to YUV. Unnamed, players assume another one from 720 lines on."""


def need_encoder(suffix: str = ".mp4") -> None:
    """Check that the encoder is installed.

    Args:
        suffix: Of the file; a GIF needs none.

    Raises:
        ConfigError: If it is not; names the extra.
    """
    if suffix != GIF and importlib.util.find_spec("imageio_ffmpeg") is None:
        hint = "pip install 'embodichain[video]'"
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
    """One GIF that repeats, with the 256 colours of its first picture.

    All pictures are in memory until it is closed, a byte a pixel.

    Args:
        path: As of `Film`.
        fps: Frames per second; a frame lasts a multiple of 10 ms.
    """

    def __init__(self, path: Path, fps: float) -> None:
        super().__init__(path)
        self._fps = fps
        self._pictures: list[Image] = []

    def write(self, picture: NDArray[np.uint8]) -> None:
        """Append an RGB frame, (height, width, 3)."""
        from PIL import Image

        image = Image.fromarray(picture)
        if self._pictures:
            none = Image.Dither.NONE
            self._pictures.append(image.quantize(palette=self._pictures[0], dither=none))
        else:
            self._pictures.append(image.quantize(256, method=Image.Quantize.MEDIANCUT))

    def discard(self) -> None:
        """Forget the pictures: nothing was written yet."""
        self._pictures.clear()

    def _end(self) -> None:
        ends = np.round(np.arange(len(self._pictures) + 1) * 100.0 / self._fps) * 10.0
        first, *others = self._pictures
        with self._part.open("wb") as stream:
            first.save(
                *(stream, "GIF"),
                save_all=True,
                append_images=others,
                duration=[int(d) for d in np.diff(ends)],
                loop=0,
            )


def film_file(path: Path, size: tuple[int, int], fps: float) -> Film:
    """Return a new film: a GIF if the path ends in ``.gif``, else an MP4.

    Args:
        path: As of `Film`.
        size: Width and height in pixels, both even.
        fps: Frames per second.
    """
    return GifFile(path, fps) if path.suffix == GIF else VideoFile(path, size, fps)
