"""`LeRobotWriter`: writes a LeRobotDataset v3, episode after episode.

``data/`` has the frames, ``meta/`` the features, episodes and statistics, ``videos/`` the pictures.
Every episode of a camera is a separate file.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.export.format_register import required
from embodichain.recording.export.parquet_files import new_parquet
from embodichain.utils.errors import ConfigError
from embodichain.utils.system.video import VideoFile, need_encoder

__all__ = [
    "Feature",
    "LeRobotWriter",
    "Source",
    "count_levels",
    "level_stats",
    "value_stats",
    "whole_fps",
]

_VERSION = "v3.0"
_CHUNK = 1000
"""Maximum number of files in a folder."""
_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_DATA = f"data/{_FILE}.parquet"
_VIDEO = f"videos/{{video_key}}/{_FILE}.mp4"
_EPISODES = "meta/episodes/chunk-000/file-000.parquet"
_INDICES: Mapping[str, str] = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""Columns that every data set has, with their types."""
_ENCODER = ("-g", "2", "-bf", "0")
"""Every second picture is a key frame, so any picture can be read without decoding many others."""
_SAMPLES = 100
"""Statistics use about this number of pictures per episode."""
_SAMPLE_PIXELS = 150
"""Statistics use pictures that are reduced to about this length, pixels."""
_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

Stats = dict[str, NDArray[Any]]
"""min, max, mean, std, count and five quantiles of a feature."""
Levels = NDArray[np.int64]
"""(256, 3) number of pixels that have each level of red, green and blue."""


