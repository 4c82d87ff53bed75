"""Frames of a LeRobot data set: their features, where these are in a log, and their file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.api import Log
from embodichain.recording.export.formats import required
from embodichain.recording.export.lerobot_stats import Stats, of_values
from embodichain.recording.views.motion import scalar_joints

__all__ = ["Columns", "Feature", "Frames", "features_of"]

_INDICES: Mapping[str, str] = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""Columns that every data set has, with their types."""

Columns = Mapping[str, NDArray[Any]]
"""Field of a log, `done` or `success` to (T, K) values of one episode."""


@dataclass(frozen=True, slots=True)
class Feature:
    """Columns that make up one feature.

    Attributes:
        key: Its name.
        dtype: float32 or bool.
        sources: Fields and their columns.
        names: Of its numbers.
    """

    key: str
    dtype: str
    sources: Mapping[str, list[int]]
    names: list[str]

    def of(self, columns: Columns) -> NDArray[Any]:
        """Return its (T, K) values."""
        parts = [columns[field][:, ids] for field, ids in self.sources.items()]
        whole: NDArray[Any] = np.concatenate(parts, axis=1).astype(self.dtype)
        return whole


def features_of(log: Log) -> list[Feature]:
    """Return the features of a log: joints are the robot's state, the rest the environment's.

    A state is as physics received it; rewards and ends are of what followed, hence ``next``.
    """
    joints, model = list(scalar_joints(log.model).values()), log.model
    positions, velocities = model.jnt_qposadr[joints].tolist(), model.jnt_dofadr[joints].tolist()
    floating = sorted(set(range(model.nq)) - set(positions))
    whole = {name: list(range(len(columns))) for name, columns in log.columns.items()}
    environment = {"qpos": floating, **{k: whole.get(k, []) for k in ("mocap_pos", "mocap_quat")}}
    made = [
        _feature(log, "observation.state", {"qpos": positions}),
        _feature(log, "observation.velocity", {"qvel": velocities}),
        _feature(log, "observation.environment_state", environment),
        _feature(log, "action", {"actions": whole.get("actions", [])}),
        Feature("next.reward", "float32", {"rewards": [0]}, ["rewards"]),
        Feature("next.done", "bool", {"done": [0]}, ["done"]),
        Feature("next.success", "bool", {"success": [0]}, ["success"]),
    ]
    return [feature for feature in made if feature.names]


def _feature(log: Log, key: str, columns: Mapping[str, list[int]]) -> Feature:
    there = {field: ids for field, ids in columns.items() if ids}
    names = [log.columns[field][i].name for field, ids in there.items() for i in ids]
    return Feature(key, "float32", there, names)


class Frames:
    """Writes frames into one Parquet file, an episode after the other.

    Args:
        path: The file, in a new folder.
        features: What a frame holds.
        fps: Frames a second.

    Attributes:
        episodes: For each episode its part of `meta/episodes`.
        stats: For each episode the statistics of its features.
    """

    def __init__(self, path: Path, features: Sequence[Feature], fps: int) -> None:
        self.episodes: list[dict[str, Any]] = []
        self.stats: list[dict[str, Stats]] = []
        self._path, self._features, self._fps = path, features, fps
        self._pa: Any = required("pyarrow", "lerobot")

    @property
    def total(self) -> int:
        """Frames so far."""
        return int(self.episodes[-1]["dataset_to_index"]) if self.episodes else 0

    def info(self) -> dict[str, Any]:
        """Return the features as `info.json` has them."""
        indices = {key: {"dtype": t, "shape": [1], "names": None} for key, t in _INDICES.items()}
        own = {
            f.key: {"dtype": f.dtype, "shape": [len(f.names)], "names": f.names}
            for f in self._features
        }
        return own | indices

    def write(self, episodes: Iterator[Columns]) -> None:
        """Write episodes, at least one."""
        pq: Any = required("pyarrow.parquet", "lerobot")
        first = self._table(next(episodes))
        self._path.parent.mkdir(parents=True)
        with pq.ParquetWriter(self._path, first.schema) as writer:
            writer.write_table(first)
            for columns in episodes:
                writer.write_table(self._table(columns))

    def _table(self, columns: Columns) -> Any:
        """Return an episode as a table, and note its place and statistics."""
        values = {feature.key: feature.of(columns) for feature in self._features}
        length, index, total = len(next(iter(values.values()))), len(self.episodes), self.total
        frames = np.arange(length)
        numbers = frames / self._fps, frames, np.full(length, index), frames + total, 0 * frames
        for (key, kind), column in zip(_INDICES.items(), numbers, strict=True):
            values[key] = column.astype(kind)[:, None]
        self.episodes.append(
            {
                "episode_index": index,
                "length": length,
                "data/chunk_index": 0,
                "data/file_index": 0,
                "dataset_from_index": total,
                "dataset_to_index": total + length,
            }
        )
        self.stats.append({key: of_values(value) for key, value in values.items()})
        return self._pa.table({key: self._array(value) for key, value in values.items()})

    def _array(self, values: NDArray[Any]) -> Any:
        flat = self._pa.array(values.reshape(-1))
        width = values.shape[1]
        return flat if width == 1 else self._pa.FixedSizeListArray.from_arrays(flat, width)
