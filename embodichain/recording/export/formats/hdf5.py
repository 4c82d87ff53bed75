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
    say_action,
    say_task,
)
from embodichain.recording.export.log_parts import Part, about, demonstrations
from embodichain.recording.export.meaning import require_unique
from embodichain.recording.film.frames import FilmCamera, cameras_of, frames
from embodichain.recording.format.log_error import LogError
from embodichain.recording.read.api import Log
from embodichain.recording.read.arrays import LogArrays
from embodichain.recording.read.playback import Playback, Span

__all__ = ["write_hdf5"]

_OBS = ("qpos", "qvel", "mocap_pos", "mocap_quat")
_STATE = ("time", "qpos", "qvel", "act")


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
