"""Tables (csv, parquet) with a row per step and environment, arrays (npz), episodes (hdf5)."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.recording.export.formats import (
    Part,
    about,
    demonstrations,
    required,
)
from embodichain.recording.export.hdf5_files import (
    ModelFiles,
    describe_root,
    new_hdf5,
    say_action,
    say_task,
)
from embodichain.recording.export.meaning import require_unique
from embodichain.recording.export.parquet_files import new_parquet
from embodichain.recording.film.frames import FilmCamera, cameras_of, frames
from embodichain.recording.format.log_error import LogError
from embodichain.recording.format.messages.columns import Column
from embodichain.recording.read.api import Log
from embodichain.recording.read.arrays import LogArrays
from embodichain.recording.read.playback import Playback, Span

__all__ = ["write_csv", "write_hdf5", "write_npz", "write_parquet"]

_BYTES = 2**26
"""Approximate size of the data in memory at a time."""
_ROWS = 1000
_OBS = ("qpos", "qvel", "mocap_pos", "mocap_quat")
_STATE = ("time", "qpos", "qvel", "act")


def write_csv(log: Log, part: Part, path: Path) -> None:
    """Write a header line, ``field/column [unit]``, then the rows without loss of precision."""
    with path.open("x", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        for index, (columns, values) in enumerate(_tables(log, part)):
            if index == 0:
                writer.writerow([f"{c.name} [{c.unit}]" if c.unit else c.name for c in columns])
            for at in range(0, len(values[0]), _ROWS):  # signals are handled between blocks
                block = (v[at : at + _ROWS].tolist() for v in values)
                writer.writerows(zip(*block, strict=True))


def write_npz(log: Log, part: Part, path: Path) -> None:
    """Write fields, their names and units, `steps`, `time`, `env_ids` and `about`."""
    data = log.read(None, part.env, part.episode, part.start, part.stop)
    arrays: dict[str, NDArray[Any]] = {
        "steps": data.steps,
        "time": data.time,
        "env_ids": data.env_ids,
        "about": np.array(json.dumps(about(log))),
    }
    for field in data:
        arrays[field] = data[field]
        arrays[f"{field}.names"] = np.array(data.names(field), np.str_)
        arrays[f"{field}.units"] = np.array([c.unit for c in data.columns[field]], np.str_)
    with path.open("xb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def write_parquet(log: Log, part: Part, path: Path) -> None:
    """Write a typed table with a row group for every part that was read; units are metadata."""
    pa: Any = required("pyarrow", "parquet")
    writer: Any = None
    with ExitStack() as stack:
        for columns, values in _tables(log, part):
            arrays = [pa.array(v) for v in values]
            fields = [
                pa.field(c.name, array.type, metadata={"unit": c.unit} if c.unit else None)
                for c, array in zip(columns, arrays, strict=True)
            ]
            schema = pa.schema(fields, metadata=about(log))
            if writer is None:
                writer = stack.enter_context(new_parquet(path, schema, "parquet"))
            writer.write_table(pa.table(arrays, schema=schema))


def _tables(log: Log, part: Part) -> Iterator[tuple[list[Column], list[NDArray[Any]]]]:
    """Yield columns and their (T * N,) values, flags as 0 and 1, in parts that fit in memory.

    It yields at least one table; the first one may be empty.
    """
    width = sum(len(columns) for columns in log.columns.values())
    steps = max(1, _BYTES // (8 * width * log.num_envs))
    empty = log.read(env=part.env, start=part.start, stop=part.start)
    parts = log.parts(None, part.env, part.episode, part.start, part.stop, steps)
    for data in chain([empty], parts):
        columns, values = zip(*data.flat(), strict=True)
        yield list(columns), [v.astype(np.int8) if v.dtype == np.bool_ else v for v in values]


def write_hdf5(log: Log, part: Part, path: Path) -> None:
    """Write robomimic's layout: ``data/demo_I/{obs,actions,rewards,dones,states}`` per episode.

    A log contains states, not observations of a policy, so ``obs`` has positions, velocities and
    poses, and ``CAMERA_image`` (T, H, W, 3) of cameras, drawn from the states. ``states`` is time,
    qpos, qvel and act, flat, as in robosuite.

    Raises:
        ConfigError: If h5py is not installed, the part has no episode, there is no such camera, or
            two have the same name in the file.
        LogError: If an episode has no states, as in a log with keyframes opened without `simulate`.
        RenderError: If there are cameras, and no OpenGL library works here.
    """
    required("h5py", "hdf5")
    episodes = demonstrations(log, part)
    fields = {*_OBS, *_STATE, "actions", "rewards", "terminated", "truncated"}
    names = [name for name in log.columns if name in fields]
    cameras = cameras_of(log, part.cameras, part.size)
    keys = require_unique(cameras, lambda name: f"{name.replace('/', '_')}_image", "hdf5")
    filmed = {keys[name]: camera for name, camera in cameras.items()}
    with ExitStack() as stack:
        file, check = stack.enter_context(new_hdf5(path, "hdf5"))
        renderer = stack.enter_context(closing(OffscreenRenderer(log.model))) if cameras else None
        root, models = file.create_group("data"), ModelFiles(file)
        for number, (episode, steps) in enumerate(episodes):
            data = log.read(names, episode.env, None, steps.start, steps.stop)
            if not len(data):
                whose = f"episode {episode.episode} of environment {episode.env}"
                raise LogError(f"{log.path} has no state of {whose}")
            demo = root.create_group(f"demo_{number}")
            demo.attrs.update(env=episode.env, episode=episode.episode)
            models.add(demo, log)
            say_task(demo, log)
            _fill(demo, data)
            say_action(demo["actions"], log)
            if renderer is not None:
                _draw(demo, renderer, Playback(log, episode.env), filmed, steps)
            check()
        root.attrs["total"] = sum(int(demo.attrs["num_samples"]) for demo in root.values())
        root.attrs.update(about(log))
        describe_root(root, log)


def _fill(demo: Any, data: LogArrays) -> None:
    """Write the arrays of one episode."""
    demo.attrs["num_samples"], demo.attrs["first_step"] = len(data), int(data.steps[0])
    demo.create_dataset("actions", data=data["actions"][:, 0])
    demo.create_dataset("rewards", data=data["rewards"][:, 0])
    dones = data["terminated"][:, 0] | data["truncated"][:, 0]
    demo.create_dataset("dones", data=dones.astype(np.int64))
    state = [name for name in _STATE if name in data.values]
    flat = np.concatenate([data[name][:, 0] for name in state], axis=1)
    names = [f"{name}/{column}" for name in state for column in data.names(name)]
    demo.create_dataset("states", data=flat).attrs["names"] = names
    for name in _OBS:
        if name in data.values:
            made = demo.create_dataset(f"obs/{name}", data=data[name][:, 0])
            made.attrs["names"] = data.names(name)
            made.attrs["units"] = [column.unit for column in data.columns[name]]


def _draw(
    demo: Any,
    renderer: OffscreenRenderer,
    playback: Playback,
    cameras: Mapping[str, FilmCamera],
    steps: range,
) -> None:
    """Write the pictures of one episode; `cameras` are by their key in ``obs``."""
    made = []
    for name, camera in cameras.items():
        width, height = camera.size
        key, shape = f"obs/{name}", (len(steps), height, width, 3)
        how = {"dtype": np.uint8, "chunks": (1, *shape[1:]), "compression": "gzip"}
        made.append(demo.create_dataset(key, shape, **how))
    drawn = frames(renderer, playback, list(cameras.values()), Span(steps.start, steps.stop - 1))
    for frame in drawn:
        for pictures, picture in zip(made, frame.pictures, strict=True):
            pictures[frame.step - steps.start] = picture
