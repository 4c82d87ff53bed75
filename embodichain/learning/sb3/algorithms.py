"""`Algorithm`: a config's `algo` as arguments of Stable-Baselines3, checked before a run."""

from __future__ import annotations

import inspect
import logging
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import torch
from gymnasium.spaces import Box, Dict
from pydantic import TypeAdapter, ValidationError
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import (
    ActionNoise,
    NormalActionNoise,
    OrnsteinUhlenbeckActionNoise,
    VectorizedActionNoise,
)
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from embodichain.config.keys.algorithms import AlgoCfg
from embodichain.config.keys.learners import LEARNERS
from embodichain.learning.sb3.asymmetric import ASYMMETRIC
from embodichain.learning.sb3.extractors import EXTRACTORS
from embodichain.learning.sb3.normalization import number_keys
from embodichain.learning.sb3.symmetry import Mirror, MirroredMeanStd, SymmetricActorCriticPolicy
from embodichain.learning.sb3.vec_env import SB3VecEnv
from embodichain.learning.spaces import observation_columns, require_bounds
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.fields.type_errors import unknown_key, what_is_wrong
from embodichain.utils.suggest import did_you_mean

__all__ = ["Algorithm", "action_noise", "algorithm_class"]

_NAMED_CLASSES: dict[str, dict[str, Any]] = {
    "activation_fn": {
        "elu": torch.nn.ELU,
        "gelu": torch.nn.GELU,
        "leaky_relu": torch.nn.LeakyReLU,
        "relu": torch.nn.ReLU,
        "silu": torch.nn.SiLU,
        "tanh": torch.nn.Tanh,
    },
    "features_extractor_class": EXTRACTORS,
    "optimizer_class": {
        "adam": torch.optim.Adam,
        "adamw": torch.optim.AdamW,
        "rmsprop": torch.optim.RMSprop,
        "sgd": torch.optim.SGD,
    },
}
"""Keys of ``policy_kwargs`` with the name of a class as value."""
# Arguments that a user cannot set -> what to use instead.
_POLICY_INSTEAD = {
    "observation_space": "it is the task's",
    "action_space": "it is the task's",
    "lr_schedule": "use algo.learning_rate",
    "use_sde": "use algo.use_sde",
    "chunk_size": "use algo.chunk_size",
    "ensemble_decay": "use algo.ensemble_decay",
    "ignored": "use algo.ignore",
    "mirror": "use algo.symmetric and the task's symmetry",
}
_NORMALIZE_INSTEAD = {
    "venv": "the environment is the task's",
    "training": "it is true while training",
    "norm_obs_keys": "every observation that is not an image is normalized",
}
_LINEAR = "lin_"
_DEFAULT_GAMMA = 0.99
"""Discount of `VecNormalize`'s returns for an algorithm without one, as of Stable-Baselines3."""
_DEFAULT_STD = 0.1
"""Standard deviation of action noise."""
_log = logging.getLogger(__name__)


def algorithm_class(name: str) -> type[BaseAlgorithm]:
    """Return an algorithm by name.

    Raises:
        ConfigError: If the name is unknown (lists all), or a package is not installed (names it).
    """
    names = [key for key, entry in LEARNERS.items() if issubclass(entry.config, AlgoCfg)]
    if name not in names:
        message = f"unknown algorithm {name!r}; allowed: {', '.join(names)}"
        raise ConfigError([Problem("algo.name", message, did_you_mean(name, names).strip())])
    algorithm: type[BaseAlgorithm] = LEARNERS[name].load()
    return algorithm


