"""LeRobot data sets with the task's observations.

``observation.state`` are the entries of the group that are about robots, in the group's order,
``observation.environment_state`` those about objects, articulations or commands. Images become
videos.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.lerobot_env import image_key, lerobot_parts
from embodichain.recording.demos.demonstrations import Episode
from embodichain.recording.export.data_set import DataSet
from embodichain.recording.export.format_register import episode_format
from embodichain.recording.export.lerobot_writer import Feature, LeRobotWriter, whole_fps
from embodichain.recording.export.meaning import (
    action_names,
    describe_action,
    instruction_of,
    require_unique,
    robot_of,
)
from embodichain.recording.read.recorded_log import RecordedLog
from embodichain.utils.errors import ConfigError

__all__ = ["write_episodes"]

_log = logging.getLogger(__name__)


@episode_format("lerobot", suffix="", requires="embodichain[lerobot]")
def write_episodes(data: DataSet, path: Path) -> None:
    """Write a data set into a new folder. What cannot be a video is left out, with a warning.

    Raises:
        ConfigError: If a package is missing, the control frequency is not a whole number of Hz,
            the width or height of an image is odd, or the group has no entry to write.
        LogError: If a log is damaged.
    """
    with data.log() as log:
        fps, robot = whole_fps(log.dt), robot_of(log)
        task: Any = log.config["task"]
        names = action_names(log, data.first.actions.shape[1])
        features = {"action": Feature("float32", names, describe_action(log))}
    if not names:
        _log.warning("%s has no actions: the data set has no feature 'action'", data.first.task)
    parts = lerobot_parts(task, data.vectors)
    features = {
        key: Feature("float32", [column for name in names for column in data.columns(name)])
        for key, names in parts.items()
    } | features
    features["next.reward"] = Feature("float32", ["reward"])
    features["next.done"] = Feature("bool", ["done"])
    features["next.success"] = Feature("bool", ["success"])
    films = {name: key for name, key in _films(data)}
    if not parts and not films:
        raise ConfigError(f"observation group {data.group!r} has nothing that LeRobot can read")
    sizes = {key: _size(data.pictures(data.first, name)) for name, key in films.items()}
    instructions: dict[Path, str] = {}
    with LeRobotWriter(path, features, sizes, fps, robot) as writer:
        for episode in data:
            if episode.path not in instructions:
                with RecordedLog(episode.path) as log:
                    instructions[episode.path] = instruction_of(log)
            values: dict[str, NDArray[np.generic]] = {
                key: np.concatenate([data.vector(episode, n)[:-1] for n in names], axis=1)
                for key, names in parts.items()
            }
            values["action"] = episode.actions
            values["next.reward"] = episode.rewards[:, None]
            values["next.done"] = episode.dones[:, None]
            success = np.zeros((len(episode), 1), np.bool_)
            success[-1] = bool(episode.success)
            values["next.success"] = success
            source: dict[str, int | str] = {"env": episode.env, "episode": episode.episode}
            source |= {"first_step": episode.first_step, "log": episode.path.name}
            pictures = _pictures(data, episode, list(films))
            writer.add(values, source, instructions[episode.path], pictures)
        writer.finish()


def _films(data: DataSet) -> Iterator[tuple[str, str]]:
    """The images that can be videos, with the keys of these."""
    keys = require_unique(data.images, image_key, "lerobot")
    for name, key in keys.items():
        values = data.pictures(data.first, name)
        if values.dtype == np.uint8 and values.shape[-1] in (1, 3):
            yield name, f"observation.images.{key}"
        else:
            what = f"{values.shape[-1]} channels of {values.dtype}"
            _log.warning("%s is left out: a video has 1 or 3 channels of uint8, not %s", name, what)


def _size(pictures: NDArray[np.generic]) -> tuple[int, int]:
    """Width and height."""
    return pictures.shape[2], pictures.shape[1]


def _pictures(
    data: DataSet, episode: Episode, names: list[str]
) -> Iterator[list[NDArray[np.uint8]]]:
    """Yield the (H, W, 3) pictures of each frame, by the names of the images."""
    films = [data.pictures(episode, name) for name in names]
    for frame in range(len(episode)):
        yield [np.broadcast_to(film[frame], (*film.shape[1:3], 3)) for film in films]
