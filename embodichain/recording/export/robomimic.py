"""robomimic's HDF5 files of demonstrations, with the task's observations.

``data/demo_I`` has ``obs`` and ``next_obs`` (an array for each observation), ``actions``,
``rewards``, ``dones`` and ``states``; ``mask/train`` and ``mask/valid`` name demonstrations.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.columns import state_columns
from embodichain.recording.demonstrations import Episode
from embodichain.recording.export.episodes import DataSet
from embodichain.recording.export.formats import model_xml, required, robomimic_env
from embodichain.recording.recorded_log import RecordedLog

__all__ = ["write_episodes"]

_STATE = ("time", "qpos", "qvel", "act", "mocap_pos", "mocap_quat")
"""Components of ``states``, in order; the first three as in robosuite."""
_VALID = 10
"""Every tenth demonstration is for validation."""


def write_episodes(data: DataSet, path: Path) -> None:
    """Write a data set.

    ``states`` are before each step; with ``model_file``, the scene as compiled, they can be put
    into MuJoCo. Randomized fields of a model are not in it: the log has them.

    Raises:
        ConfigError: If h5py is not installed.
        LogError: If a log is damaged.
    """
    h5py: Any = required("h5py", "robomimic")
    with data.log() as log, h5py.File(path, "x") as file:
        names, columns = _state_names(log)
        root = file.create_group("data")
        root.attrs["env_args"] = robomimic_env(log)
        models: dict[Path, str] = {log.path: model_xml(log)}
        total = 0
        demos: list[str] = []
        for number, episode in enumerate(data):
            if episode.path not in models:
                with RecordedLog(episode.path) as other:
                    models = {episode.path: model_xml(other)}
            demo = root.create_group(f"demo_{number}")
            demo.attrs["num_samples"] = len(episode)
            demo.attrs["model_file"] = models[episode.path]
            demo.attrs["success"] = bool(episode.success)
            demo.attrs["log"] = episode.path.name
            demo.attrs["env"], demo.attrs["episode"] = episode.env, episode.episode
            demo.attrs["first_step"] = episode.first_step
            demo["actions"] = episode.actions
            demo["rewards"] = episode.rewards
            demo["dones"] = episode.dones.astype(np.int64)
            demo["states"] = episode.states[:, columns]
            demo["states"].attrs["names"] = names
            _observe(demo, data, episode)
            total += len(episode)
            demos.append(f"demo_{number}")
        root.attrs["total"] = total
        valid = demos[_VALID - 1 :: _VALID] or demos[1:][-1:]
        train = [name for name in demos if name not in valid]
        for name, chosen in (("train", train), ("valid", valid)):
            file[f"mask/{name}"] = np.array(chosen, "S")


def _observe(demo: Any, data: DataSet, episode: Episode) -> None:
    """Write what was observed before and after each step; a "/" in a name becomes "_"."""
    for name in data.vectors:
        values = data.vector(episode, name)
        demo[f"obs/{_key(name)}"], demo[f"next_obs/{_key(name)}"] = values[:-1], values[1:]
    for name in data.images:
        values = data.pictures(episode, name)
        how = {"chunks": (1, *values.shape[1:]), "compression": "gzip", "compression_opts": 1}
        key = f"{_key(name)}_image" if values.dtype == np.uint8 else _key(name)
        for group, part in (("obs", values[:-1]), ("next_obs", values[1:])):
            demo.create_dataset(f"{group}/{key}", data=part, **how)


def _key(name: str) -> str:
    return name.replace("/", "_")


def _state_names(log: RecordedLog) -> tuple[list[str], NDArray[np.int64]]:
    """Names of the columns of ``states``, and where they are in a full row."""
    layout, named = log.header.layout, state_columns(log.model, log.header.layout)
    there = [name for name in _STATE if name in named]
    names = [f"{name}/{column.name}" for name in there for column in named[name]]
    return names, np.concatenate([np.arange(*layout[name]) for name in there])
