"""The environment that robomimic makes of a data set's ``env_args``.

robomimic's `EnvGym` calls ``gym.make(env_name)`` of the old package gym, which imports the module
before the colon of `ENV_NAME`, this one; importing it registers the environment there. Steps are as
in gym before 0.26: observation, reward, whether the episode is done, info.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.config.composition.environment import as_reader, notes_of_today
from embodichain.config.environments.factory import make_env
from embodichain.config.environments.host_arrays import with_arrays
from embodichain.config.resolved import resolve_tree
from embodichain.lab.gym.envs.closed import require_open
from embodichain.lab.gym.single import SingleEnv
from embodichain.utils.errors import ConfigError

__all__ = ["ENV_NAME", "RobomimicEnv", "make_robomimic_env"]

_log = logging.getLogger(__name__)
_ID = "embodichain-v0"
ENV_NAME = f"{__name__}:{_ID}"
"""``env_name`` of data sets."""
_HERE = {"viewer": {"name": "none"}, "quiet": True, "video": False, "resume": None}
"""Keys of a run that are of that run only."""


class RobomimicEnv:
    """One environment of a data set's task, as robomimic's `EnvGym` steps it.

    Args:
        name: The task's name.
        config: The resolved config of the run that was recorded.

    Attributes:
        action_space: Actions of one environment.
        observation_space: The vector of the group ``policy``, which is ``flat`` in robomimic.

    Raises:
        ConfigError: If the config has mistakes, or the policy's observation is not a vector.
    """

    def __init__(self, name: str, config: Mapping[str, Any]) -> None:
        tree = {**config, "num_envs": 1, "policy": None}
        for key, value in _HERE.items():
            if key in config:  # a run of an earlier version may not have it
                tree[key] = value
        source = "env_args of the data set"
        resolved = resolve_tree(as_reader(tree), source, "run", task_name=name)
        for note in notes_of_today(resolved.tree):
            _log.warning("%s", note)
        self._env = SingleEnv(make_env(with_arrays(resolved, "host")))
        self.observation_space = self._env.observation_space
        self.action_space = self._env.action_space
        if len(self.observation_space.shape or ()) != 1:
            self.close()
            raise ConfigError(
                f"{name}: robomimic's gym environments observe one vector; the group policy has "
                "images"
            )
        self._success = False

    @property
    def unwrapped(self) -> RobomimicEnv:
        """Itself."""
        return self

    def reset(self) -> NDArray[np.float32]:
        """Start a new episode; return (K,) the first observation."""
        obs, _ = self._env.reset()
        self._success = False
        return obs

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, dict[str, Any]]:
        """Advance by one control step with (A,) an action in the task's units."""
        obs, reward, terminated, truncated, info = self._env.step(np.asarray(action, np.float32))
        self._success = bool(info.get("success", False))
        return obs, reward, terminated or truncated, info

    def render(self, mode: str = "rgb_array", **size: Any) -> NDArray[np.uint8]:
        """(480, 640, 3) RGB; other sizes are not drawn.

        Raises:
            NotImplementedError: For another mode.
        """
        if mode != "rgb_array":
            raise NotImplementedError(f"mode {mode!r}; there is rgb_array")
        require_open(self._env.env.is_closed)
        return self._env.env.sim.render(0)

    def close(self) -> None:
        """Free the simulation."""
        self._env.close()

    def _check_success(self) -> dict[str, bool]:
        """Whether the task has succeeded in this step, as robomimic asks for it."""
        return {"task": self._success}


def make_robomimic_env(name: str, config: Mapping[str, Any]) -> Any:
    """Make a `RobomimicEnv` that is also a gym ``Env``; arguments are its own."""
    gym: Any = importlib.import_module("gym")
    kind = type("RobomimicEnv", (RobomimicEnv, gym.Env), {})
    return kind(name, config)


def _register() -> None:
    """Make the environment known to the old package gym, if it is installed."""
    if importlib.util.find_spec("gym") is None:
        return
    gym: Any = importlib.import_module("gym.envs.registration")
    options: dict[str, Any] = {"order_enforce": False}
    if "disable_env_checker" in inspect.signature(gym.register).parameters:
        options["disable_env_checker"] = True
    gym.register(_ID, entry_point=make_robomimic_env, **options)


_register()
