"""A LeRobotDataset v3: a folder for training with LeRobot, with the episodes of a log.

``data/`` has the frames, ``meta/`` the features, episodes and statistics, ``videos/`` the pictures
of the task's cameras (camera sensors, and those of the event `record_camera_data`), rendered from
the states. Every episode of a camera is a separate file.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.recording.api import Log
from embodichain.recording.episodes import LogEpisode
from embodichain.recording.export.formats import Part, demonstrations, required
from embodichain.recording.frames import FilmCamera, cameras_of, frames
from embodichain.recording.log_error import LogError
from embodichain.recording.playback import Playback, Span
from embodichain.recording.views.channels import scalar_joints
from embodichain.utils.errors import ConfigError
from embodichain.utils.video import VideoFile, need_encoder

__all__ = ["merged", "of_pictures", "of_values", "write_lerobot"]

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
_BLOCK_BYTES = 2**28
"""Approximate size of the data in memory at a time."""
_ENCODER = ("-g", "2", "-bf", "0")
"""Every second picture is a key frame, so any picture can be read without decoding many others."""
_SAMPLES, _PIXELS = 100, 150
"""Statistics use about 100 pictures per episode, reduced to about 150 pixels in length."""
_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

Columns = Mapping[str, NDArray[Any]]
"""Field of a log, `done` or `success` to (T, K) values of one episode."""
Stats = dict[str, NDArray[Any]]
"""min, max, mean, std, count and five quantiles of a feature."""
Demonstration = tuple[LogEpisode, range]


class _Feature(NamedTuple):
    """The columns of one feature, float32 or bool: fields with the indices of their columns."""

    dtype: str
    sources: Mapping[str, list[int]]
    names: list[str]

    def of(self, columns: Columns) -> NDArray[Any]:
        """Return its (T, K) values."""
        parts = [columns[field][:, ids] for field, ids in self.sources.items()]
        whole: NDArray[Any] = np.concatenate(parts, axis=1).astype(self.dtype)
        return whole


class _Camera(NamedTuple):
    """A camera of the data set."""

    key: str
    films: FilmCamera


def write_lerobot(log: Log, part: Part, path: Path) -> None:
    """Write the episodes of a part into a new folder, by environment, then in time.

    Raises:
        ConfigError: If pyarrow, pandas or, with cameras, the extra `video` is not installed, there
            is no episode, the control frequency is not a whole number of Hz, there is no such
            camera, or its width or height is odd.
        LogError: If the log lacks steps of an episode.
        RenderError: If there are cameras, and no OpenGL library works here.
    """
    pd: Any = required("pandas", "lerobot")
    fps = round(1.0 / log.dt)
    if fps < 1 or abs(fps * log.dt - 1.0) > 1e-6:
        raise ConfigError(
            f"LeRobot needs a whole number of frames a second; control steps make {1 / log.dt:g}"
        )
    chosen = demonstrations(log, part)
    features, cameras = _features(log), list(_cameras(log, part))
    if cameras:
        need_encoder()
    path.mkdir()
    rows, stats = _write_frames(path, log, chosen, features, fps)
    if cameras:
        _film(path, log, cameras, rows, stats, fps)
    task: Any = log.config.get("task")
    task = task if isinstance(task, dict) else {}
    robot, said = task.get("robot"), task.get("description")
    sentence = said if isinstance(said, str) and said else log.task
    _write_meta(path, rows, stats, sentence)
    pd.DataFrame({"task_index": [0]}, index=[sentence]).to_parquet(path / "meta/tasks.parquet")
    uid = robot.get("uid") if isinstance(robot, dict) else None
    info = {
        "codebase_version": _VERSION,
        "robot_type": None if uid is None else str(uid),
        "total_episodes": len(rows),
        "total_frames": rows[-1]["dataset_to_index"],
        "total_tasks": 1,
        "chunks_size": _CHUNK,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{len(rows)}"},
        "data_path": _DATA,
        "video_path": _VIDEO if cameras else None,
        "features": {
            key: {"dtype": f.dtype, "shape": [len(f.names)], "names": f.names}
            for key, f in features.items()
        }
        | {key: {"dtype": kind, "shape": [1], "names": None} for key, kind in _INDICES.items()}
        | {camera.key: _video_info(camera, fps) for camera in cameras},
    }
    (path / "meta/info.json").write_text(json.dumps(info, indent=4))


def _write_meta(
    root: Path, rows: list[dict[str, Any]], stats: list[dict[str, Stats]], task: str
) -> None:
    """Write the episodes with their statistics, and the overall statistics."""
    pa: Any = required("pyarrow", "lerobot")
    pq: Any = required("pyarrow.parquet", "lerobot")
    place = {"tasks": [task], "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
    table = [
        place | row | {f"stats/{k}/{n}": v.tolist() for k, s in own.items() for n, v in s.items()}
        for row, own in zip(rows, stats, strict=True)
    ]
    folder = root / "meta/episodes/chunk-000"
    folder.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(table), folder / "file-000.parquet")
    whole = {key: merged([own[key] for own in stats]) for key in stats[0]}
    tree = {key: {name: v.tolist() for name, v in s.items()} for key, s in whole.items()}
    (root / "meta/stats.json").write_text(json.dumps(tree, indent=4))


# -- frames ----------------------------------------------------------------------------------------


def _features(log: Log) -> dict[str, _Feature]:
    """Return the features of a log: joints as the robot's state, the rest as the environment's.

    States are before physics, rewards and ends after it, hence ``next``.
    """
    joints, model = list(scalar_joints(log.model).values()), log.model
    positions, velocities = model.jnt_qposadr[joints].tolist(), model.jnt_dofadr[joints].tolist()
    floating = sorted(set(range(model.nq)) - set(positions))
    whole = {name: list(range(len(columns))) for name, columns in log.columns.items()}
    environment = {"qpos": floating, **{k: whole.get(k, []) for k in ("mocap_pos", "mocap_quat")}}
    made = {
        "observation.state": {"qpos": positions},
        "observation.velocity": {"qvel": velocities},
        "observation.environment_state": environment,
        "action": {"actions": whole.get("actions", [])},
    }
    features = {}
    for key, columns in made.items():
        there = {field: ids for field, ids in columns.items() if ids}
        names = [log.columns[field][i].name for field, ids in there.items() for i in ids]
        if names:
            features[key] = _Feature("float32", there, names)
    return features | {
        "next.reward": _Feature("float32", {"rewards": [0]}, ["rewards"]),
        "next.done": _Feature("bool", {"done": [0]}, ["done"]),
        "next.success": _Feature("bool", {"success": [0]}, ["success"]),
    }


def _write_frames(
    root: Path, log: Log, chosen: list[Demonstration], features: Mapping[str, _Feature], fps: int
) -> tuple[list[dict[str, Any]], list[dict[str, Stats]]]:
    """Write one Parquet file; return the row of `meta/episodes` and the statistics of each."""
    pa: Any = required("pyarrow", "lerobot")
    pq: Any = required("pyarrow.parquet", "lerobot")
    path = root / _DATA.format(chunk_index=0, file_index=0)
    path.parent.mkdir(parents=True)
    rows, stats, writer, total = list[dict[str, Any]](), list[dict[str, Stats]](), None, 0

    def array(values: NDArray[Any]) -> Any:
        flat, width = pa.array(values.reshape(-1)), values.shape[1]
        return flat if width == 1 else pa.FixedSizeListArray.from_arrays(flat, width)

    with ExitStack() as stack:
        read = _read(log, chosen, features)
        for index, ((episode, steps), columns) in enumerate(zip(chosen, read, strict=True)):
            values = {key: feature.of(columns) for key, feature in features.items()}
            length, frames = len(steps), np.arange(len(steps))
            numbers = frames / fps, frames, np.full(length, index), frames + total, 0 * frames
            for (key, kind), column in zip(_INDICES.items(), numbers, strict=True):
                values[key] = column.astype(kind)[:, None]
            table = pa.table({key: array(value) for key, value in values.items()})
            writer = writer or stack.enter_context(pq.ParquetWriter(path, table.schema))
            writer.write_table(table)
            rows.append(
                {
                    "episode_index": index,
                    "length": length,
                    "data/chunk_index": 0,
                    "data/file_index": 0,
                    "dataset_from_index": total,
                    "dataset_to_index": total + length,
                    "source/env": episode.env,
                    "source/episode": episode.episode,
                    "source/first_step": steps.start,
                }
            )
            stats.append({key: of_values(value) for key, value in values.items()})
            total += length
    return rows, stats


def _read(
    log: Log, chosen: list[Demonstration], features: Mapping[str, _Feature]
) -> Iterator[Columns]:
    """Yield the columns of each episode; reads as many environments at a time as fit in memory."""
    fields = {field for feature in features.values() for field in feature.sources}
    fields |= {"terminated", "truncated"}
    names = [name for name in log.columns if name in fields]
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
                which = f"episode {episode.episode} of environment {episode.env}"
                raise LogError(f"{log.path} lacks steps of {which}")
            column = block.index(episode.env)
            found = {name: data[name][rows, column] for name in names}
            found["done"] = found["terminated"] | found["truncated"]
            found["success"] = np.zeros(len(steps), np.bool_)
            found["success"][-1] = bool(episode.succeeded) and steps[-1] == episode.last_step
            yield {name: v if v.ndim > 1 else v[:, None] for name, v in found.items()}


# -- pictures --------------------------------------------------------------------------------------


def _cameras(log: Log, part: Part) -> Iterator[_Camera]:
    chosen = cameras_of(log, part.cameras, part.size)
    if part.cameras is None:
        filmed = dict(_event_cameras(log, part.size))
        chosen |= {name if name not in chosen else f"{name}_film": c for name, c in filmed.items()}
    for name, camera in chosen.items():
        width, height = camera.size
        if width % 2 or height % 2:
            raise ConfigError(f"videos need an even width and height; {name} has {width}x{height}")
        yield _Camera(f"observation.images.{name.replace('/', '_')}", camera)


def _event_cameras(log: Log, size: tuple[int, int] | None) -> Iterator[tuple[str, FilmCamera]]:
    """Name and camera of each event `record_camera_data`."""
    from embodichain.lab.gym.envs.mdp.events.record import filmed_from

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
        width, height = size or map(int, params.get("resolution") or (640, 480))
        look = params.get("camera")
        if look is None:
            where = {key: params.get(key) for key in ("eye", "target", "up", "intrinsics")}
            look = filmed_from((width, height), **where)
        yield name, FilmCamera(look, (width, height))


def _video_info(camera: _Camera, fps: int) -> dict[str, Any]:
    width, height = camera.films.size
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


def _film(
    root: Path,
    log: Log,
    cameras: Sequence[_Camera],
    rows: list[dict[str, Any]],
    stats: list[dict[str, Stats]],
    fps: int,
) -> None:
    """Film every episode with every camera; add to its row and its statistics."""
    with closing(OffscreenRenderer(log.model)) as renderer:
        for row, own in zip(rows, stats, strict=True):
            chunk, file = divmod(row["episode_index"], _CHUNK)
            first, length = row["source/first_step"], row["length"]
            samples: list[list[NDArray[np.uint8]]] = [[] for _ in cameras]
            span = Span(first, first + length - 1)
            with ExitStack() as files:
                films = []
                for camera in cameras:
                    name = _VIDEO.format(video_key=camera.key, chunk_index=chunk, file_index=file)
                    film = VideoFile(root / name, camera.films.size, fps, _ENCODER)
                    films.append(files.enter_context(film))
                playback = Playback(log, row["source/env"])
                for frame in frames(renderer, playback, [c.films for c in cameras], span):
                    for film, picture, kept in zip(films, frame.pictures, samples, strict=True):
                        film.write(picture)
                        if not (frame.step - first) % max(1, length // _SAMPLES):
                            stride = max(1, max(picture.shape) // _PIXELS)
                            kept.append(picture[::stride, ::stride].copy())
            for camera, kept in zip(cameras, samples, strict=True):
                at = f"videos/{camera.key}"
                row |= {f"{at}/chunk_index": chunk, f"{at}/file_index": file}
                row |= {f"{at}/from_timestamp": 0.0, f"{at}/to_timestamp": length / fps}
                own[camera.key] = of_pictures(np.array(kept))


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


def of_pictures(pictures: NDArray[np.uint8]) -> Stats:
    """Statistics of (n, height, width, 3) pictures, in 0 to 1 and by channel, each (3, 1, 1)."""
    stats = of_values(pictures.reshape(-1, 3) / 255.0)
    shaped = {name: values[:, None, None] for name, values in stats.items() if name != "count"}
    return shaped | {"count": np.array([len(pictures)])}


def merged(parts: Sequence[Stats]) -> Stats:
    """Combine statistics of parts; quantiles are weighted means of the parts' quantiles."""
    counts = np.array([int(part["count"][0]) for part in parts])
    of = {name: np.array([part[name] for part in parts]) for name in parts[0]}
    mean: NDArray[Any]
    mean, *quantiles = (
        np.average(of[name], axis=0, weights=counts) for name in ("mean", *_QUANTILES)
    )
    squares = of["std"] ** 2 + (of["mean"] - mean) ** 2
    return {
        "min": of["min"].min(axis=0),
        "max": of["max"].max(axis=0),
        "mean": mean,
        "std": np.sqrt(np.average(squares, axis=0, weights=counts)),
        "count": np.array([int(counts.sum())]),
        **dict(zip(_QUANTILES, quantiles, strict=True)),
    }
