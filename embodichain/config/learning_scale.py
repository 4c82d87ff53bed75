"""How much an update learns from: keys of `algo` that follow `num_envs` and `total_timesteps`.

The defaults of the libraries are for one environment: Stable-Baselines3's 2,048 control steps
between updates are 131,072 transitions in 64 environments, two updates in a training of 262,144.
Keys that the user or the task gives are kept. Does not import torch.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from embodichain.config.keys.learners import LEARNERS
from embodichain.config.keys.tensor_algorithms import PUBLISHED_STEPS, TensorAlgoCfg
from embodichain.utils.errors import Problem

__all__ = ["LearningScale", "doubtful_scale", "scale_learning"]

SMALLEST_ROLLOUT = 2_048
"""Transitions of a rollout, at least: fewer make advantages noisy."""
LARGEST_ROLLOUT = 16_384
"""Transitions of a rollout, at most: more make updates rare."""
STEPS_PER_ENV = 32
"""Control steps of each environment in a rollout, where its transitions are within these."""
UPDATES = 30
"""Number of updates of a training, at least; a rollout shrinks for them."""
FEW_UPDATES = 10
"""Fewer updates are warned about."""
MINIBATCHES = 4
"""Number of minibatches of a rollout."""
GRADIENT_STEPS = 64
"""Gradient steps between steps of the environments, at most, of algorithms with a replay buffer."""


@dataclass(frozen=True)
class LearningScale:
    """What an update learns from.

    Attributes:
        chosen: Keys of `algo` that were null -> their values.
        reason: What the values are for, as half a sentence; empty if none was chosen.
    """

    chosen: dict[str, int]
    reason: str = ""

    def notes(self) -> list[Problem]:
        """What was chosen and why, for people."""
        if not self.chosen:
            return []
        values = ", ".join(f"{key}={value}" for key, value in self.chosen.items())
        verb = "was" if len(self.chosen) == 1 else "were"
        return [Problem("algo", f"{values} {verb} chosen: {self.reason}")]


def scale_learning(
    algo: Mapping[str, Any], num_envs: int, total_timesteps: int | None
) -> LearningScale:
    """Choose the keys that are null and set how much an update learns from.

    Args:
        algo: The config of an algorithm, as a plain mapping.
        num_envs: Number of environments.
        total_timesteps: Length of the training, in environment steps; None if it is not known.
    """
    config = LEARNERS[algo["name"]].config
    if issubclass(config, TensorAlgoCfg):
        if not config.rollout_key:
            return LearningScale({})
        return _scale_tensor_rollout(algo, config.rollout_key, num_envs, total_timesteps)
    keys = {field.name for field in dataclasses.fields(config)}
    if "gradient_steps" in keys:
        return _scale_gradient_steps(algo, num_envs)
    if "gae_lambda" in keys:
        return _scale_rollout(algo, "batch_size" in keys, num_envs, total_timesteps)
    return LearningScale({})


def doubtful_scale(
    algo: Mapping[str, Any], num_envs: int, total_timesteps: int | None
) -> list[Problem]:
    """Return doubts about how much an update learns from, with the keys to write.

    Args:
        algo: The config of an algorithm, after `scale_learning`.
        num_envs: Number of environments.
        total_timesteps: Length of the training, in environment steps.
    """
    config = LEARNERS[algo["name"]].config
    key = config.rollout_key if issubclass(config, TensorAlgoCfg) else "n_steps"
    steps = algo.get(key)
    if steps is None or "gradient_steps" in algo:  # there, n_steps is of n-step returns
        return []
    rollout = num_envs * steps
    rollout_text = f"{rollout:,} steps ({num_envs} environments x {steps})"
    problems = []
    updates = math.ceil((total_timesteps or 0) / rollout)
    if total_timesteps is not None and updates < FEW_UPDATES:
        count = "1 update" if updates == 1 else f"{updates} updates"
        message = (
            f"{count} in all: total_timesteps {total_timesteps:,} are too few for rollouts of "
            f"{rollout_text}"
        )
        unset = {**algo, key: None, "batch_size": None}
        better_steps = scale_learning(unset, num_envs, total_timesteps).chosen.get(key, steps)
        if better_steps < steps:
            hint = f"Write algo.{key}={better_steps}"
        else:
            hint = "Give more total_timesteps"
        problems.append(Problem(f"algo.{key}", message, hint))
    batch = algo.get("batch_size")
    if batch is not None and rollout % batch:
        if batch < rollout:
            consequence = f"the last minibatch of each epoch has {rollout % batch}"
        else:
            consequence = "it is one minibatch"
        message = f"{batch} does not divide a rollout of {rollout_text}: {consequence}"
        hint = f"Write algo.batch_size={_minibatch(rollout)}"
        problems.append(Problem("algo.batch_size", message, hint))
    return problems


def _scale_rollout(
    algo: Mapping[str, Any], has_batches: bool, num_envs: int, total_timesteps: int | None
) -> LearningScale:
    """Choose `n_steps` and `batch_size` of an on-policy algorithm of Stable-Baselines3."""
    chosen = {}
    steps = algo.get("n_steps")
    batch = algo.get("batch_size") if has_batches else None
    if steps is None:
        rollout = min(max(STEPS_PER_ENV * num_envs, SMALLEST_ROLLOUT), LARGEST_ROLLOUT)
        steps = _steps(rollout, num_envs, total_timesteps)
        # Minibatches are of equal size if the rollout is a multiple of `divisor`.
        divisor = MINIBATCHES if batch is None else batch
        multiple = divisor // math.gcd(num_envs, divisor)
        if steps >= multiple or batch is not None:
            steps = max(multiple, steps // multiple * multiple)
        if num_envs == 1:
            steps = max(steps, 2)
        chosen["n_steps"] = steps
    if has_batches and batch is None:
        chosen["batch_size"] = _minibatch(num_envs * steps)
    return _rollout(chosen, num_envs, steps, total_timesteps)


def _scale_tensor_rollout(
    algo: Mapping[str, Any], key: str, num_envs: int, total_timesteps: int | None
) -> LearningScale:
    """Choose the control steps of a rollout of a learner on tensors."""
    if algo.get(key) is not None:
        return LearningScale({})
    # There is no largest rollout: thousands of environments are usual here.
    rollout = max(PUBLISHED_STEPS * num_envs, SMALLEST_ROLLOUT)
    steps = _steps(rollout, num_envs, total_timesteps)
    return _rollout({key: steps}, num_envs, steps, total_timesteps)


def _scale_gradient_steps(algo: Mapping[str, Any], num_envs: int) -> LearningScale:
    """Choose the gradient steps of an algorithm with a replay buffer."""
    if algo.get("gradient_steps") is not None:
        return LearningScale({})
    train_freq = algo.get("train_freq") or 1
    env_steps = num_envs * train_freq
    steps = min(GRADIENT_STEPS, env_steps)
    reason = (
        f"{env_steps} environment steps come between updates ({num_envs} environments x "
        f"train_freq {train_freq})"
    )
    if steps < env_steps:
        reason += f", and {GRADIENT_STEPS} gradient steps are the most"
    return LearningScale({"gradient_steps": steps}, reason)


def _steps(rollout: int, num_envs: int, total_timesteps: int | None) -> int:
    """Control steps of a rollout of about as many transitions, in a training of enough updates."""
    if total_timesteps is not None:
        rollout = min(rollout, total_timesteps // UPDATES)
    return max(1, rollout // num_envs)


def _minibatch(rollout: int) -> int:
    """Size of a minibatch: a quarter of a rollout, or the next part of at least two whole steps."""
    parts = next(k for k in range(MINIBATCHES, 0, -1) if rollout % k == 0 and rollout >= 2 * k)
    return rollout // parts


def _rollout(
    chosen: dict[str, int], num_envs: int, steps: int, total_timesteps: int | None
) -> LearningScale:
    """The keys of a rollout, with the reason for them."""
    rollout = num_envs * steps
    reason = f"rollouts of {rollout:,} steps ({num_envs} environments x {steps})"
    if total_timesteps is not None:
        reason = f"{math.ceil(total_timesteps / rollout):,} updates by {reason}"
    return LearningScale(chosen, reason)