@dataclass(frozen=True)
class Algorithm:
    """A checked algorithm, not yet built.

    Attributes:
        name: As in ``algo.name``.
        arguments: Keyword arguments of its class.
        normalize: Keyword arguments of `VecNormalize`; None if nothing is normalized.
        noise: Kind and standard deviation (None is 0.1) of action noise; None without noise.
        critic_groups: Observation groups of the critic; empty if it reads what the policy reads.
        symmetric: Whether the policy has the task's symmetry.
    """

    name: str
    arguments: dict[str, Any]
    normalize: dict[str, Any] | None = None
    noise: tuple[str, float | None] | None = None
    critic_groups: tuple[str, ...] = ()
    symmetric: bool = False

    @classmethod
    def of(cls, cfg: AlgoCfg) -> Algorithm:
        """Convert schedules and names to objects, and check arguments against signatures.

        Args:
            cfg: A config that passed the check of types.

        Raises:
            ConfigError: Every mistake, with paths below ``algo``.
        """
        if cfg.name == "dqn":
            message = "dqn chooses among discrete actions, a task's are continuous: use sac, td3 or"
            raise ConfigError([Problem("algo.name", f"{message} ppo")])
        algorithm = algorithm_class(cfg.name)
        arguments = {name: _scheduled(value) for name, value in cfg.arguments().items()}
        if cfg.policy not in algorithm.policy_aliases:
            message = f"{cfg.name} has no {cfg.policy}; allowed: "
            message += ", ".join(algorithm.policy_aliases)
            raise ConfigError([Problem("algo.policy", message)])
        policy = algorithm.policy_aliases[cfg.policy]
        arguments["policy_kwargs"], problems = _check_policy_kwargs(policy, cfg.policy_kwargs)
        problems += _check_critic(cfg, policy)
        problems += _check_symmetric(cfg, policy)
        normalize, normalize_problems = _check_normalize(cfg)
        problems += normalize_problems
        if problems:
            raise ConfigError(problems)
        noise: tuple[str, float | None] | None = None
        noise_type = getattr(cfg, "noise_type", None)
        if noise_type is not None:
            noise = (noise_type, getattr(cfg, "noise_std", None))
        return cls(
            name=cfg.name,
            arguments=arguments,
            normalize=normalize,
            noise=noise,
            critic_groups=tuple(cfg.critic_groups or ()),
            symmetric=bool(cfg.symmetric),
        )

    @property
    def flat(self) -> bool:
        """Whether its policy takes one array instead of a dict."""
        return not str(self.arguments["policy"]).startswith("MultiInput")

    @property
    def has_replay_buffer(self) -> bool:
        """Whether the algorithm learns from a replay buffer."""
        return issubclass(algorithm_class(self.name), OffPolicyAlgorithm)

    @property
    def is_cloning(self) -> bool:
        """Whether the algorithm learns from demonstrations alone."""
        return LEARNERS[self.name].demonstrations == "only"

    def build(self, vec_env: SB3VecEnv, seed: int | None) -> BaseAlgorithm:
        """Construct the algorithm for an environment, with `VecNormalize` if configured.

        Args:
            vec_env: The environment to learn in; actions (A,) in [-1, 1].
            seed: Seed of the networks, the exploration and the environment's next reset. It seeds
                the global generators of Python, numpy and torch, which Stable-Baselines3 uses.

        Raises:
            ConfigError: If the algorithm refuses its arguments.
        """
        algorithm: Any = algorithm_class(self.name)
        arguments = dict(self.arguments)
        policy_kwargs = dict(arguments.get("policy_kwargs", {}))
        squashes_output = policy_kwargs.get("squash_output", False)
        if squashes_output or not issubclass(algorithm, OnPolicyAlgorithm):
            require_bounds(vec_env.base, self.name)
        space: Any = vec_env.observation_space
        is_vector = isinstance(space, Box) and len(space.shape) == 1
        if str(arguments["policy"]).startswith("Mlp") and not is_vector:
            message = f"{arguments['policy']} takes a flat vector, the observation is an image: "
            raise ConfigError([Problem("algo.policy", message + "use CnnPolicy")])
        if arguments.get("optimize_memory_usage"):
            # Its buffer has no room for the last observation of an episode that is cut off.
            arguments["replay_buffer_kwargs"] = {"handle_timeout_termination": False}
            _log.warning(
                "algo.optimize_memory_usage: an episode that is cut off counts as terminated, as "
                "its last observation is not kept"
            )
        if self.critic_groups:
            arguments["policy"] = ASYMMETRIC[algorithm.policy_aliases[arguments["policy"]]]
            policy_kwargs["actor_keys"] = vec_env.actor_keys
            policy_kwargs["critic_keys"] = vec_env.critic_keys
        mirror: Mirror | None = None
        if self.symmetric:
            mirror = Mirror.of(vec_env.base, vec_env.group)
            arguments["policy"] = SymmetricActorCriticPolicy
            policy_kwargs["mirror"] = mirror.to_list()
        if self.noise is not None:
            kind, std = self.noise
            (width,) = vec_env.action_space.shape or (0,)
            arguments["action_noise"] = action_noise(kind, std, width, vec_env.num_envs)
        if self.is_cloning:
            policy_kwargs["ignored"] = _ignored(arguments.get("ignore"), vec_env)
        arguments["policy_kwargs"] = policy_kwargs
        env = self._normalize(vec_env, mirror)
        try:
            with warnings.catch_warnings():
                # `doubtful_scale` has said it, with the key to write.
                warnings.filterwarnings("ignore", "You have specified a mini-batch size")
                return algorithm(env=env, seed=seed, device="cpu", **arguments)
        except (AssertionError, TypeError, ValueError) as error:  # how SB3 refuses
            raise ConfigError([Problem("algo", f"{self.name} refuses this: {error}")]) from error

    def _normalize(self, vec_env: SB3VecEnv, mirror: Mirror | None) -> VecEnv:
        """Wrap an environment in `VecNormalize`, if anything is normalized."""
        if self.normalize is None:
            return vec_env
        kwargs = dict(self.normalize)
        if kwargs["norm_obs"]:
            keys = number_keys(vec_env.observation_space)
            if not keys:
                message = "an observation of images is not normalized: use reward, or false"
                raise ConfigError([Problem("algo.normalize", message)])
            if isinstance(vec_env.observation_space, Dict):
                kwargs["norm_obs_keys"] = keys
        normalized: Any = VecNormalize(vec_env, **kwargs)  # its obs_rms is declared as a dict
        if mirror is not None and kwargs["norm_obs"]:
            normalized.obs_rms = MirroredMeanStd(mirror)
        return cast(VecEnv, normalized)


