"""`LeRobotVectorEnv`: a batch as the vector environment that LeRobot's evaluation steps.

Its observations are those of LeRobot data sets that `export --observations` writes: `lerobot_parts`
sorts the entries for both. `plugins/lerobot_env_embodichain` makes it known to LeRobot.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import NO_LIMIT
from embodichain.lab.gym.envs.closed import require_open
from embodichain.lab.gym.envs.observation import entry_spaces
from embodichain.lab.gym.observed_images import camera_uids, observed_images, rgb
from embodichain.lab.gym.vector import NumpyVectorEnv
from embodichain.utils.errors import ConfigError

__all__ = ["KEYS", "SCENE", "STATE", "LeRobotVectorEnv", "image_key", "lerobot_parts"]

STATE = "observation.state"
"""Feature of LeRobot: numbers about the robot."""
SCENE = "observation.environment_state"
"""Feature of LeRobot: numbers about the rest of the scene."""
_SECTIONS = ("objects", "articulations", "commands")
"""Sections of a task with what observations of the scene are of."""
KEYS = {STATE: "agent_pos", SCENE: "environment_state"}
"""Feature -> key of a vector environment's observation, as LeRobot translates it."""
_PIXELS = "pixels"
_NEW_ROLLOUT = "lerobot_new_rollout"
"""Option of `reset` with which LeRobot 0.6 marks a new rollout; every reset is one here."""
_IMAGE_SHAPE = 3


def lerobot_parts(task: Mapping[str, Any], names: Sequence[str]) -> dict[str, list[str]]:
    """Sort entries of an observation group by the feature that contains them.

    An entry is about the scene if parameters of its term name an object, an articulation or a
    command.

    Args:
        task: The task's config.
        names: Entries of the group that are not images, in order.

    Returns:
        `STATE` and `SCENE` to their entries; without a feature that has none.
    """
    scene_names: set[str] = set()
    for section in _SECTIONS:
        scene_names.update(task.get(section) or {})
    terms: Mapping[str, Any] = task.get("observations") or {}
    term_of_entry = {term.get("name") or key: term for key, term in terms.items()}
    parts: dict[str, list[str]] = {STATE: [], SCENE: []}
    for name in names:
        params = term_of_entry.get(name, {}).get("params")
        parts[SCENE if _mentions(params, scene_names) else STATE].append(name)
    return {feature: entries for feature, entries in parts.items() if entries}


def image_key(name: str) -> str:
    """Return the name of an image entry's camera in LeRobot's features."""
    return name.replace("/", "_")


def _mentions(value: Any, names: set[str]) -> bool:
    """Whether one of these names is a string within nested maps and lists."""
    if isinstance(value, Mapping):
        return any(_mentions(item, names) for item in value.values())
    if isinstance(value, (list, tuple)):
        return any(_mentions(item, names) for item in value)
    return isinstance(value, str) and value in names


