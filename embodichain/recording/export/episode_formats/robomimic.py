"""robomimic's HDF5 files of demonstrations, with the task's observations.

``data/demo_I`` has ``obs`` and ``next_obs`` (an array for each observation), ``actions``,
``rewards``, ``dones`` and ``states``; ``mask/train`` and ``mask/valid`` name demonstrations.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.demos.demonstrations import Episode
from embodichain.recording.export.data_set import DataSet
from embodichain.recording.export.format_register import episode_format
from embodichain.recording.export.hdf5_files import (
    ModelFiles,
    describe_root,
    new_hdf5,
    say_action,
    say_task,
)
from embodichain.recording.export.meaning import require_unique
from embodichain.recording.format.messages.columns import state_columns
from embodichain.recording.read.recorded_log import RecordedLog

__all__ = ["write_episodes"]

_STATE = ("time", "qpos", "qvel", "act", "mocap_pos", "mocap_quat")
"""Components of ``states``, in order; the first three as in robosuite."""
_VALID = 10
"""Every tenth demonstration is for validation."""
FLAT = "flat"
"""The vector of the whole group: the only observation of robomimic's gym environments."""


@episode_format("robomimic", suffix=".hdf5", requires="embodichain[hdf5]")
def write_episodes(data: DataSet, path: Path) -> None:
    """Write a data set.

    ``states`` are before each step; with ``model_file``, the scene as compiled, and the files that
    it names, they can be put into MuJoCo. Randomized fields of a model are not in it: the log has
    them.

    Raises:
        ConfigError: If h5py is not installed, or two observations have the same name.
        LogError: If a log is damaged.
    """
    keys = _keys(data)
    with data.log() as log, new_hdf5(path, "robomimic") as (file, check):
        names, columns = _state_names(log)
        root, models = file.create_group("data"), ModelFiles(file)
        describe_root(root, log)
        total = 0
        demos: list[str] = []
        with ExitStack() as stack:
            other = log
            for number, episode in enumerate(data):
                if episode.path != other.path:
                    stack.close()
                    other = stack.enter_context(RecordedLog(episode.path))
                demo = root.create_group(f"demo_{number}")
                demo.attrs["num_samples"] = len(episode)
                models.add(demo, other)
                say_task(demo, other)
                demo.attrs["success"] = bool(episode.success)
                demo.attrs["log"] = episode.path.name
                demo.attrs["env"], demo.attrs["episode"] = episode.env, episode.episode
                demo.attrs["first_step"] = episode.first_step
                demo["actions"] = episode.actions
                say_action(demo["actions"], other)
                demo["rewards"] = episode.rewards
                demo["dones"] = episode.dones.astype(np.int64)
                demo["states"] = episode.states[:, columns]
                demo["states"].attrs["names"] = names
                _observe(demo, data, episode, keys)
                total += len(episode)
                demos.append(f"demo_{number}")
                check()
        root.attrs["total"] = total
        valid = demos[_VALID - 1 :: _VALID] or demos[1:][-1:]
        train = [name for name in demos if name not in valid]
        for name, chosen in (("train", train), ("valid", valid)):
            file[f"mask/{name}"] = np.array(chosen, "S")


def _keys(data: DataSet) -> dict[str, str]:
    """Name of each observation in the file: a "/" becomes "_", pictures end in ``_image``.

    Without images there is also `FLAT`.
    """

    def key(name: str) -> str:
        plain = name.replace("/", "_")
        if name not in data.images:
            return plain
        return f"{plain}_image" if data.pictures(data.first, name).dtype == np.uint8 else plain

    flat = [] if data.images else [FLAT]
    return require_unique([*data.vectors, *data.images, *flat], key, "robomimic")


def _observe(demo: Any, data: DataSet, episode: Episode, keys: Mapping[str, str]) -> None:
    """Write what was observed before and after each step."""
    vectors = {name: data.vector(episode, name) for name in data.vectors}
    if FLAT in keys:
        vectors[FLAT] = np.concatenate([*vectors.values()], axis=1, dtype=np.float32)
    for name, values in vectors.items():
        demo[f"obs/{keys[name]}"], demo[f"next_obs/{keys[name]}"] = values[:-1], values[1:]
    for name in data.images:
        values = data.pictures(episode, name)
        how = {"chunks": (1, *values.shape[1:]), "compression": "gzip", "compression_opts": 1}
        for group, part in (("obs", values[:-1]), ("next_obs", values[1:])):
            demo.create_dataset(f"{group}/{keys[name]}", data=part, **how)


def _state_names(log: RecordedLog) -> tuple[list[str], NDArray[np.int64]]:
    """Names of the columns of ``states``, and where they are in a full row."""
    layout, named = log.header.layout, state_columns(log.model, log.header.layout)
    there = [name for name in _STATE if name in named]
    names = [f"{name}/{column.name}" for name in there for column in named[name]]
    return names, np.concatenate([np.arange(*layout[name]) for name in there])
