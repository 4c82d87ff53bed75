"""robomimic's layout in HDF5: states, actions and pictures of each episode."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np

from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.recording.export.format_register import log_format, required
from embodichain.recording.export.hdf5_files import (
    ModelFiles,
    describe_root,
    new_hdf5,
    write_action_attributes,
    write_drawn,
    write_instruction,
)
from embodichain.recording.export.log_parts import Demonstration, Part, about, demonstrations
from embodichain.recording.export.meaning import require_unique
from embodichain.recording.film.frames import FilmCamera, cameras_of, frames
from embodichain.recording.format.log_error import LogError
from embodichain.recording.read.api import Log
from embodichain.recording.read.arrays import LogArrays
from embodichain.recording.read.playback import Playback

__all__ = ["write_hdf5"]

_OBS = ("qpos", "qvel", "mocap_pos", "mocap_quat")
"""Fields that are observations."""
_STATE = ("time", "qpos", "qvel", "act")
"""Fields of ``states``, in order, as in robosuite."""


@log_format("hdf5", suffix=".hdf5", requires="embodichain[hdf5]", pictures=True)
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
    demos = demonstrations(log, part)
    fields = {*_OBS, *_STATE, "actions", "rewards", "terminated", "truncated"}
    names = [name for name in log.columns if name in fields]
    cameras = _cameras(log, part)
    with ExitStack() as stack:
        file, check = stack.enter_context(new_hdf5(path, "hdf5"))
        renderer = None
        if cameras:
            renderer = stack.enter_context(closing(OffscreenRenderer(log.model)))
        root = file.create_group("data")
        models = ModelFiles(file)
        for number, demo in enumerate(demos):
            episode = demo.episode
            data = log.read(
                names,
                env=episode.env,
                start=demo.steps.start,
                stop=demo.steps.stop,
            )
            if not len(data):
                raise LogError(
                    f"{log.path} has no state of episode {episode.episode} of environment "
                    f"{episode.env}"
                )
            group = root.create_group(f"demo_{number}")
            group.attrs.update(env=episode.env, episode=episode.episode)
            models.add(group, log)
            write_instruction(group, log)
            write_drawn(group, episode.drawn)
            _write_arrays(group, data)
            write_action_attributes(group["actions"], log)
            if renderer is not None:
                _write_pictures(group, log, demo, renderer, cameras)
            check()
        root.attrs["total"] = sum(int(group.attrs["num_samples"]) for group in root.values())
        root.attrs.update(about(log))
        describe_root(root, log)


def _cameras(log: Log, part: Part) -> dict[str, FilmCamera]:
    """Cameras of a part by the names of their pictures in ``obs``."""

    def key(name: str) -> str:
        return f"{name.replace('/', '_')}_image"

    cameras = cameras_of(log, part.cameras, part.size)
    keys = require_unique(cameras, key, "hdf5")
    return {keys[name]: camera for name, camera in cameras.items()}


def _write_arrays(group: Any, data: LogArrays) -> None:
    """Write the arrays of one episode."""
    group.attrs["num_samples"] = len(data)
    group.attrs["first_step"] = int(data.steps[0])
    group.create_dataset("actions", data=data["actions"][:, 0])
    group.create_dataset("rewards", data=data["rewards"][:, 0])
    dones = data["terminated"][:, 0] | data["truncated"][:, 0]
    group.create_dataset("dones", data=dones.astype(np.int64))

    components = [name for name in _STATE if name in data.values]
    states = np.concatenate([data[name][:, 0] for name in components], axis=1)
    names = [f"{name}/{column}" for name in components for column in data.names(name)]
    group.create_dataset("states", data=states).attrs["names"] = names

    for name in _OBS:
        if name in data.values:
            array = group.create_dataset(f"obs/{name}", data=data[name][:, 0])
            array.attrs["names"] = data.names(name)
            array.attrs["units"] = [column.unit for column in data.columns[name]]


def _write_pictures(
    group: Any,
    log: Log,
    demo: Demonstration,
    renderer: OffscreenRenderer,
    cameras: Mapping[str, FilmCamera],
) -> None:
    """Write the pictures of one episode; `cameras` are by their key in ``obs``."""
    arrays = []
    for name, camera in cameras.items():
        width, height = camera.size
        array = group.create_dataset(
            f"obs/{name}",
            shape=(len(demo.steps), height, width, 3),
            dtype=np.uint8,
            chunks=(1, height, width, 3),  # a picture is read without its neighbours
            compression="gzip",
        )
        arrays.append(array)
    playback = Playback(log, demo.episode.env)
    for frame in frames(renderer, playback, list(cameras.values()), demo.span):
        row = frame.step - demo.steps.start
        for array, picture in zip(arrays, frame.pictures, strict=True):
            array[row] = picture
