"""Registration of classes by `register_env`, and making them by id: batched, numpy, from a config.

The ids of YAML tasks, ``embodichain/NAME-v0``, are registered by `gymnasium_ids`.
"""

from __future__ import annotations

import copy
import json
import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

import gymnasium as gym
from gymnasium.vector import AutoresetMode

from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.utils.errors import ConfigError
from embodichain.utils.fields.defaults import is_given
from embodichain.utils.suggest import did_you_mean, listing

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.vector import NumpyVectorEnv

__all__ = [
    "REGISTERED_ENVS",
    "EnvSpec",
    "build_env",
    "config_declares_scene",
    "make",
    "make_vec",
    "register_env",
]

logger = logging.getLogger(__name__)

T = TypeVar("T", bound=Callable[..., Any])


@dataclass(frozen=True)
class EnvSpec:
    """One registered environment.

    Attributes:
        uid: Its id.
        cls: The class, or any callable that returns an environment.
        max_episode_steps: Its time limit in control steps; None keeps the environment's.
        default_kwargs: Default keyword arguments of `make`.
    """

    uid: str
    cls: Callable[..., Any]
    max_episode_steps: int | None = None
    default_kwargs: dict[str, Any] = field(default_factory=dict)


REGISTERED_ENVS: dict[str, EnvSpec] = {}


def register_env(
    uid: str, max_episode_steps: int | None = None, override: bool = False, **kwargs: Any
) -> Callable[[T], T]:
    """Make a class available to `gymnasium.make`, `gymnasium.make_vec` and `build_env`.

    ``gymnasium.make(uid, num_envs=N)`` is the class's batch of torch tensors, as in EmbodiChain.

    Args:
        uid: The id, for example ``RandomReach-v1``.
        max_episode_steps: Time limit in control steps of environments that are made without a
            config. It becomes the environment's limit, which applies to each of the N environments
            separately; Gymnasium's `TimeLimit`, which cannot do that, is added only if
            ``max_episode_steps`` is passed to `gymnasium.make`.
        override: Whether to replace an environment of the same id; otherwise a second one is
            skipped with a warning.
        **kwargs: Defaults of the class's keyword arguments, of JSON types.

    Returns:
        A decorator that returns the class.

    Raises:
        TypeError: If a default is not of a JSON type.
    """
    try:
        json.dumps(kwargs)
    except TypeError as error:
        raise TypeError(f"register_env({uid!r}): defaults must be JSON: {error}") from error

    def decorate(cls: T) -> T:
        if uid in REGISTERED_ENVS and not override:
            logger.warning("environment %r is registered already: skipped (see override)", uid)
            return cls
        REGISTERED_ENVS[uid] = EnvSpec(uid, cls, max_episode_steps, copy.deepcopy(kwargs))
        gym.registry.pop(uid, None)
        gym.register(
            uid,
            entry_point=f"{__name__}:make",
            vector_entry_point=f"{__name__}:make_vec",
            disable_env_checker=True,
            kwargs={"env_id": uid},
        )
        return cls

    return decorate


def _find(env_id: str) -> EnvSpec:
    try:
        return REGISTERED_ENVS[env_id]
    except KeyError:
        known = listing(REGISTERED_ENVS, env_id, "embodichain list tasks")
        hint = did_you_mean(env_id, REGISTERED_ENVS)
        if env_id.startswith("embodichain/"):
            hint = " Ids of YAML tasks are made by gymnasium.make, gymnasium.make_vec."
        raise ConfigError(f"no registered class {env_id!r}; there are: {known}.{hint}") from None


def make(env_id: str, max_episode_steps: int | None = None, **kwargs: Any) -> BaseEnv:
    """Make a registered environment, without Gymnasium's wrappers.

    Args:
        env_id: The id.
        max_episode_steps: Time limit in control steps; None is that of the given `cfg` if it has
            one, else the registered limit.
        **kwargs: Passed to the class; override the registered defaults.

    Raises:
        ConfigError: If there is no such environment; lists the registered ones.
    """
    spec = _find(env_id)
    env: BaseEnv = spec.cls(**{**copy.deepcopy(spec.default_kwargs), **kwargs})
    registered = None if _limits_episodes(kwargs.get("cfg")) else spec.max_episode_steps
    limit = registered if max_episode_steps is None else max_episode_steps
    if limit is not None:
        env.max_episode_steps = limit
    return env


_BUILDING = ("__init__", "_setup_robot", "_prepare_scene", "_setup_sensors")
"""Methods of an environment in which a class may add entities or change its config."""


def config_declares_scene(env_id: str) -> bool:
    """Return whether the config alone declares the scene of a registered environment.

    Then its scene can be compiled before it is built. A class that overrides a method in which it
    could add entities, and any other callable, is compiled inside the build.

    Args:
        env_id: The id.

    Raises:
        ConfigError: If there is no such environment; lists the registered ones.
    """
    from embodichain.lab.gym.envs.base_env import BaseEnv

    cls = _find(env_id).cls
    if not (isinstance(cls, type) and issubclass(cls, BaseEnv)):
        return False
    return all(getattr(cls, name) is getattr(BaseEnv, name) for name in _BUILDING)


def _limits_episodes(cfg: Any) -> bool:
    """Whether a config was given a time limit."""
    steps, seconds = (getattr(cfg, key, None) for key in ("max_episode_steps", "episode_length_s"))
    return seconds is not None or (steps is not None and is_given(steps))


def make_vec(
    env_id: str,
    num_envs: int = 1,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    flatten: bool = True,
    **kwargs: Any,
) -> NumpyVectorEnv:
    """Make a registered environment as Gymnasium's numpy `VectorEnv`.

    Args:
        env_id: The id.
        num_envs: N.
        autoreset_mode: NEXT_STEP, SAME_STEP or DISABLED; see `NumpyVectorEnv`.
        flatten: Whether observations are those of a policy; see `NumpyVectorEnv`.
        **kwargs: As for `make`.
    """
    from embodichain.lab.gym.envs.step.episodes import parse_mode
    from embodichain.lab.gym.vector import NumpyVectorEnv

    mode = parse_mode(autoreset_mode)  # an unknown mode is an error before the build
    return NumpyVectorEnv(make(env_id, num_envs=num_envs, **kwargs), mode, flatten)


def build_env(id: str, cfg: EnvCfg) -> BaseEnv:
    """Make a registered environment from a config, without Gymnasium's wrappers.

    Args:
        id: The id.
        cfg: Its config; copied.
    """
    return make(id, cfg=copy.deepcopy(cfg))