class LeRobotVectorEnv(SyncVectorEnv):  # LeRobot films a `SyncVectorEnv` only
    """N environments, stepped as one batch, with LeRobot's observations and ``is_success``.

    Observations are a dict of ``agent_pos`` (N, K) and ``environment_state`` (N, M) float32, and
    ``pixels`` with a map of cameras to (N, H, W, 3) uint8, as far as the group ``policy`` has them.
    The mode is SAME_STEP; ``final_info["is_success"]`` (N,) bool is whether an episode that ended
    in this step succeeded.

    Args:
        env: The environment; `close` closes it.
        task: The task's config.
        name: The task's name, and its sentence if the config has no ``description``.

    Attributes:
        features: Feature of LeRobot -> (dtype, shape) of one environment; images (H, W, 3).
        envs: For each environment, the attributes that LeRobot reads of it.

    Raises:
        ConfigError: If episodes have no limit, there is no group ``policy``, or an image has
            neither 1 nor 3 channels of uint8.
    """

    def __init__(self, env: BaseEnv, task: Mapping[str, Any], name: str) -> None:
        limit = env.max_episode_steps
        if limit >= NO_LIMIT:
            raise ConfigError(f"{name}: LeRobot needs a limit: task.max_episode_steps")
        manager = env.observation_manager
        if "policy" not in manager.groups:
            raise ConfigError(f"{name}: LeRobot needs observations in the group policy")
        self._batch = NumpyVectorEnv(env, AutoresetMode.SAME_STEP, flatten=False)
        rate = float(self._batch.metadata["render_fps"])
        # PyAV, with which LeRobot 0.6 writes films, takes no float.
        fps = round(rate) if math.isclose(rate, round(rate)) else rate
        self.metadata = {**self._batch.metadata, "render_fps": fps}
        self.render_mode = self._batch.render_mode
        self.num_envs = self._batch.num_envs
        self.single_action_space = self._batch.single_action_space
        self.action_space = self._batch.action_space
        names = manager.group_terms("policy")
        entries = entry_spaces(env.single_observation_space, names)
        self._images = [name for name in names if len(entries[name].shape or ()) >= _IMAGE_SHAPE]
        vectors = [name for name in names if name not in self._images]
        self._sensors = _sensor_colors(env, task, names)
        self._parts = lerobot_parts(task, vectors)
        self.features: dict[str, tuple[str, tuple[int, ...]]] = {}
        for feature, part in self._parts.items():
            width = sum(_size(entries[entry]) for entry in part)
            self.features[feature] = ("float32", (width,))
        for image in self._images:
            shape = _picture_shape(image, entries[image])
            self.features[f"observation.images.{image_key(image)}"] = ("uint8", shape)
        for image, path in self._sensors.items():
            (space,) = entry_spaces(env.single_observation_space, [path]).values()
            height, width = (space.shape or ())[:2]
            self.features[f"observation.images.{image_key(image)}"] = ("uint8", (height, width, 3))
        self.single_observation_space = self._space()
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        sentence = str(task.get("description") or name)
        self.envs: Any = [
            _Member(self, i, task=name, description=sentence, limit=int(limit))
            for i in range(self.num_envs)
        ]

    def _space(self) -> spaces.Dict:
        boxes: dict[str, spaces.Space[Any]] = {}
        pictures: dict[str, spaces.Space[Any]] = {}
        for key, (_, shape) in self.features.items():
            if key in KEYS:
                boxes[KEYS[key]] = spaces.Box(-np.inf, np.inf, shape, np.float32)
            else:
                pictures[key.rpartition(".")[2]] = spaces.Box(0, 255, shape, np.uint8)
        if pictures:
            boxes[_PIXELS] = spaces.Dict(pictures)
        return spaces.Dict(boxes)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Any = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start new episodes.

        Args:
            seed: One integer for the batch, from which each environment derives its own streams; of
                LeRobot's list of one for each environment, the first.
            options: As of `BaseEnv.reset`; LeRobot's own is left out.
        """
        if isinstance(seed, Sequence):
            seed = seed[0] if seed else None
        own_options = {k: v for k, v in (options or {}).items() if k != _NEW_ROLLOUT}
        obs, info = self._batch.reset(seed=seed, options=own_options or None)
        return self._convert(obs), info

    def step(
        self, actions: Any
    ) -> tuple[dict[str, Any], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Advance all environments by one control step, see `BaseEnv.step`.

        Args:
            actions: (N, A) in the task's units.
        """
        obs, reward, terminated, truncated, info = self._batch.step(actions)
        if "final_info" in info:
            final = info["final_info"]
            final["is_success"] = final["success"] & info["_final_info"]
            del info["final_obs"], info["_final_obs"]  # LeRobot reads none
        return self._convert(obs), reward, terminated, truncated, info

    def _convert(self, obs: Mapping[str, Any]) -> dict[str, Any]:
        """The observation as LeRobot has it, from that of the batch."""
        converted: dict[str, Any] = {}
        for feature, names in self._parts.items():
            columns = [_entry(obs, name).reshape(self.num_envs, -1) for name in names]
            converted[KEYS[feature]] = np.concatenate(columns, axis=1, dtype=np.float32)
        pictures = {image_key(name): _pictures(obs, name) for name in self._images}
        for name, path in self._sensors.items():
            pictures[image_key(name)] = np.ascontiguousarray(rgb(_entry(obs, path)))
        if pictures:
            converted[_PIXELS] = pictures
        return converted

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Return an attribute of each environment's entry in `envs`, called if it is a method."""
        if name == "render":
            return self.render() or ()
        values = [getattr(env, name) for env in self.envs]
        return tuple(value(*args, **kwargs) if callable(value) else value for value in values)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute of each environment's entry in `envs`."""
        return self.call(name)

    def render(self) -> Any:
        """Tuple of one (480, 640, 3) RGB picture per environment; None unless ``rgb_array``."""
        if self.render_mode != "rgb_array":  # LeRobot asks all environments for pictures
            return None
        require_open(self._batch.env.is_closed)
        return self._batch.render()

    def render_one(self, index: int) -> NDArray[np.uint8] | None:
        """(480, 640, 3) RGB of one environment; None unless ``rgb_array``."""
        if self.render_mode != "rgb_array":
            return None
        require_open(self._batch.env.is_closed)
        return self._batch.env.sim.render(index)

    def close_extras(self, **kwargs: Any) -> None:
        """Close the environment."""
        self._batch.close()


