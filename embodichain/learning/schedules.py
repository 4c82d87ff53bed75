"""Values of a config that become objects of Stable-Baselines3: schedules, noise on actions.

Spelling is rl-zoo3's: ``lin_3e-4``, ``noise_type``, ``noise_std``.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from stable_baselines3.common.noise import (
    ActionNoise,
    NormalActionNoise,
    OrnsteinUhlenbeckActionNoise,
    VectorizedActionNoise,
)
from stable_baselines3.common.utils import LinearSchedule

from embodichain.utils.errors import Problem

__all__ = ["action_noise", "read_schedules"]

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
