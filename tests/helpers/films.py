"""A stand-in for moviepy's only class that Gymnasium and Stable-Baselines3 use.

moviepy 1.0, of 2020, is the last that takes today's Pillow; 2 wants an older one. Both packages
hand it a list of images and a path, which imageio-ffmpeg writes as well.
"""

import sys
from types import ModuleType

import imageio_ffmpeg
import numpy as np
import pytest


class ImageSequenceClip:
    """Images of the same size, (H, W, 3) uint8, written as a film."""

    def __init__(self, frames, fps):
        self.frames, self.fps = frames, fps

    def write_videofile(self, path, logger=None):
        height, width, _ = self.frames[0].shape
        writer = imageio_ffmpeg.write_frames(path, (width, height), fps=self.fps)
        writer.send(None)
        for frame in self.frames:
            writer.send(np.ascontiguousarray(frame))
        writer.close()


def install_moviepy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `import moviepy` find the stand-in while a test runs."""
    for name in ("moviepy", "moviepy.video", "moviepy.video.io"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    module = ModuleType("moviepy.video.io.ImageSequenceClip")
    module.ImageSequenceClip = ImageSequenceClip
    monkeypatch.setitem(sys.modules, module.__name__, module)