def action_noise(kind: str, std: float | None, width: int, num_envs: int) -> ActionNoise:
    """Return noise for actions in [-1, 1], drawn separately for each environment.

    Args:
        kind: ``normal`` or ``ornstein-uhlenbeck``.
        std: Standard deviation; None is 0.1.
        width: Number of action columns.
        num_envs: Number of environments.
    """
    noise_class = NormalActionNoise if kind == "normal" else OrnsteinUhlenbeckActionNoise
    if std is None:
        std = _DEFAULT_STD
    noise = noise_class(np.zeros(width), np.full(width, std))
    if num_envs == 1:
        return noise
    return VectorizedActionNoise(noise, num_envs)


def _ignored(names: list[str] | None, vec_env: SB3VecEnv) -> list[int | str]:
    """Return what a `ChunkPolicy` does not read: columns of a vector, entries of a dict.

    Args:
        names: Observations; None are those of the last action.
        vec_env: The environment.

    Raises:
        ConfigError: If there is no such observation, or none remains.
    """
    manager = vec_env.base.observation_manager
    entries = manager.group_terms(vec_env.group)
    if names is None:
        last_actions = [
            term.cfg.name or term.name
            for term in manager.terms.values()
            if term.spec.name == "last_action"
        ]
        names = [name for name in last_actions if name in entries]
        if names:
            _log.info("bc does not read %s: algo.ignore=[] would", ", ".join(names))
    problems = [
        Problem(
            "algo.ignore",
            f"there is no observation {name!r}; there are: {', '.join(entries)}",
            did_you_mean(name, entries).strip(),
        )
        for name in names
        if name not in entries
    ]
    if not problems and len(set(names)) == len(entries):
        problems = [Problem("algo.ignore", "no observation remains")]
    if problems:
        raise ConfigError(problems)
    if isinstance(vec_env.observation_space, Dict):
        return list(names)
    columns = observation_columns(vec_env.base, vec_env.group)
    return [i for i, column in enumerate(columns) if column.partition("[")[0] in names]


def _scheduled(value: Any) -> Any:
    """Return ``lin_VALUE`` as a schedule that decays linearly to 0 at the end of training."""
    if isinstance(value, str) and value.startswith(_LINEAR):
        return LinearSchedule(float(value.removeprefix(_LINEAR)), 0.0, 1.0)
    return value


def _check_critic(cfg: AlgoCfg, policy: type[BasePolicy]) -> list[Problem]:
    """Check that actor and critic of the policy can read different groups."""
    if not cfg.critic_groups:
        return []
    if not cfg.policy.startswith("MultiInput"):
        message = "groups of the critic need a dict of observations: algo.policy=MultiInputPolicy"
        return [Problem("algo.critic_groups", message)]
    if policy not in ASYMMETRIC:
        message = f"{cfg.name} has one view of the observation; "
        message += "ppo, a2c, trpo, sac, td3 and ddpg can have two"
        return [Problem("algo.critic_groups", message)]
    if cfg.policy_kwargs.get("share_features_extractor"):
        message = "actor and critic with groups of their own share no features"
        return [Problem("algo.policy_kwargs.share_features_extractor", message)]
    return []


