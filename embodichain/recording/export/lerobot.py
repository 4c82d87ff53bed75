"""A LeRobotDataset v3: a folder that LeRobot trains from, an episode for each of the log's.

``data/`` holds the frames, ``meta/`` what they are, their episodes and statistics, ``videos/`` what
the task's cameras saw (`record_camera_data`), drawn again from the states.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from embodichain.recording.api import Log
from embodichain.recording.episodes import LogEpisode
from embodichain.recording.export.demonstrations import demonstrations
from embodichain.recording.export.formats import Part, required
from embodichain.recording.export.lerobot_frames import Columns, Feature, Frames, features_of
from embodichain.recording.export.lerobot_stats import merged
from embodichain.recording.export.lerobot_videos import CHUNK, FILE, VIDEO, Videos
from embodichain.recording.log_error import LogError
from embodichain.utils.errors import ConfigError

__all__ = ["write"]

_VERSION = "v3.0"
_DATA = f"data/{FILE}.parquet"
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
    frames = Frames(path / _DATA.format(chunk_index=0, file_index=0), features, fps)
    frames.write(_read(log, chosen, features))
    videos.draw([(episode.env, steps) for episode, steps in chosen])
    _write_meta(path, log, chosen, frames, videos)
    task: Any = log.config.get("task")
    robot = task.get("robot") if isinstance(task, dict) else None
    uid = robot.get("uid") if isinstance(robot, dict) else None
    info = {
        "codebase_version": _VERSION,
        "robot_type": None if uid is None else str(uid),
        "total_episodes": len(chosen),
        "total_frames": frames.total,
        "total_tasks": 1,
        "chunks_size": CHUNK,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{len(chosen)}"},
        "data_path": _DATA,
        "video_path": VIDEO if videos.features else None,
        "features": frames.info() | videos.features,
    }
    (path / "meta/info.json").write_text(json.dumps(info, indent=4))


def _write_meta(
    root: Path,
    log: Log,
    chosen: list[tuple[LogEpisode, range]],
    frames: Frames,
    videos: Videos,
) -> None:
    """Write the task, the episodes, where in the log they come from, and their statistics."""
    pa: Any = required("pyarrow", "lerobot")
    pq: Any = required("pyarrow.parquet", "lerobot")
    pd: Any = required("pandas", "lerobot")
    task: Any = log.config.get("task")
    said = task.get("description") if isinstance(task, dict) else None
    sentence = said if isinstance(said, str) and said else log.task
    stats = [a | b for a, b in zip(frames.stats, videos.stats, strict=True)]
    parts = zip(chosen, frames.episodes, videos.episodes, stats, strict=True)
    rows = [
        row
        | {"tasks": [sentence], "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
        | {"source/env": episode.env, "source/episode": episode.episode}
        | {"source/first_step": steps.start}
        | video
        | {f"stats/{key}/{name}": v.tolist() for key, s in own.items() for name, v in s.items()}
        for (episode, steps), row, video, own in parts
    ]
    folder = root / "meta/episodes/chunk-000"
    folder.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(rows), folder / "file-000.parquet")
    pd.DataFrame({"task_index": [0]}, index=[sentence]).to_parquet(root / "meta/tasks.parquet")
    whole = {key: merged([own[key] for own in stats]) for key in stats[0]}
    tree = {key: {name: v.tolist() for name, v in s.items()} for key, s in whole.items()}
    (root / "meta/stats.json").write_text(json.dumps(tree, indent=4))


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