class _Member:
    """What LeRobot reads of one environment.

    Attributes:
        task: The task's name.
        task_description: The sentence that a policy with language receives.
    """

    def __init__(
        self, batch: LeRobotVectorEnv, index: int, task: str, description: str, limit: int
    ) -> None:
        self.task = task
        self.task_description = description
        self._max_episode_steps = limit  # LeRobot reads it by this name
        self._batch = batch
        self._index = index

    def render(self) -> NDArray[np.uint8] | None:
        return self._batch.render_one(self._index)


def _sensor_colors(env: BaseEnv, task: Mapping[str, Any], names: Sequence[str]) -> dict[str, str]:
    """Names and paths of the colours of sensors with ``observe: true`` that no term has."""
    space: Any = env.single_observation_space
    if "sensor" not in getattr(space, "spaces", {}):
        return {}
    paths: list[str] = []
    for uid, outputs in space["sensor"].items():
        paths += [f"sensor/{uid}/{output}" for output in outputs]
    paths_without_term = [path for path in paths if path not in names]
    images = observed_images(paths_without_term, camera_uids(task), names)
    return {
        name: path
        for name, path in images.items()
        if path.rpartition("/")[2] in ("color", "color_right")
    }


def _entry(obs: Mapping[str, Any], name: str) -> NDArray[Any]:
    """(N, ...) an entry, by its name; "/" nests."""
    entry: Any = obs
    for part in name.split("/"):
        entry = entry[part]
    return entry


def _size(space: spaces.Space[Any]) -> int:
    return int(np.prod(space.shape or (), dtype=np.int64))


def _picture_shape(name: str, space: spaces.Space[Any]) -> tuple[int, int, int]:
    """(H, W, 3) of an image entry (C, H, W)."""
    channels, height, width = (space.shape or ())[-3:]
    if space.dtype != np.uint8 or channels not in (1, 3):
        actual = f"{channels} channels of {space.dtype}"
        raise ConfigError(f"{name}: LeRobot's images have 1 or 3 channels of uint8, not {actual}")
    return height, width, 3


def _pictures(obs: Mapping[str, Any], name: str) -> NDArray[np.uint8]:
    """(N, H, W, 3) an image entry (N, C, H, W)."""
    image = np.moveaxis(_entry(obs, name), 1, -1)
    return np.ascontiguousarray(np.broadcast_to(image, (*image.shape[:3], 3)))
