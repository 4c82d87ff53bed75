"""`VideoFile`: writes an MP4 frame by frame; needs the extra `video` (imageio-ffmpeg)."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.utils.errors import ConfigError, Problem

__all__ = ["VideoFile", "need_encoder"]


def need_encoder() -> None:
    """Check that the encoder is installed.

    Raises:
        ConfigError: If it is not; names the extra.
    """
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        hint = "pip install 'embodichain[video]'"
        raise ConfigError([Problem("", "videos need the package imageio-ffmpeg", hint)])


class VideoFile:
    """One MP4 (H.264, yuv420p), renamed to its path when complete.

    As a context manager it is closed at exit, or discarded after an exception.

    Args:
        path: The file; a number is added to the name if it exists at closing.
        size: Width and height in pixels, both even.
        fps: Frames per second.
        options: Further command-line options of ffmpeg.
    """

    def __init__(
        self, path: Path, size: tuple[int, int], fps: float, options: Sequence[str] = ()
    ) -> None:
        import imageio_ffmpeg

        path.parent.mkdir(parents=True, exist_ok=True)
        self._path = path
        self._part = path.with_name(f".{path.stem}.part{path.suffix}")
        self._writer: Generator[None, Any, None] = imageio_ffmpeg.write_frames(
            str(self._part),
            size,
            fps=fps,
            codec="libx264",
            macro_block_size=2,
            output_params=["-preset", "veryfast", "-threads", "1", *options],
        )
        self._writer.send(None)

    def write(self, picture: NDArray[np.uint8]) -> None:
        """Append an RGB frame, (height, width, 3)."""
        self._writer.send(np.ascontiguousarray(picture))

    def close(self) -> Path:
        """Finish the file and return its path."""
        self._writer.close()
        path, number = self._path, 1
        while os.path.lexists(path):
            number += 1
            path = self._path.with_name(f"{self._path.stem}_{number}{self._path.suffix}")
        self._part.replace(path)
        return path

    def discard(self) -> None:
        """Stop and remove the file."""
        self._writer.close()
        self._part.unlink(missing_ok=True)

    def __enter__(self) -> VideoFile:
        """Return the file."""
        return self

    def __exit__(self, kind: object, *error: object) -> None:
        """Close the file, or discard it after an exception."""
        if kind is None:
            self.close()
        else:
            self.discard()
