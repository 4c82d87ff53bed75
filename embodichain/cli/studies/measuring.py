"""About how long stages take, measured on this machine before any of their kind is done."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from embodichain.cli.jobs.job import policy_of
from embodichain.cli.sweeps.sweep_plan import needs_machine
from embodichain.config.resolved import Resolved

__all__ = ["measure_evaluation", "measure_training"]

_TRAINED_STEPS = 1024
"""Environment steps of the training that is measured, beside those with random actions."""
_PLAYED_STEPS = 20
"""Control steps that are measured."""
_PLAYED_SECONDS = 1.0
"""Time after which no further step is measured."""


def measure_training(resolved: Resolved) -> float | None:
    """Train for a moment in a temporary folder, and return the seconds of the whole training.

    Args:
        resolved: The config of the training.

    Returns:
        The seconds; None where a training cannot be tried for a moment: on another machine than
        this, or with demonstrations.

    Raises:
        ConfigError: The task cannot be learned.
    """
    from embodichain.learning.training.train import train

    total = resolved.root.total_timesteps
    algo = resolved.tree.get("algo") or {}
    if total is None or resolved.root.dataset is not None or needs_machine(resolved):
        return None
    steps = min(total, int(algo.get("learning_starts") or 0) + _TRAINED_STEPS)
    short = resolved.changed(total_timesteps=steps, wandb={"mode": "disabled"})
    with tempfile.TemporaryDirectory() as folder:
        summary = train(short, Path(folder))
    return summary.train_seconds * total / summary.env_steps


def measure_evaluation(resolved: Resolved) -> float | None:
    """Step the environments of an evaluation, and return the seconds of its longest episodes.

    Args:
        resolved: The config of the evaluation.

    Returns:
        The seconds, in which a policy acts that does nothing; None where the evaluation needs
        another machine than this.
    """
    from embodichain.config.environments.factory import make_env

    if needs_machine(resolved):
        return None
    begun = time.perf_counter()
    env = make_env(resolved.changed(record={"format": "none"}))
    try:
        policy = policy_of(resolved.root, env, "zero")
        obs, _ = env.reset()
        to_begin = time.perf_counter() - begun
        begun = time.perf_counter()
        steps = 0
        while steps < _PLAYED_STEPS and time.perf_counter() - begun < _PLAYED_SECONDS:
            obs, *_ = env.step(policy(obs, env))
            steps += 1
        of_a_step = (time.perf_counter() - begun) / steps
        return to_begin + of_a_step * env.max_episode_steps
    finally:
        env.close()
