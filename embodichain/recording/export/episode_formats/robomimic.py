"""robomimic's HDF5 files of demonstrations, with the task's observations.

``data/demo_I`` has ``obs`` and ``next_obs`` (an array for each observation), ``actions``,
``rewards``, ``dones`` and ``states``; ``mask/train`` and ``mask/valid`` name demonstrations.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.demos.demonstrations import Episode
from embodichain.recording.export.data_set import DataSet
from embodichain.recording.export.format_register import episode_format
from embodichain.recording.export.hdf5_files import (
    ModelFiles,
    describe_root,
    new_hdf5,
    write_action_attributes,
    write_drawn,
    write_instruction,
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
        state = _state_columns(log)
        root = file.create_group("data")
        models = ModelFiles(file)
        describe_root(root, log)
        total = 0
        demos: list[str] = []
        with ExitStack() as stack:
            episode_log = log
            for number, episode in enumerate(data):
                if episode.path != episode_log.path:
                    stack.close()  # the log of the episodes before, except for the first log
                    episode_log = stack.enter_context(RecordedLog(episode.path))
                demo = root.create_group(f"demo_{number}")
                demo.attrs["num_samples"] = len(episode)
                models.add(demo, episode_log)
                write_instruction(demo, episode_log)
                write_drawn(demo, episode.drawn)
                demo.attrs["success"] = bool(episode.success)
                demo.attrs["log"] = episode.path.name
                demo.attrs["env"] = episode.env
                demo.attrs["episode"] = episode.episode
                demo.attrs["first_step"] = episode.first_step
                demo["actions"] = episode.actions
                write_action_attributes(demo["actions"], episode_log)
                demo["rewards"] = episode.rewards
                demo["dones"] = episode.dones.astype(np.int64)
                demo["states"] = episode.states[:, state.columns]
                demo["states"].attrs["names"] = state.names
                _write_observations(demo, data, episode, keys)
                total += len(episode)
                demos.append(f"demo_{number}")
                check()
        root.attrs["total"] = total
        # Of fewer than ten demonstrations, the last; never the only one.
        valid = demos[_VALID - 1 :: _VALID] or demos[1:][-1:]
        train = [name for name in demos if name not in valid]
        file["mask/train"] = np.array(train, "S")
        file["mask/valid"] = np.array(valid, "S")


def _keys(data: DataSet) -> dict[str, str]:
    """Name of each observation in the file: a "/" becomes "_", pictures end in ``_image``.

    Without images there is also `FLAT`.
    """

    def key(name: str) -> str:
        plain = name.replace("/", "_")
        # Only uint8 is a picture for robomimic; a depth image is an array.
        if name in data.images and data.pictures(data.first, name).dtype == np.uint8:
            return f"{plain}_image"
        return plain

    names = [*data.vectors, *data.images]
    if not data.images:
        names.append(FLAT)
    return require_unique(names, key, "robomimic")


def _write_observations(
    demo: Any, data: DataSet, episode: Episode, keys: Mapping[str, str]
) -> None:
    """Write what was observed before and after each step."""
    vectors = {name: data.vector(episode, name) for name in data.vectors}
    if FLAT in keys:
        vectors[FLAT] = np.concatenate([*vectors.values()], axis=1, dtype=np.float32)
    for name, values in vectors.items():
        demo[f"obs/{keys[name]}"] = values[:-1]
        demo[f"next_obs/{keys[name]}"] = values[1:]
    for name in data.images:
        pictures = data.pictures(episode, name)
        _write_pictures(demo, f"obs/{keys[name]}", pictures[:-1])
        _write_pictures(demo, f"next_obs/{keys[name]}", pictures[1:])


def _write_pictures(demo: Any, path: str, pictures: NDArray[Any]) -> None:
    """Write (T, H, W, C) pictures, each of which is read without its neighbours."""
    demo.create_dataset(
        path,
        data=pictures,
        chunks=(1, *pictures.shape[1:]),
        compression="gzip",
        compression_opts=1,
    )


class _StateColumns(NamedTuple):
    """The columns of ``states``.

    Attributes:
        names: Their names.
        columns: Where they are in a full row.
    """

    names: list[str]
    columns: NDArray[np.int64]


def _state_columns(log: RecordedLog) -> _StateColumns:
    """Return the columns of the components `_STATE` that the model has."""
    layout = log.header.layout
    columns = state_columns(log.model, layout)
    components = [name for name in _STATE if name in columns]
    names = [f"{name}/{column.name}" for name in components for column in columns[name]]
    indices = [np.arange(*layout[name]) for name in components]
    return _StateColumns(names, np.concatenate(indices))
