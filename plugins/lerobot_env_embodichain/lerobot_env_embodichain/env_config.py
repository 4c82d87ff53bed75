"""`EmbodiChainEnv`: the config of LeRobot's environment type ``embodichain``."""

from __future__ import annotations

import logging
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig

from embodichain.config import make_env, resolve
from embodichain.lab.gym.lerobot_env import KEYS, SCENE, STATE, LeRobotVectorEnv

__all__ = ["EmbodiChainEnv"]

_log = logging.getLogger(__name__)
_TYPES = {STATE: FeatureType.STATE, SCENE: FeatureType.ENV}


@EnvConfig.register_subclass("embodichain")
@dataclass
class EmbodiChainEnv(EnvConfig):
    """A task of embodichain.

    Attributes:
        task: The task's name, as `embodichain list tasks` prints it.
        overrides: Changes of its config, as on embodichain's command line.
        config_dir: A folder with configs of your own, searched first; None is `./conf` only.
        render_mode: ``rgb_array``, or None for evaluations without videos.
        fps: Control steps a second. 0, the default, is the task's; another number is an error.
        features: Observations and actions. Empty, the default, are the task's.
        features_map: Feature -> its name in a policy and in data sets.

    Raises:
        ConfigError: If the config has mistakes, or the task cannot be an environment of LeRobot.
    """

    task: str | None = "reach"
    fps: int = 0
    overrides: list[str] = field(default_factory=list)
    config_dir: str | None = None
    render_mode: str | None = "rgb_array"

    def __post_init__(self) -> None:
        """Read the task's features and control frequency from one environment."""
        with closing(self._make(1)) as env:
            rate = float(env.metadata["render_fps"])
            if self.fps not in (0, round(rate)):
                raise ValueError(
                    f"env.fps={self.fps}: the task has {rate:g} control steps a second"
                )
            self.fps = round(rate)
            if self.features:
                return
            # Keyed as the observations are, where LeRobot 0.6 looks them up to record them.
            for name, (_, shape) in env.features.items():
                key, kind = KEYS.get(name, name), _TYPES.get(name, FeatureType.VISUAL)
                self.features[key] = PolicyFeature(type=kind, shape=shape)
                self.features_map[key] = name
            shape = env.single_action_space.shape
            self.features["action"] = PolicyFeature(type=FeatureType.ACTION, shape=shape)
            self.features_map["action"] = "action"

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Nothing: `create_envs` makes the environments."""
        return {}

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, LeRobotVectorEnv]]:
        """Return the environments, as one batch, by type and number of the task.

        Args:
            n_envs: Number of environments, `--eval.batch_size`.
            use_async_envs: Not needed: the batch is stepped in this process, on all cores.
        """
        if use_async_envs and n_envs > 1:
            _log.info("env.type=embodichain is one batch in this process: no asynchronous envs")
        return {self.type: {0: self._make(n_envs)}}

    def _make(self, n_envs: int) -> LeRobotVectorEnv:
        if self.task is None:
            raise ValueError("env.task is the name of a task: embodichain list tasks")
        lines = [f"task={self.task}", "sim.warp.arrays=host", *self.overrides]
        resolved = resolve([*lines, f"num_envs={n_envs}"], "run", self.config_dir)
        env = make_env(resolved, render_mode=self.render_mode)
        return LeRobotVectorEnv(env, resolved.tree["task"], self.task)