def _check_symmetric(cfg: AlgoCfg, policy: type[BasePolicy]) -> list[Problem]:
    """Check that the policy can be symmetric: Gaussian actions of a flat vector."""
    path = "algo.symmetric"
    if not cfg.symmetric:
        return []
    if policy is not ActorCriticPolicy:
        message = f"{cfg.policy} of {cfg.name} cannot be symmetric; "
        message += "MlpPolicy of ppo, a2c and trpo can; else use algo.symmetric=false"
        return [Problem(path, message)]
    if getattr(cfg, "use_sde", None):
        return [Problem(path, "noise that depends on the state (use_sde) is not symmetric")]
    return []


def _check_normalize(cfg: AlgoCfg) -> tuple[dict[str, Any] | None, list[Problem]]:
    """Return the arguments of `VecNormalize`, None if nothing is normalized, and every mistake."""
    path = "algo.normalize_kwargs"
    values, problems = _check_call(VecNormalize, cfg.normalize_kwargs, _NORMALIZE_INSTEAD, path)
    if not cfg.normalize:
        if cfg.normalize_kwargs:
            message = "nothing is normalized; set algo.normalize to obs, reward or both"
            problems.append(Problem(path, message))
        return None, problems
    gamma = getattr(cfg, "gamma", None)
    arguments = {
        "gamma": _DEFAULT_GAMMA if gamma is None else gamma,
        "norm_obs": cfg.normalize != "reward",
        "norm_reward": cfg.normalize != "obs",
        **values,
    }
    return arguments, problems


def _check_policy_kwargs(
    policy: Callable[..., Any], policy_kwargs: Mapping[str, Any]
) -> tuple[dict[str, Any], list[Problem]]:
    path = "algo.policy_kwargs"
    kwargs = dict(policy_kwargs)
    problems: list[Problem] = []
    for key, classes in _NAMED_CLASSES.items():
        if key not in kwargs:
            continue
        name = kwargs.pop(key)
        if isinstance(name, str) and name in classes:
            kwargs[key] = classes[name]
            continue
        message = f"unknown name {name!r}; allowed: {', '.join(classes)}"
        hint = did_you_mean(str(name), classes).strip()
        problems.append(Problem(f"{path}.{key}", message, hint))
    values, call_problems = _check_call(policy, kwargs, _POLICY_INSTEAD, path)
    problems += call_problems
    critic = "qf" if "n_critics" in inspect.signature(policy).parameters else "vf"
    problems += _check_layers(values.get("net_arch"), critic, f"{path}.net_arch")
    return values, problems


def _check_layers(layers: Any, critic: str, path: str) -> list[Problem]:
    """Check `net_arch`: SB3 ignores unknown keys of a map, and fails late on empty layers."""
    if not isinstance(layers, dict):
        return _check_widths(layers or [], path)
    problems: list[Problem] = []
    for key, widths in layers.items():
        if key in ("", "pi", critic):
            problems += _check_widths(widths, f"{path}.{key}" if key else path)
        else:
            message = f"unknown part; allowed: pi (policy), {critic} (value)"
            problems.append(Problem(f"{path}.{key}", message))
    return problems


def _check_widths(widths: list[int], path: str) -> list[Problem]:
    if any(width < 1 for width in widths):
        return [Problem(path, f"layers need a width of at least 1, got {widths}")]
    return []


def _check_call(
    function: Callable[..., Any],
    arguments: Mapping[str, Any],
    instead: Mapping[str, str],
    path: str,
) -> tuple[dict[str, Any], list[Problem]]:
    """Check arguments against a signature: names, then types.

    Returns:
        The values converted to the annotated types, and every mistake.
    """
    parameters = inspect.signature(function).parameters
    allowed = [name for name in parameters if name not in instead]
    values: dict[str, Any] = {}
    problems: list[Problem] = []
    for name, value in arguments.items():
        at = f"{path}.{name}"
        if name in instead:
            problems.append(Problem(at, f"cannot be set here: {instead[name]}"))
        elif name not in parameters:
            problems.append(Problem(at, *unknown_key(name, allowed)))
        else:
            try:
                values[name] = TypeAdapter(parameters[name].annotation).validate_python(value)
            except ValidationError as error:
                errors = error.errors(include_url=False)
                problems.append(Problem(at, *what_is_wrong(errors)))
    return values, problems
