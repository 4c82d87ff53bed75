"""HDF5 in robomimic's layout: ``data/demo_I/{obs,actions,rewards,dones,states}``, an episode each.

A log holds states, not observations of a policy, so ``obs`` is what can be seen of a state:
positions, velocities and poses. ``states`` is time, qpos, qvel and act, flat, as robosuite has it.
"""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from embodichain.recording.api import Log
from embodichain.recording.arrays import LogArrays
from embodichain.recording.episodes import LogEpisode
from embodichain.recording.export.demonstrations import demonstrations
from embodichain.recording.export.formats import Part, required
from embodichain.recording.export.tables import about
from embodichain.recording.log_error import LogError

__all__ = ["write"]

_OBS = ("qpos", "qvel", "mocap_pos", "mocap_quat")
_STATE = ("time", "qpos", "qvel", "act")
_GYM = 2  # robomimic's EnvType.GYM_TYPE


def write(log: Log, part: Part, path: Path) -> None:
    """Write a demonstration for every episode, by environment, then in time.

    Raises:
        ConfigError: If h5py is not installed, or no episode is meant.
    """
    h5py: Any = required("h5py", "hdf5")
    episodes = demonstrations(log, part)
    model = _model_xml(log)
    with h5py.File(path, "x") as file:
        root = file.create_group("data")
        for number, (episode, steps) in enumerate(episodes):
            data = _read(log, episode, steps)
            _fill(root.create_group(f"demo_{number}"), log, data, episode, model)
        root.attrs["total"] = sum(int(demo.attrs["num_samples"]) for demo in root.values())
        root.attrs["env_args"] = json.dumps(
            {"env_name": log.task, "type": _GYM, "env_kwargs": log.config}
        )
        for name, value in about(log).items():
            root.attrs[name] = value


def _read(log: Log, episode: LogEpisode, steps: range) -> LogArrays:
    """What is written of an episode.

    Raises:
        LogError: If that is nothing: of a log with keyframes, which is not simulated.
    """
    fields = {*_OBS, *_STATE, "actions", "rewards", "terminated", "truncated"}
    names = [name for name in log.columns if name in fields]
    data = log.read(names, episode.env, None, steps.start, steps.stop)
    if not len(data):
        whose = f"episode {episode.episode} of environment {episode.env}"
        raise LogError(f"{log.path} has no state of {whose}")
    return data


def _fill(demo: Any, log: Log, data: LogArrays, episode: LogEpisode, model: str) -> None:
    demo.attrs["num_samples"] = len(data)
    demo.attrs["model_file"] = model
    demo.attrs["env"], demo.attrs["episode"] = episode.env, episode.episode
    demo.attrs["first_step"] = int(data.steps[0])
    demo.create_dataset("actions", data=data["actions"][:, 0])
    demo.create_dataset("rewards", data=data["rewards"][:, 0])
    dones = data["terminated"][:, 0] | data["truncated"][:, 0]
    demo.create_dataset("dones", data=dones.astype(np.int64))
    state = [name for name in _STATE if name in data.values]
    flat = np.concatenate([data[name][:, 0] for name in state], axis=1)
    demo.create_dataset("states", data=flat).attrs["names"] = [
        f"{name}/{column}" for name in state for column in data.names(name)
    ]
    for name in _OBS:
        if name in data.values:
            made = demo.create_dataset(f"obs/{name}", data=data[name][:, 0])
            made.attrs["names"] = data.names(name)
            made.attrs["units"] = [column.unit for column in data.columns[name]]


def _model_xml(log: Log) -> str:
    """The scene as XML; 6 digits, like every XML of a compiled model."""
    try:
        with zipfile.ZipFile(io.BytesIO(log.attachment("scene.mjz"))) as archive:
            return archive.read("model.xml").decode()
    except (zipfile.BadZipFile, KeyError) as error:
        raise LogError(f"{log.path}: the attachment scene.mjz is damaged: {error!r}") from error
