"""A LeRobotDataset v3: a folder that LeRobot trains from, an episode for each of the log's.

``data/`` holds the frames, ``meta/`` what they are, their episodes and statistics, ``videos/`` what
the task's cameras saw (`record_camera_data`), drawn again from the states.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from embodichain.recording.api import Log
from embodichain.recording.episodes import LogEpisode
from embodichain.recording.export.demonstrations import demonstrations
from embodichain.recording.export.formats import Part, required
from embodichain.recording.export.lerobot_features import Columns, Feature, features_of
from embodichain.recording.export.lerobot_files import Frames, write_info, write_meta
from embodichain.recording.export.lerobot_videos import Videos
from embodichain.recording.log_error import LogError
from embodichain.utils.errors import ConfigError

__all__ = ["write"]

_BLOCK_BYTES = 2**28
"""About how much of a log is held at a time."""


def write(log: Log, part: Part, path: Path) -> None:
    """Write the episodes of a part into a new folder, by environment, then in time.

    Raises:
        ConfigError: If pyarrow or pandas is not installed, there is no episode, or a control step
            is no whole fraction of a second.
        LogError: If the log lacks steps of an episode.
        RenderError: If there are cameras, and no OpenGL library works here.
    """
    required("pyarrow", "lerobot")
    required("pandas", "lerobot")
    fps = round(1.0 / log.dt)
    if fps < 1 or abs(fps * log.dt - 1.0) > 1e-6:
        raise ConfigError(
            f"LeRobot wants a whole number of frames a second; control steps make {1 / log.dt:g}"
        )
    chosen = demonstrations(log, part)
    features = features_of(log)
    videos = Videos(log, path, fps)
    path.mkdir()
    frames = Frames(path, features, fps)
    for columns in _read(log, chosen, features):
        frames.add(columns)
    frames.close()
    videos.draw([(episode.env, steps) for episode, steps in chosen])
    sources = [
        {
            "source/env": episode.env,
            "source/episode": episode.episode,
            "source/first_step": steps.start,
        }
        for episode, steps in chosen
    ]
    described = log.config.get("task") if isinstance(log.config.get("task"), dict) else {}
    write_meta(path, _sentence(described, log), frames, videos, sources)
    write_info(path, _robot(described), frames, videos)


def _sentence(task: Any, log: Log) -> str:
    """What the episodes are about, in words."""
    text = task.get("description")
    return text if isinstance(text, str) and text else log.task


def _robot(task: Any) -> str | None:
    robot = task.get("robot")
    uid = robot.get("uid") if isinstance(robot, dict) else None
    return str(uid) if uid is not None else None


def _read(
    log: Log, chosen: list[tuple[LogEpisode, range]], features: list[Feature]
) -> Iterator[Columns]:
    """Yield the columns of each episode; the log is read for as many environments as fit."""
    own = {"done", "success"}
    fields = {field for feature in features for field in feature.sources} - own
    names = [name for name in log.columns if name in fields | {"terminated", "truncated"}]
    first, last = min(s.start for _, s in chosen), max(s.stop for _, s in chosen)
    width = sum(len(log.columns[name]) for name in names)
    most = max(1, _BLOCK_BYTES // (8 * width * (last - first)))
    envs = sorted({episode.env for episode, _ in chosen})
    for at in range(0, len(envs), most):
        block = envs[at : at + most]
        data = log.read(names, block, None, first, last)
        for episode, steps in chosen:
            if episode.env not in block:
                continue
            rows = slice(*np.searchsorted(data.steps, [steps.start, steps.stop]).tolist())
            if rows.stop - rows.start != len(steps):
                raise LogError(
                    f"{log.path} lacks steps of episode {episode.episode} of environment "
                    f"{episode.env}"
                )
            column = block.index(episode.env)
            found = {name: data[name][rows, column] for name in names}
            found["done"] = found["terminated"] | found["truncated"]
            found["success"] = np.zeros(len(steps), np.bool_)
            found["success"][-1] = bool(episode.success) and steps[-1] == episode.last_step
            yield {name: v if v.ndim > 1 else v[:, None] for name, v in found.items()}
