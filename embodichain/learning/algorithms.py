"""Algorithms by name, and their arguments checked against their signatures before anything runs.

Which arguments a task suggests stands in its YAML; how training runs, in `train.py`; what
schedules and noise in a config mean, in `schedules.py`.
"""

from __future__ import annotations

import importlib
import inspect
import types
import typing
from collections.abc import Callable, Mapping
from typing import Any, Union

import numpy as np
import torch
from pydantic import TypeAdapter, ValidationError
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import (
    ActionNoise,
    NormalActionNoise,
    OrnsteinUhlenbeckActionNoise,
    VectorizedActionNoise,
)
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

__all__ = [
    "ACTIVATIONS",
    "ALGORITHMS",
    "OPTIMIZERS",
    "action_noise",
    "algorithm_class",
    "build_algorithm",
    "check_arguments",
    "check_normalize",
    "read_schedules",
]

ALGORITHMS: dict[str, tuple[str, str]] = {
    "ppo": ("stable_baselines3", "PPO"),
    "a2c": ("stable_baselines3", "A2C"),
    "sac": ("stable_baselines3", "SAC"),
    "td3": ("stable_baselines3", "TD3"),
    "ddpg": ("stable_baselines3", "DDPG"),
    "dqn": ("stable_baselines3", "DQN"),
    "trpo": ("sb3_contrib", "TRPO"),
    "tqc": ("sb3_contrib", "TQC"),
    "crossq": ("sb3_contrib", "CrossQ"),
    "recurrent_ppo": ("sb3_contrib", "RecurrentPPO"),
}
"""What ``algo.name`` may be: package and class."""

ACTIVATIONS: dict[str, type[torch.nn.Module]] = {
    "elu": torch.nn.ELU,
    "gelu": torch.nn.GELU,
    "leaky_relu": torch.nn.LeakyReLU,
    "relu": torch.nn.ReLU,
    "silu": torch.nn.SiLU,
    "tanh": torch.nn.Tanh,
}
"""What ``policy_kwargs.activation_fn`` may be."""

OPTIMIZERS: dict[str, type[torch.optim.Optimizer]] = {
    "adam": torch.optim.Adam,
    "adamw": torch.optim.AdamW,
    "rmsprop": torch.optim.RMSprop,
    "sgd": torch.optim.SGD,
}
"""What ``policy_kwargs.optimizer_class`` may be."""

_POLICIES = {"recurrent_ppo": "MlpLstmPolicy"}
_POLICY = "MlpPolicy"
_NAMED: dict[str, Mapping[str, Any]] = {
    "activation_fn": ACTIVATIONS,
    "optimizer_class": OPTIMIZERS,
}
# Arguments that somebody else gives; what to use instead.
_OURS = {
    "env": "the environment is the task's",
    "seed": "it stands at the root: seed=N",
    "device": "it stands at the root: device=NAME",
    "verbose": "the command shows progress itself",
    "tensorboard_log": "event files are in the run folder",
    "action_noise": "use algo.noise_type and algo.noise_std",
    "replay_buffer_class": "not available yet",
    "replay_buffer_kwargs": "not available yet",
    "rollout_buffer_class": "not available yet",
    "rollout_buffer_kwargs": "not available yet",
    "_init_setup_model": "the network is always built",
}
_POLICY_OURS = {
    "observation_space": "it is the task's",
    "action_space": "it is the task's",
    "lr_schedule": "use algo.learning_rate",
    "use_sde": "use algo.use_sde",
    "features_extractor_class": "not available yet",
}
_NORMALIZE_OURS = {
    "venv": "the environment is the task's",
    "training": "it is true while training",
    "norm_obs_keys": "observations are one flat vector",
}
_WORDS: dict[Any, str] = {
    int: "an integer",
    float: "a number",
    bool: "true or false",
    str: "text",
    type(None): "null",
    dict: "a map",
    list: "a list",
}


def algorithm_class(name: str) -> type[BaseAlgorithm]:
    """Return an algorithm by name.

    Raises:
        ConfigError: If there is none (lists them), or its package is not installed (names it).
    """
    found = ALGORITHMS.get(name)
    if found is None:
        message = f"unknown algorithm {name!r}; allowed: {', '.join(ALGORITHMS)}"
        raise ConfigError([Problem("algo.name", message, did_you_mean(name, ALGORITHMS).strip())])
    package, attribute = found
    try:
        module = importlib.import_module(package)
    except ModuleNotFoundError as error:
        if error.name != package:
            raise
        message = f"{name} needs a package: pip install {package.replace('_', '-')}"
        raise ConfigError([Problem("algo.name", message)]) from error
    algorithm: type[BaseAlgorithm] = getattr(module, attribute)
    return algorithm


