"""Files of a LeRobot data set: frames, and what `meta/` says of them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.export.formats import required
from embodichain.recording.export.lerobot_features import INDICES, Columns, Feature
from embodichain.recording.export.lerobot_stats import Stats, merged, of_values
from embodichain.recording.export.lerobot_videos import CHUNK, FILE, VIDEO, Videos

__all__ = ["Frames", "write_info", "write_meta"]

_VERSION = "v3.0"
_FILE_MB = 100
_DATA = f"data/{FILE}.parquet"


class Frames:
    """Writes frames, an episode after the other.

    Args:
        root: The data set's folder.
        features: What a frame holds.
        fps: Frames a second.
    """

    def __init__(self, root: Path, features: Sequence[Feature], fps: int) -> None:
        self.features, self.fps = features, fps
        self.total = 0
        self.episodes: list[dict[str, Any]] = []
        self.stats: list[dict[str, Stats]] = []
        self._root, self._number, self._bytes = root, 0, 0
        self._pa: Any = required("pyarrow", "lerobot")
        self._pq: Any = required("pyarrow.parquet", "lerobot")
        self._writer: Any = None

    def add(self, columns: Columns) -> None:
        """Add an episode."""
        values = {feature.key: feature.of(columns) for feature in self.features}
        length, index = len(next(iter(values.values()))), len(self.episodes)
        frames = np.arange(length)
        numbers = {
            "timestamp": frames / self.fps,
            "frame_index": frames,
            "episode_index": np.full(length, index),
            "index": frames + self.total,
            "task_index": np.zeros(length),
        }
        values |= {key: numbers[key].astype(kind)[:, None] for key, kind in INDICES.items()}
        table = self._pa.table({key: self._array(value) for key, value in values.items()})
        if self._writer is not None and self._bytes + table.nbytes > _FILE_MB * 2**20:
            self.close()
            self._number += 1
        self._write(table)
        chunk, file = divmod(self._number, CHUNK)
        self.episodes.append(
            {
                "episode_index": index,
                "length": length,
                "data/chunk_index": chunk,
                "data/file_index": file,
                "dataset_from_index": self.total,
                "dataset_to_index": self.total + length,
            }
        )
        self.stats.append({key: of_values(value) for key, value in values.items()})
        self.total += length

    def _array(self, values: NDArray[Any]) -> Any:
        flat = self._pa.array(values.reshape(-1))
        width = values.shape[1]
        return flat if width == 1 else self._pa.FixedSizeListArray.from_arrays(flat, width)

    def _write(self, table: Any) -> None:
        if self._writer is None:
            chunk, file = divmod(self._number, CHUNK)
            path = self._root / _DATA.format(chunk_index=chunk, file_index=file)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer, self._bytes = self._pq.ParquetWriter(path, table.schema), 0
        self._writer.write_table(table)
        self._bytes += table.nbytes

    def close(self) -> None:
        """Finish the file that is being written."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None


def write_meta(
    root: Path,
    task: str,
    frames: Frames,
    videos: Videos,
    sources: Sequence[dict[str, Any]],
) -> None:
    """Write the task, the episodes, where in the log they come from, and their statistics."""
    pa: Any = required("pyarrow", "lerobot")
    pq: Any = required("pyarrow.parquet", "lerobot")
    pd: Any = required("pandas", "lerobot")
    stats = [a | b for a, b in zip(frames.stats, videos.stats, strict=True)]
    rows = [
        row
        | {"tasks": [task], "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
        | source
        | video
        | {f"stats/{key}/{name}": v.tolist() for key, s in own.items() for name, v in s.items()}
        for row, video, own, source in zip(
            frames.episodes, videos.episodes, stats, sources, strict=True
        )
    ]
    folder = root / "meta/episodes/chunk-000"
    folder.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(rows), folder / "file-000.parquet")
    pd.DataFrame({"task_index": [0]}, index=[task]).to_parquet(root / "meta/tasks.parquet")
    whole = {key: merged([own[key] for own in stats]) for key in stats[0]}
    tree = {key: {name: v.tolist() for name, v in s.items()} for key, s in whole.items()}
    (root / "meta/stats.json").write_text(json.dumps(tree, indent=4))


def write_info(root: Path, robot: str | None, frames: Frames, videos: Videos) -> None:
    """Write `info.json`, which says what there is."""
    indices = {key: {"dtype": t, "shape": [1], "names": None} for key, t in INDICES.items()}
    info = {
        "codebase_version": _VERSION,
        "robot_type": robot,
        "total_episodes": len(frames.episodes),
        "total_frames": frames.total,
        "total_tasks": 1,
        "chunks_size": CHUNK,
        "data_files_size_in_mb": _FILE_MB,
        "video_files_size_in_mb": 200,
        "fps": frames.fps,
        "splits": {"train": f"0:{len(frames.episodes)}"},
        "data_path": _DATA,
        "video_path": VIDEO if videos.features else None,
        "features": {f.key: f.info() for f in frames.features} | videos.features | indices,
    }
    (root / "meta/info.json").write_text(json.dumps(info, indent=4))
