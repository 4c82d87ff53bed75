"""Films of a LeRobot data set: what the cameras of a task saw, drawn again from the states.

The cameras are those of the event `record_camera_data` in the log's config; a log itself holds no
pictures. Every episode is a file of its own, and every second picture a key frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.mdp.events.record import filmed_from
from embodichain.recording.api import Log
from embodichain.recording.export.lerobot_stats import Stats, of_levels
from embodichain.recording.playback import Playback, Span
from embodichain.utils.video import VideoFile, need_encoder

__all__ = ["CHUNK", "FILE", "VIDEO", "Videos"]

CHUNK = 1000
"""Files in a folder at most."""
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
VIDEO = f"videos/{{video_key}}/{FILE}.mp4"
_OPTIONS = ("-g", "2", "-bf", "0")
"""Of the encoder: any picture can be read without decoding many others."""
_COUNTED = 100
"""Pictures of an episode whose pixels are counted, at most about."""


@dataclass(frozen=True, slots=True)
class _Camera:
    key: str
    size: tuple[int, int]
    look: Any


class Videos:
    """The films of a data set; none if the task has no cameras.

    Args:
        log: The log.
        root: The data set's folder.
        fps: Pictures a second.

    Attributes:
        episodes: For each episode its part of `meta/episodes`.
        stats: For each episode the statistics of its pictures.
        features: As `info.json` has them.

    Raises:
        ConfigError: If there are cameras, and the extra `video` is missing.
    """

    def __init__(self, log: Log, root: Path, fps: int) -> None:
        self._log, self._root, self._fps = log, root, fps
        self._cameras = list(_cameras(log))
        if self._cameras:
            need_encoder()
        self.episodes: list[dict[str, Any]] = []
        self.stats: list[dict[str, Stats]] = []
        self.features = {camera.key: _info(camera, fps) for camera in self._cameras}

    def draw(self, episodes: Sequence[tuple[int, range]]) -> None:
        """Film episodes: environment and control steps of each.

        Raises:
            RenderError: If no OpenGL library works here.
        """
        from embodichain.lab.sim.rendering import SceneRenderer

        self.episodes, self.stats = [{} for _ in episodes], [{} for _ in episodes]
        with ExitStack() as stack:
            renderers = {
                size: stack.enter_context(closing(SceneRenderer(self._log.model, *size)))
                for size in {camera.size for camera in self._cameras}
            }
            for index, (env, steps) in enumerate(episodes if renderers else ()):
                self._film(index, env, steps, renderers)

    def _film(
        self, index: int, env: int, steps: range, renderers: dict[tuple[int, int], Any]
    ) -> None:
        chunk, file = divmod(index, CHUNK)
        every = max(1, len(steps) // _COUNTED)
        counted = len(range(0, len(steps), every))
        playback = Playback(self._log, env)
        with ExitStack() as stack:
            films, levels = [], []
            for camera in self._cameras:
                name = VIDEO.format(video_key=camera.key, chunk_index=chunk, file_index=file)
                film = VideoFile(self._root / name, camera.size, self._fps, _OPTIONS)
                films.append(stack.enter_context(film))
                levels.append(np.zeros((3, 256), np.int64))
            for step in playback.steps(Span(steps[0], steps[-1])):
                for camera, film, counts in zip(self._cameras, films, levels, strict=True):
                    picture = renderers[camera.size].draw(playback.engine, 0, camera.look)
                    film.write(picture)
                    if not (step - steps[0]) % every:
                        counts += _levels(picture)
        for camera, counts in zip(self._cameras, levels, strict=True):
            at = f"videos/{camera.key}"
            self.episodes[index] |= {
                f"{at}/chunk_index": chunk,
                f"{at}/file_index": file,
                f"{at}/from_timestamp": 0.0,
                f"{at}/to_timestamp": len(steps) / self._fps,
            }
            self.stats[index][camera.key] = of_levels(counts, counted)


def _cameras(log: Log) -> Iterator[_Camera]:
    task = log.config.get("task")
    events = task.get("events") if isinstance(task, dict) else None
    seen: set[str] = set()
    for uid, event in (events or {}).items():
        if not isinstance(event, dict) or event.get("func") != "record_camera_data":
            continue
        params = event.get("params") or {}
        name = params.get("name") or "default"
        name = name if name not in seen else f"{name}_{uid}"
        seen.add(name)
        width, height = params.get("resolution") or (640, 480)
        size = (int(width), int(height))
        look = params.get("camera")
        if look is None:
            where = {key: params.get(key) for key in ("eye", "target", "up", "intrinsics")}
            look = filmed_from(size, **where)
        yield _Camera(f"observation.images.{name}", size, look)


def _info(camera: _Camera, fps: int) -> dict[str, Any]:
    width, height = camera.size
    return {
        "dtype": "video",
        "shape": [height, width, 3],
        "names": ["height", "width", "channels"],
        "info": {
            "video.height": height,
            "video.width": width,
            "video.codec": "h264",
            "video.pix_fmt": "yuv420p",
            "video.is_depth_map": False,
            "video.fps": fps,
            "video.channels": 3,
            "has_audio": False,
        },
    }


def _levels(picture: NDArray[np.uint8]) -> NDArray[np.int64]:
    """(3, 256) how often each level occurs in each channel."""
    channels = picture.reshape(-1, 3)
    return np.stack([np.bincount(channels[:, c], minlength=256) for c in range(3)])