def check_arguments(name: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Check an algorithm's arguments and turn names into the classes they mean.

    Args:
        name: The algorithm.
        arguments: Keyword arguments of its class, as a config gives them.

    Returns:
        The arguments to construct it with; ``policy`` is always there.

    Raises:
        ConfigError: Every mistake, with paths below ``algo``.
    """
    fits = _POLICIES.get(name, _POLICY)
    values = {"policy": fits, **arguments}
    problems: list[Problem] = []
    if name == "dqn":
        message = "dqn chooses among discrete actions, a task's are continuous: use sac, td3 or ppo"
        raise ConfigError([Problem("algo.name", message)])
    policy = values.pop("policy")
    if policy != fits:
        message = f"observations are one flat vector: only {fits!r} fits, got {policy!r}"
        problems.append(Problem("algo.policy", message))
    kwargs = values.pop("policy_kwargs", None) or {}
    algorithm = algorithm_class(name)
    values, found = read_schedules(values, inspect.signature(algorithm).parameters)
    problems += found
    values, found = _check_call(algorithm, values, _OURS, "algo")
    problems += found
    if not isinstance(kwargs, Mapping):
        problems.append(Problem("algo.policy_kwargs", f"needs a map, got {kwargs!r}"))
        raise ConfigError(problems)
    kwargs, found = _check_policy_kwargs(algorithm.policy_aliases[fits], dict(kwargs))
    problems += found
    if problems:
        raise ConfigError(problems)
    return {"policy": policy, **values, "policy_kwargs": kwargs}


def check_normalize(
    what: str | bool | None, arguments: Mapping[str, Any], gamma: float | None
) -> dict[str, Any] | None:
    """Check what `VecNormalize` is told.

    Args:
        what: ``obs``, ``reward``, ``both`` (or True); None (or False) for nothing.
        arguments: Keyword arguments of `VecNormalize`; they win.
        gamma: The algorithm's; None is 0.99, which all have.

    Returns:
        All its arguments, or None if nothing is normalized.

    Raises:
        ConfigError: Every mistake, with paths below ``algo``.
    """
    values, problems = _check_call(
        VecNormalize, arguments, _NORMALIZE_OURS, "algo.normalize_kwargs"
    )
    if arguments and not what:
        message = "nothing is normalized; set algo.normalize to obs, reward or both"
        problems.append(Problem("algo.normalize_kwargs", message))
    if problems:
        raise ConfigError(problems)
    if not what:
        return None
    chosen = {"norm_obs": what != "reward", "norm_reward": what != "obs"}
    return {"gamma": 0.99 if gamma is None else gamma, **chosen, **values}


def build_algorithm(
    name: str, arguments: Mapping[str, Any], vec_env: VecEnv, seed: int | None
) -> BaseAlgorithm:
    """Construct an algorithm on an environment.

    Args:
        name: The algorithm.
        arguments: What `check_arguments` returned.
        vec_env: The environment it learns in.
        seed: Of the networks, the exploration and the environment's next reset; seeds the global
            generators of Python, numpy and torch, because Stable-Baselines3 draws from them.

    Raises:
        ConfigError: If the algorithm refuses its arguments.
    """
    algorithm: Callable[..., BaseAlgorithm] = algorithm_class(name)
    try:
        return algorithm(env=vec_env, seed=seed, device="cpu", **arguments)
    except (AssertionError, TypeError, ValueError) as error:  # how SB3 refuses
        raise ConfigError([Problem("algo", f"{name} refuses this: {error}")]) from error


def _check_policy_kwargs(
    policy: Callable[..., Any], kwargs: dict[str, Any]
) -> tuple[dict[str, Any], list[Problem]]:
    path = "algo.policy_kwargs"
    problems: list[Problem] = []
    for key, table in _NAMED.items():
        if key not in kwargs:
            continue
        name = kwargs[key]
        if isinstance(name, str) and name in table:
            kwargs[key] = table[name]
            continue
        message = f"unknown name {name!r}; allowed: {', '.join(table)}"
        problems.append(Problem(f"{path}.{key}", message, did_you_mean(str(name), table).strip()))
        del kwargs[key]
    values, found = _check_call(policy, kwargs, _POLICY_OURS, path)
    critic = "qf" if "n_critics" in inspect.signature(policy).parameters else "vf"
    found += _check_layers(values.get("net_arch"), critic, f"{path}.net_arch")
    return values, problems + found


def _check_layers(layers: Any, critic: str, path: str) -> list[Problem]:
    """SB3 ignores unknown parts of a map, and fails late on empty layers."""
    parts = layers if isinstance(layers, dict) else {"": layers or []}
    unknown = [key for key in parts if key not in ("", "pi", critic)]
    problems = [
        Problem(f"{path}.{key}", f"unknown part; allowed: pi (policy), {critic} (value)")
        for key in unknown
    ]
    for key, widths in parts.items():
        if any(width < 1 for width in widths):
            at = f"{path}.{key}" if key else path
            problems.append(Problem(at, f"layers need a width of at least 1, got {widths}"))
    return problems


def _check_call(
    function: Callable[..., Any],
    arguments: Mapping[str, Any],
    ours: Mapping[str, str],
    path: str,
) -> tuple[dict[str, Any], list[Problem]]:
    """Check arguments against a signature: names, then types.

    Returns:
        The values as the annotations ask for them, and every mistake.
    """
    parameters = inspect.signature(function).parameters
    allowed = [name for name in parameters if name not in ours]
    values: dict[str, Any] = {}
    problems: list[Problem] = []
    for name, value in arguments.items():
        at = f"{path}.{name}"
        if name in ours:
            problems.append(Problem(at, f"cannot be set here: {ours[name]}"))
        elif name not in parameters:
            message = f"unknown argument; allowed: {', '.join(allowed)}"
            hint = did_you_mean(name, allowed).strip()
            problems.append(Problem(at, message, hint))
        else:
            annotation = parameters[name].annotation
            try:
                values[name] = TypeAdapter(annotation).validate_python(value)
            except ValidationError:
                problems.append(Problem(at, f"needs {_words(annotation)}, got {value!r}"))
    return values, problems


def _words(annotation: Any) -> str:
    """What an annotation allows in a config: callables and classes cannot be written there."""
    if typing.get_origin(annotation) in (Union, types.UnionType):
        words = [_words(member) for member in typing.get_args(annotation)]
        return " or ".join(word for word in words if word)
    if typing.get_origin(annotation) is list:
        return f"a list of {_words(typing.get_args(annotation)[0]).removeprefix('an ')}s"
    return _WORDS.get(typing.get_origin(annotation) or annotation, "")


_PREFIX = "lin_"
_DEFAULT_STD = 0.1


def read_schedules(
    arguments: Mapping[str, Any], parameters: Mapping[str, inspect.Parameter]
) -> tuple[dict[str, Any], list[Problem]]:
    """Turn ``lin_VALUE`` into a schedule where an algorithm takes schedules.

    Args:
        arguments: Of the algorithm, by name.
        parameters: Of its class.

    Returns:
        The arguments with schedules in them, and every mistake.
    """
    values = dict(arguments)
    problems: list[Problem] = []
    for name, value in arguments.items():
        if not isinstance(value, str) or not value.startswith(_PREFIX) or name not in parameters:
            continue
        path = f"algo.{name}"
        if "Callable" not in str(parameters[name].annotation):
            problems.append(Problem(path, f"takes no schedule, got {value!r}"))
            del values[name]
            continue
        try:
            start = float(value.removeprefix(_PREFIX))
        except ValueError:
            problems.append(Problem(path, f"a schedule is lin_VALUE, got {value!r}"))
            del values[name]
            continue
        values[name] = linear(start)
    return values, problems


def linear(start: float) -> Callable[[float], float]:
    """Return a schedule from `start` in a straight line down to 0 at the end of training."""
    schedule: Callable[[float], float] = LinearSchedule(start, 0.0, 1.0)
    return schedule


def action_noise(kind: str, std: float | None, width: int, num_envs: int) -> ActionNoise:
    """Return noise for actions in [-1, 1], drawn apart for each environment.

    Args:
        kind: ``normal`` or ``ornstein-uhlenbeck``.
        std: Its standard deviation; None is 0.1.
        width: Of an action.
        num_envs: How many environments.
    """
    mean, sigma = np.zeros(width), np.full(width, _DEFAULT_STD if std is None else std)
    base: ActionNoise = (
        NormalActionNoise(mean, sigma)
        if kind == "normal"
        else OrnsteinUhlenbeckActionNoise(mean, sigma)
    )
    return VectorizedActionNoise(base, num_envs) if num_envs > 1 else base