class Feature(NamedTuple):
    """A feature of every frame.

    Attributes:
        dtype: ``float32`` or ``bool``.
        names: Names of its columns.
        info: Further entries of its description.
    """

    dtype: str
    names: list[str]
    info: Mapping[str, Any] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Its entry in ``meta/info.json``."""
        entry: dict[str, Any] = {
            "dtype": self.dtype,
            "shape": [len(self.names)],
            "names": self.names,
        }
        if self.info is not None:
            entry["info"] = dict(self.info)
        return entry


class Source(NamedTuple):
    """Where an episode comes from.

    Attributes:
        env: The environment.
        episode: Its episode in the log.
        first_step: The control step of the log in which the episode begins.
        log: Name of the log's file; None where all episodes are of one log.
        drawn: What was drawn when it began, see `LogEpisode.drawn`.
    """

    env: int
    episode: int
    first_step: int
    log: str | None = None
    drawn: Mapping[str, list[float]] = MappingProxyType({})

    def to_dict(self) -> dict[str, Any]:
        """Its columns in the table of episodes."""
        columns: dict[str, Any] = {
            "source/env": self.env,
            "source/episode": self.episode,
            "source/first_step": self.first_step,
        }
        if self.log is not None:
            columns["source/log"] = self.log
        for name, numbers in self.drawn.items():
            columns[f"drawn/{name}"] = list(numbers)
        return columns


def whole_fps(dt: float) -> int:
    """Return the frames a second of control steps of `dt` seconds.

    Raises:
        ConfigError: If they are not a whole number.
    """
    fps = round(1.0 / dt)
    if fps < 1 or abs(fps * dt - 1.0) > 1e-6:
        raise ConfigError(
            f"LeRobot needs a whole number of frames a second; control steps make {1 / dt:g}"
        )
    return fps


class LeRobotWriter:
    """Writes a data set into a new folder. Close it with `finish`.

    Args:
        root: The folder, which must not exist.
        features: Features by key; those without columns are left out.
        cameras: Key of the video to width and height in pixels.
        fps: Frames a second.
        robot: The type of robot; None if unknown.

    Raises:
        ConfigError: If pyarrow, pandas or, with cameras, the extra `video` is not installed, or the
            width or height of a camera is odd.
    """

    def __init__(
        self,
        root: Path,
        features: Mapping[str, Feature],
        cameras: Mapping[str, tuple[int, int]],
        fps: int,
        robot: str | None,
    ) -> None:
        self._pd: Any = required("pandas", "lerobot")
        self._pa: Any = required("pyarrow", "lerobot")
        self._pq: Any = required("pyarrow.parquet", "lerobot")
        for key, (width, height) in cameras.items():
            if width % 2 or height % 2:
                name = key.rpartition(".")[2]
                raise ConfigError(
                    f"videos need an even width and height; {name} has {width}x{height}"
                )
        if cameras:
            need_encoder()
        self._root = root
        self._features = {key: feature for key, feature in features.items() if feature.names}
        self._cameras = cameras
        self._fps = fps
        self._robot = robot

        # Of each episode: its row in the table of episodes, and the statistics of its features.
        self._rows: list[dict[str, Any]] = []
        self._stats: list[dict[str, Stats]] = []
        self._total_frames = 0
        self._tasks: dict[str, int] = {}
        # Of each camera, over all episodes: the pictures that statistics use.
        self._levels: dict[str, Levels] = {key: np.zeros((256, 3), np.int64) for key in cameras}
        self._num_samples = dict.fromkeys(cameras, 0)

        self._data = root / _DATA.format(chunk_index=0, file_index=0)
        self._files = ExitStack()
        self._parquet: Any = None  # opened with the first episode, which has the schema
        root.mkdir()
        self._data.parent.mkdir(parents=True)

    def __enter__(self) -> Self:
        """Return the writer."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the files; without `finish`, the data set is incomplete."""
        self._files.close()

    def add(
        self,
        values: Mapping[str, NDArray[Any]],
        source: Source,
        task: str,
        pictures: Iterable[Sequence[NDArray[np.uint8]]] = (),
    ) -> None:
        """Add an episode.

        Args:
            values: Key to (T, K) values of each feature.
            task: The sentence that says what to do.
            source: Where the episode comes from.
            pictures: For each frame, the (height, width, 3) RGB pictures of the cameras, in order.
        """
        columns = {k: values[k].astype(feature.dtype) for k, feature in self._features.items()}
        length = len(next(iter(columns.values())))
        index = len(self._rows)
        task_index = self._tasks.setdefault(task, len(self._tasks))
        frames = np.arange(length)
        indices = {
            "timestamp": frames / self._fps,
            "frame_index": frames,
            "episode_index": np.full(length, index),
            "index": frames + self._total_frames,
            "task_index": np.full(length, task_index),
        }
        for key, dtype in _INDICES.items():
            columns[key] = indices[key].astype(dtype)[:, None]
        self._write_frames(columns)
        row = {
            "episode_index": index,
            "tasks": [task],
            "length": length,
            "data/chunk_index": 0,
            "data/file_index": 0,
            "dataset_from_index": self._total_frames,
            "dataset_to_index": self._total_frames + length,
            **source.to_dict(),
        }
        stats = {key: value_stats(column) for key, column in columns.items()}
        if self._cameras:
            self._write_videos(row, stats, pictures)
        self._rows.append(row)
        self._stats.append(stats)
        self._total_frames += length

    def _write_frames(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Append (T, K) columns to the table of frames."""
        table = self._pa.table({key: self._array(column) for key, column in columns.items()})
        if self._parquet is None:
            file = new_parquet(self._data, table.schema, "lerobot")
            self._parquet = self._files.enter_context(file)
        self._parquet.write_table(table)

    def _array(self, values: NDArray[Any]) -> Any:
        """Return (T, K) values as an array of pyarrow: of numbers, or of lists of K numbers."""
        flat = self._pa.array(values.reshape(-1))
        width = values.shape[1]
        if width == 1:
            return flat
        return self._pa.FixedSizeListArray.from_arrays(flat, width)

    def _write_videos(
        self,
        row: dict[str, Any],
        stats: dict[str, Stats],
        pictures: Iterable[Sequence[NDArray[np.uint8]]],
    ) -> None:
        """Write the videos of an episode; add to its row and its statistics."""
        chunk, file = divmod(row["episode_index"], _CHUNK)
        length = row["length"]
        steps_per_sample = max(1, length // _SAMPLES)
        samples: list[list[NDArray[np.uint8]]] = [[] for _ in self._cameras]
        with ExitStack() as stack:
            videos = []
            for key, size in self._cameras.items():
                name = _VIDEO.format(video_key=key, chunk_index=chunk, file_index=file)
                video = VideoFile(self._root / name, size, self._fps, _ENCODER)
                videos.append(stack.enter_context(video))
            for frame, frame_pictures in enumerate(pictures):
                is_sample = frame % steps_per_sample == 0
                for video, picture, camera_samples in zip(
                    videos, frame_pictures, samples, strict=True
                ):
                    video.write(picture)
                    if is_sample:
                        camera_samples.append(_reduced(picture))
        for key, camera_samples in zip(self._cameras, samples, strict=True):
            row[f"videos/{key}/chunk_index"] = chunk
            row[f"videos/{key}/file_index"] = file
            row[f"videos/{key}/from_timestamp"] = 0.0
            row[f"videos/{key}/to_timestamp"] = length / self._fps
            levels = count_levels(np.array(camera_samples))
            stats[key] = level_stats(levels, len(camera_samples))
            self._levels[key] += levels
            self._num_samples[key] += len(camera_samples)

    def finish(self) -> None:
        """Write features, episodes and statistics; there must be an episode."""
        self._files.close()
        self._write_episodes()
        self._write_total_stats()
        tasks = self._pd.DataFrame(
            {"task_index": [*self._tasks.values()]},
            index=self._pd.Index([*self._tasks], name="task"),
        )
        self._write_table("meta/tasks.parquet", self._pa.Table.from_pandas(tasks))
        features: dict[str, Any] = {}
        for key, feature in self._features.items():
            features[key] = feature.to_dict()
        for key, dtype in _INDICES.items():
            features[key] = {"dtype": dtype, "shape": [1], "names": None}
        for key, size in self._cameras.items():
            features[key] = _video_info(size, self._fps)
        info = {
            "codebase_version": _VERSION,
            "robot_type": self._robot,
            "total_episodes": len(self._rows),
            "total_frames": self._total_frames,
            "total_tasks": len(self._tasks),
            "chunks_size": _CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self._fps,
            "splits": {"train": f"0:{len(self._rows)}"},
            "data_path": _DATA,
            "video_path": _VIDEO if self._cameras else None,
            "features": features,
        }
        (self._root / "meta/info.json").write_text(json.dumps(info, indent=4))

    def _write_episodes(self) -> None:
        """Write the table of episodes, with their statistics."""
        table = []
        # pyarrow takes the columns of the first row: a draw may be missing in some episodes.
        columns: dict[str, None] = {}
        for row in self._rows:
            columns.update(dict.fromkeys(row))
        for row, episode_stats in zip(self._rows, self._stats, strict=True):
            entry = {
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                **columns,
                **row,
            }
            for key, stats in episode_stats.items():
                for name, values in stats.items():
                    entry[f"stats/{key}/{name}"] = values.tolist()
            table.append(entry)
        (self._root / _EPISODES).parent.mkdir(parents=True)
        self._write_table(_EPISODES, self._pa.Table.from_pylist(table))

    def _write_total_stats(self) -> None:
        """Write the statistics of all episodes."""
        total = {key: value_stats(self._column(key)) for key in (*self._features, *_INDICES)}
        for key in self._cameras:
            total[key] = level_stats(self._levels[key], self._num_samples[key])
        tree = {
            key: {name: values.tolist() for name, values in stats.items()}
            for key, stats in total.items()
        }
        (self._root / "meta/stats.json").write_text(json.dumps(tree, indent=4))

    def _write_table(self, name: str, table: Any) -> None:
        with new_parquet(self._root / name, table.schema, "lerobot") as file:
            file.write_table(table)

    def _column(self, key: str) -> NDArray[Any]:
        """(total, K) values of a feature in all frames, as they were written."""
        column = self._pq.read_table(self._data, columns=[key])[key].combine_chunks()
        if self._pa.types.is_fixed_size_list(column.type):
            column = column.flatten()
        values: NDArray[Any] = column.to_numpy(zero_copy_only=False)
        return values.reshape(self._total_frames, -1)


def _reduced(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A small copy of a (height, width, 3) picture, of some of its pixels."""
    stride = max(1, max(picture.shape) // _SAMPLE_PIXELS)
    return picture[::stride, ::stride].copy()


def _video_info(size: tuple[int, int], fps: int) -> dict[str, Any]:
    width, height = size
    about = {
        "video.height": height,
        "video.width": width,
        "video.codec": "h264",
        "video.pix_fmt": "yuv420p",
        "video.is_depth_map": False,
        "video.fps": fps,
        "video.channels": 3,
        "has_audio": False,
    }
    names = ["height", "width", "channels"]
    return {"dtype": "video", "shape": [height, width, 3], "names": names, "info": about}


# -- statistics ------------------------------------------------------------------------------------


def value_stats(values: NDArray[Any]) -> Stats:
    """Statistics of (T, K) numbers, column by column."""
    numbers = values.astype(np.float64)
    stats: Stats = {
        "min": numbers.min(axis=0),
        "max": numbers.max(axis=0),
        "mean": numbers.mean(axis=0),
        "std": numbers.std(axis=0),
        "count": np.array([len(numbers)]),
    }
    quantiles = np.quantile(numbers, list(_QUANTILES.values()), axis=0)
    return stats | dict(zip(_QUANTILES, quantiles, strict=True))


def count_levels(pictures: NDArray[np.uint8]) -> Levels:
    """Count the pixels of (n, height, width, 3) pictures by level, for each channel."""
    channels = pictures.reshape(-1, 3).T
    return np.stack([np.bincount(channel, minlength=256) for channel in channels], axis=1)


def level_stats(levels: Levels, count: int) -> Stats:
    """Statistics of pictures, in 0 to 1 and by channel, each (3, 1, 1).

    Args:
        levels: Number of pixels that have each level.
        count: Number of the pictures.
    """
    value = np.arange(256)[:, None] / 255.0
    occurs = levels > 0
    total = levels.sum(axis=0)
    mean = (levels * value).sum(axis=0) / total
    stats: Stats = {
        "min": value[occurs.argmax(axis=0), 0],
        "max": value[255 - occurs[::-1].argmax(axis=0), 0],
        "mean": mean,
        "std": np.sqrt((levels * (value - mean) ** 2).sum(axis=0) / total),
    }
    # As numpy's quantiles: between the two pixels next to the quantile's position, in order.
    num_up_to = levels.cumsum(axis=0)
    for name, quantile in _QUANTILES.items():
        position = quantile * (total - 1)
        below = np.floor(position)
        above = np.ceil(position)
        low = (num_up_to <= below).sum(axis=0)
        high = (num_up_to <= above).sum(axis=0)
        stats[name] = (low + (position - below) * (high - low)) / 255.0
    stats = {name: values[:, None, None] for name, values in stats.items()}
    stats["count"] = np.array([count])
    return stats
