"""LeRobot data sets: folders for training with LeRobot, with the episodes of logs.

`write_lerobot` writes what a log has: states, and the pictures of the task's cameras (camera
sensors, and those of the event `record_camera_data`), rendered from the states. The task's
observations are in `episode_formats.lerobot`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.lerobot_env import image_key
from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.recording.export.format_register import log_format
from embodichain.recording.export.lerobot_writer import (
    Feature,
    LeRobotWriter,
    Source,
    whole_fps,
)
from embodichain.recording.export.log_parts import Demonstration, Part, demonstrations
from embodichain.recording.export.meaning import (
    describe_action,
    instruction_of,
    require_unique,
    robot_of,
)
from embodichain.recording.film.frames import FilmCamera, cameras_of, frames
from embodichain.recording.format.log_error import LogError
from embodichain.recording.read.api import Log
from embodichain.recording.read.arrays import LogArrays
from embodichain.recording.read.playback import Playback
from embodichain.recording.views.channels import scalar_joints

__all__ = ["write_lerobot"]

_log = logging.getLogger(__name__)
_BLOCK_BYTES = 2**28
"""Approximate size of the data in memory at a time."""

Columns = Mapping[str, NDArray[Any]]
"""Field of a log, `done` or `success` to (T, K) values of one episode."""


class _FeatureColumns(NamedTuple):
    """A feature, and the columns of the log that it consists of.

    Attributes:
        feature: The feature.
        fields: Field of the log to the indices of its columns.
    """

    feature: Feature
    fields: Mapping[str, list[int]]

    def values(self, columns: Columns) -> NDArray[Any]:
        """Return its (T, K) values."""
        parts = [columns[field][:, ids] for field, ids in self.fields.items()]
        return np.concatenate(parts, axis=1)


@log_format("lerobot", suffix="", requires="embodichain[lerobot]", pictures=True)
def write_lerobot(log: Log, part: Part, path: Path) -> None:
    """Write the episodes of a part into a new folder, by environment, then in time.

    Raises:
        ConfigError: If pyarrow, pandas or, with cameras, the extra `video` is not installed, there
            is no episode, the control frequency is not a whole number of Hz, there is no such
            camera, or its width or height is odd.
        LogError: If the log lacks steps of an episode.
        RenderError: If there are cameras, and no OpenGL library works here.
    """
    fps = whole_fps(log.dt)
    demos = demonstrations(log, part)
    feature_columns = _feature_columns(log)
    cameras = _cameras(log, part)
    features = {key: columns.feature for key, columns in feature_columns.items()}
    sizes = {key: camera.size for key, camera in cameras.items()}
    if "action" in features:
        features["action"] = features["action"]._replace(info=describe_action(log))
    else:
        _log.warning("%s has no actions: the data set has no feature 'action'", log.path)
    instruction = instruction_of(log)
    with ExitStack() as stack:
        writer = LeRobotWriter(path, features, sizes, fps, robot_of(log))
        stack.enter_context(writer)
        renderer = None
        if cameras:
            renderer = stack.enter_context(closing(OffscreenRenderer(log.model)))
        for demo, columns in _read(log, demos, feature_columns):
            episode = demo.episode
            values = {key: feature.values(columns) for key, feature in feature_columns.items()}
            pictures: Iterable[list[NDArray[np.uint8]]] = ()
            if renderer is not None:
                playback = Playback(log, episode.env)
                drawn = frames(renderer, playback, list(cameras.values()), demo.span)
                pictures = (frame.pictures for frame in drawn)
            source = Source(
                env=episode.env,
                episode=episode.episode,
                first_step=demo.steps.start,
                drawn=episode.drawn,
            )
            writer.add(values, source, task=instruction, pictures=pictures)
        writer.finish()


def _feature_columns(log: Log) -> dict[str, _FeatureColumns]:
    """Return the features with their columns: joints are the robot's state, the rest the scene's.

    States are before physics, rewards and ends after it, hence ``next``.
    """
    model = log.model
    joints = list(scalar_joints(model).values())
    positions = model.jnt_qposadr[joints].tolist()
    velocities = model.jnt_dofadr[joints].tolist()
    floating = sorted(set(range(model.nq)) - set(positions))
    all_ids = {name: list(range(len(columns))) for name, columns in log.columns.items()}
    candidates = {
        "observation.state": {"qpos": positions},
        "observation.velocity": {"qvel": velocities},
        "observation.environment_state": {
            "qpos": floating,
            "mocap_pos": all_ids.get("mocap_pos", []),
            "mocap_quat": all_ids.get("mocap_quat", []),
        },
        "action": {"actions": all_ids.get("actions", [])},
    }
    features: dict[str, _FeatureColumns] = {}
    for key, candidate in candidates.items():
        fields = {field: ids for field, ids in candidate.items() if ids}
        names = [log.columns[field][i].name for field, ids in fields.items() for i in ids]
        if names:
            features[key] = _FeatureColumns(Feature("float32", names), fields)
    features["next.reward"] = _FeatureColumns(Feature("float32", ["rewards"]), {"rewards": [0]})
    features["next.done"] = _FeatureColumns(Feature("bool", ["done"]), {"done": [0]})
    features["next.success"] = _FeatureColumns(Feature("bool", ["success"]), {"success": [0]})
    return features


def _read(
    log: Log, demos: list[Demonstration], features: Mapping[str, _FeatureColumns]
) -> Iterator[tuple[Demonstration, Columns]]:
    """Yield the episodes with their columns; read as many environments at once as fit in memory."""
    fields = {"terminated", "truncated"}
    for feature in features.values():
        fields.update(feature.fields)
    names = [name for name in log.columns if name in fields]
    start = min(demo.steps.start for demo in demos)
    stop = max(demo.steps.stop for demo in demos)
    width = sum(len(log.columns[name]) for name in names)
    envs_at_once = max(1, _BLOCK_BYTES // (8 * width * (stop - start)))
    envs = sorted({demo.episode.env for demo in demos})
    for first in range(0, len(envs), envs_at_once):
        block = envs[first : first + envs_at_once]
        data = log.read(names, env=block, start=start, stop=stop)
        for demo in demos:
            if demo.episode.env in block:
                yield demo, _columns(log, data, demo, names)


def _columns(log: Log, data: LogArrays, demo: Demonstration, names: Iterable[str]) -> Columns:
    """Return the columns of an episode from the data of several environments.

    Raises:
        LogError: If the log lacks steps of the episode.
    """
    episode = demo.episode
    steps = demo.steps
    rows = slice(*np.searchsorted(data.steps, [steps.start, steps.stop]).tolist())
    if rows.stop - rows.start != len(steps):
        raise LogError(
            f"{log.path} lacks steps of episode {episode.episode} of environment {episode.env}"
        )
    env_column = int(np.flatnonzero(data.env_ids == episode.env)[0])
    arrays = {name: data[name][rows, env_column] for name in names}
    arrays["done"] = arrays["terminated"] | arrays["truncated"]
    arrays["success"] = np.zeros(len(steps), np.bool_)
    arrays["success"][-1] = bool(episode.success) and steps[-1] == episode.last_step
    return {name: array if array.ndim > 1 else array[:, None] for name, array in arrays.items()}


def _cameras(log: Log, part: Part) -> dict[str, FilmCamera]:
    """The cameras by the keys of their videos."""
    cameras = cameras_of(log, part.cameras, part.size)
    if part.cameras is None:
        sensors = set(cameras)
        for name, camera in _event_cameras(log, part.size):
            if name in sensors:
                name = f"{name}_film"
            cameras[name] = camera
    keys = require_unique(cameras, image_key, "lerobot")
    return {f"observation.images.{keys[name]}": camera for name, camera in cameras.items()}


def _event_cameras(log: Log, size: tuple[int, int] | None) -> Iterator[tuple[str, FilmCamera]]:
    """Name and camera of each event `record_camera_data`."""
    from embodichain.lab.gym.envs.mdp.events.record import filmed_from

    task = log.config.get("task")
    events = task.get("events") if isinstance(task, dict) else None
    used_names: set[str] = set()
    for uid, event in (events or {}).items():
        if not isinstance(event, dict) or event.get("func") != "record_camera_data":
            continue
        params = event.get("params") or {}
        name = params.get("name") or "default"
        if name in used_names:
            name = f"{name}_{uid}"
        used_names.add(name)
        width, height = size or map(int, params.get("resolution") or (640, 480))
        camera = params.get("camera")
        if camera is None:
            camera = filmed_from(
                (width, height),
                eye=params.get("eye"),
                target=params.get("target"),
                up=params.get("up"),
                intrinsics=params.get("intrinsics"),
            )
        yield name, FilmCamera(camera, (width, height))
