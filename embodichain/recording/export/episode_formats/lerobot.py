"""LeRobot data sets with the task's observations.

``observation.state`` are the entries of the group that are about robots, in the group's order,
``observation.environment_state`` those about objects, articulations or commands. Images become
videos.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.lerobot_env import image_key, lerobot_parts
from embodichain.recording.demos.demonstrations import Episode
from embodichain.recording.export.data_set import DataSet
from embodichain.recording.export.format_register import episode_format
from embodichain.recording.export.lerobot_writer import (
    Feature,
    LeRobotWriter,
    Source,
    whole_fps,
)
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
        fps = whole_fps(log.dt)
        robot = robot_of(log)
        task: Any = log.config["task"]
        names_of_actions = action_names(log, data.first.actions.shape[1])
        action = Feature("float32", names_of_actions, describe_action(log))
    if not names_of_actions:
        _log.warning("%s has no actions: the data set has no feature 'action'", data.first.task)
    parts = lerobot_parts(task, data.vectors)
    features: dict[str, Feature] = {}
    for key, names in parts.items():
        columns = [column for name in names for column in data.columns(name)]
        features[key] = Feature("float32", columns)
    features["action"] = action
    features["next.reward"] = Feature("float32", ["reward"])
    features["next.done"] = Feature("bool", ["done"])
    features["next.success"] = Feature("bool", ["success"])
    videos = _video_keys(data)
    if not parts and not videos:
        raise ConfigError(f"observation group {data.group!r} has nothing that LeRobot can read")
    sizes = {key: _size(data.pictures(data.first, name)) for name, key in videos.items()}
    instructions: dict[Path, str] = {}
    with LeRobotWriter(path, features, sizes, fps, robot) as writer:
        for episode in data:
            if episode.path not in instructions:
                with RecordedLog(episode.path) as log:
                    instructions[episode.path] = instruction_of(log)
            source = Source(
                env=episode.env,
                episode=episode.episode,
                first_step=episode.first_step,
                log=episode.path.name,
                drawn=episode.drawn,
            )
            writer.add(
                _values(data, episode, parts),
                source,
                task=instructions[episode.path],
                pictures=_pictures(data, episode, list(videos)),
            )
        writer.finish()


def _video_keys(data: DataSet) -> dict[str, str]:
    """Keys of the videos by their images; warns of images that cannot be videos."""
    keys = require_unique(data.images, image_key, "lerobot")
    videos = {}
    for name, key in keys.items():
        pictures = data.pictures(data.first, name)
        channels = pictures.shape[-1]
        if pictures.dtype == np.uint8 and channels in (1, 3):
            videos[name] = f"observation.images.{key}"
        else:
            _log.warning(
                "%s is left out: a video has 1 or 3 channels of uint8, not %d channels of %s",
                name,
                channels,
                pictures.dtype,
            )
    return videos


def _size(pictures: NDArray[np.generic]) -> tuple[int, int]:
    """Width and height."""
    return pictures.shape[2], pictures.shape[1]


def _values(
    data: DataSet, episode: Episode, parts: Mapping[str, Sequence[str]]
) -> dict[str, NDArray[np.generic]]:
    """The (T, K) values of each feature of an episode; `parts` has the entries of observations."""
    values: dict[str, NDArray[np.generic]] = {}
    for key, names in parts.items():
        # The last observation comes after the last action.
        entries = [data.vector(episode, name)[:-1] for name in names]
        values[key] = np.concatenate(entries, axis=1)
    values["action"] = episode.actions
    values["next.reward"] = episode.rewards[:, None]
    values["next.done"] = episode.dones[:, None]
    success = np.zeros((len(episode), 1), np.bool_)
    success[-1] = bool(episode.success)
    values["next.success"] = success
    return values


def _pictures(
    data: DataSet, episode: Episode, names: list[str]
) -> Iterator[list[NDArray[np.uint8]]]:
    """Yield the (H, W, 3) pictures of each frame, in the order of the images' names."""
    images = [data.pictures(episode, name) for name in names]
    for frame in range(len(episode)):
        # An image of one channel becomes a grey video.
        yield [np.broadcast_to(image[frame], (*image.shape[1:3], 3)) for image in images]
