"""`LeRobotWriter`: writes a LeRobotDataset v3, episode after episode.

``data/`` has the frames, ``meta/`` the features, episodes and statistics, ``videos/`` the pictures.
Every episode of a camera is a separate file.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.export.format_register import required
from embodichain.recording.export.parquet_files import new_parquet
from embodichain.utils.errors import ConfigError
from embodichain.utils.system.video import VideoFile, need_encoder

__all__ = ["Feature", "LeRobotWriter", "levels_of", "of_levels", "of_values", "whole_fps"]

_VERSION = "v3.0"
_CHUNK = 1000
"""Maximum number of files in a folder."""
_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_DATA, _VIDEO = f"data/{_FILE}.parquet", f"videos/{{video_key}}/{_FILE}.mp4"
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
_SAMPLES, _PIXELS = 100, 150
"""Statistics use about 100 pictures per episode, reduced to about 150 pixels in length."""
_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

Stats = dict[str, NDArray[Any]]
"""min, max, mean, std, count and five quantiles of a feature."""
Levels = NDArray[np.int64]
"""(256, 3) how many pixels have each level of red, green and blue."""


class Feature(NamedTuple):
    """A feature of every frame.

    Attributes:
        dtype: ``float32`` or ``bool``.
        names: Names of its columns.
        info: What else the data set says of it.
    """

    dtype: str
    names: list[str]
    info: Mapping[str, Any] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Its entry in ``meta/info.json``."""
        entry = {"dtype": self.dtype, "shape": [len(self.names)], "names": self.names}
        return entry if self.info is None else {**entry, "info": dict(self.info)}


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
        self._root, self._cameras = root, cameras
        self._features = {key: feature for key, feature in features.items() if feature.names}
        self._fps, self._robot = fps, robot
        self._tasks: dict[str, int] = {}
        self._rows: list[dict[str, Any]] = []
        self._stats: list[dict[str, Stats]] = []
        self._levels: dict[str, Levels] = {key: np.zeros((256, 3), np.int64) for key in cameras}
        self._shown = dict.fromkeys(cameras, 0)
        self._total = 0
        self._data = root / _DATA.format(chunk_index=0, file_index=0)
        self._files = ExitStack()
        self._parquet: Any = None
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
        source: Mapping[str, int | str],
        task: str,
        pictures: Iterable[Sequence[NDArray[np.uint8]]] = (),
    ) -> None:
        """Add an episode.

        Args:
            values: Key to (T, K) values of each feature.
            task: The sentence that says what to do.
            source: Where the episode comes from, for columns ``source/...`` of the episodes.
            pictures: For each frame, the (height, width, 3) RGB pictures of the cameras, in order.
        """
        columns = {k: values[k].astype(feature.dtype) for k, feature in self._features.items()}
        length, index = len(next(iter(columns.values()))), len(self._rows)
        frames = np.arange(length)
        numbers = {
            "timestamp": frames / self._fps,
            "frame_index": frames,
            "episode_index": np.full(length, index),
            "index": frames + self._total,
            "task_index": np.full(length, self._tasks.setdefault(task, len(self._tasks))),
        }
        for key, kind in _INDICES.items():
            columns[key] = numbers[key].astype(kind)[:, None]
        table = self._pa.table({key: self._array(column) for key, column in columns.items()})
        if self._parquet is None:
            opened = new_parquet(self._data, table.schema, "lerobot")
            self._parquet = self._files.enter_context(opened)
        self._parquet.write_table(table)
        row = {
            "episode_index": index,
            "tasks": [task],
            "length": length,
            "data/chunk_index": 0,
            "data/file_index": 0,
            "dataset_from_index": self._total,
            "dataset_to_index": self._total + length,
            **{f"source/{name}": value for name, value in source.items()},
        }
        stats = {key: of_values(column) for key, column in columns.items()}
        if self._cameras:
            self._film(row, stats, pictures)
        self._rows.append(row)
        self._stats.append(stats)
        self._total += length

    def _array(self, values: NDArray[Any]) -> Any:
        flat, width = self._pa.array(values.reshape(-1)), values.shape[1]
        return flat if width == 1 else self._pa.FixedSizeListArray.from_arrays(flat, width)

    def _film(
        self,
        row: dict[str, Any],
        stats: dict[str, Stats],
        pictures: Iterable[Sequence[NDArray[np.uint8]]],
    ) -> None:
        """Write the videos of an episode; add to its row and its statistics."""
        chunk, file = divmod(row["episode_index"], _CHUNK)
        length = row["length"]
        samples: list[list[NDArray[np.uint8]]] = [[] for _ in self._cameras]
        with ExitStack() as stack:
            films = []
            for key, size in self._cameras.items():
                name = _VIDEO.format(video_key=key, chunk_index=chunk, file_index=file)
                film = VideoFile(self._root / name, size, self._fps, _ENCODER)
                films.append(stack.enter_context(film))
            for number, shown in enumerate(pictures):
                for film, picture, kept in zip(films, shown, samples, strict=True):
                    film.write(picture)
                    if not number % max(1, length // _SAMPLES):
                        stride = max(1, max(picture.shape) // _PIXELS)
                        kept.append(picture[::stride, ::stride].copy())
        for key, kept in zip(self._cameras, samples, strict=True):
            at = f"videos/{key}"
            row |= {f"{at}/chunk_index": chunk, f"{at}/file_index": file}
            row |= {f"{at}/from_timestamp": 0.0, f"{at}/to_timestamp": length / self._fps}
            levels = levels_of(np.array(kept))
            stats[key] = of_levels(levels, len(kept))
            self._levels[key] += levels
            self._shown[key] += len(kept)

    def finish(self) -> None:
        """Write features, episodes and statistics; there must be an episode."""
        self._files.close()
        self._write_meta()
        tasks = self._pd.DataFrame(
            {"task_index": [*self._tasks.values()]},
            index=self._pd.Index([*self._tasks], name="task"),
        )
        self._write_table("meta/tasks.parquet", self._pa.Table.from_pandas(tasks))
        info = {
            "codebase_version": _VERSION,
            "robot_type": self._robot,
            "total_episodes": len(self._rows),
            "total_frames": self._total,
            "total_tasks": len(self._tasks),
            "chunks_size": _CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self._fps,
            "splits": {"train": f"0:{len(self._rows)}"},
            "data_path": _DATA,
            "video_path": _VIDEO if self._cameras else None,
            "features": {key: feature.to_dict() for key, feature in self._features.items()}
            | {key: {"dtype": kind, "shape": [1], "names": None} for key, kind in _INDICES.items()}
            | {key: _video_info(size, self._fps) for key, size in self._cameras.items()},
        }
        (self._root / "meta/info.json").write_text(json.dumps(info, indent=4))

    def _write_meta(self) -> None:
        """Write the episodes with their statistics, and the overall statistics."""
        place = {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
        table = [
            place
            | row
            | {f"stats/{k}/{n}": v.tolist() for k, s in own.items() for n, v in s.items()}
            for row, own in zip(self._rows, self._stats, strict=True)
        ]
        (self._root / "meta/episodes/chunk-000").mkdir(parents=True)
        name = "meta/episodes/chunk-000/file-000.parquet"
        self._write_table(name, self._pa.Table.from_pylist(table))
        whole = {key: of_values(self._column(key)) for key in (*self._features, *_INDICES)}
        whole |= {key: of_levels(self._levels[key], self._shown[key]) for key in self._cameras}
        tree = {key: {name: v.tolist() for name, v in s.items()} for key, s in whole.items()}
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
        return values.reshape(self._total, -1)


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


def of_values(values: NDArray[Any]) -> Stats:
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


def levels_of(pictures: NDArray[np.uint8]) -> Levels:
    """How many pixels of (n, height, width, 3) pictures have each level of each channel."""
    channels = pictures.reshape(-1, 3).T
    counted: Levels = np.stack([np.bincount(one, minlength=256) for one in channels], axis=1)
    return counted


def of_levels(levels: Levels, count: int) -> Stats:
    """Statistics of pictures, in 0 to 1 and by channel, each (3, 1, 1).

    Args:
        levels: How many pixels have each level.
        count: Number of the pictures.
    """
    value = np.arange(256)[:, None] / 255.0
    there = levels > 0
    total = levels.sum(axis=0)
    mean = (levels * value).sum(axis=0) / total
    stats: Stats = {
        "min": value[there.argmax(axis=0), 0],
        "max": value[255 - there[::-1].argmax(axis=0), 0],
        "mean": mean,
        "std": np.sqrt((levels * (value - mean) ** 2).sum(axis=0) / total),
    }
    # Between the two pixels next to it in order, as numpy's quantiles.
    below = levels.cumsum(axis=0)
    for name, share in _QUANTILES.items():
        place = share * (total - 1)
        first = np.floor(place)
        low, high = ((below <= at).sum(axis=0) for at in (first, np.ceil(place)))
        stats[name] = (low + (place - first) * (high - low)) / 255.0
    shaped = {name: values[:, None, None] for name, values in stats.items()}
    return shaped | {"count": np.array([count])}
