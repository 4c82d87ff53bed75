"""`try_expert`: whether the expert of a task solves it, before its file is written."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.cli.new_task.embodied_robot import TRIAL, write_trial_files
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.cli.new_task.embodied_robot import NewEmbodiment
    from embodichain.lab.gym.envs import BaseEnv

__all__ = ["EPISODES", "Trial", "trial_env", "try_expert"]

EPISODES = 48
"""Episodes of a trial."""


@dataclass(frozen=True)
class Trial:
    """How a task's expert did.

    Attributes:
        success: Share of episodes that ended in success.
        failure: Why the first of the others did not, for people; empty without one.
    """

    success: float
    failure: str = ""


def try_expert(task: str, embodiment: NewEmbodiment) -> Trial:
    """Let a task's expert play one episode in each of 48 environments, from seed 0.

    Args:
        task: The task's YAML.
        embodiment: Its embodiment.

    Returns:
        How it did; without a success if the task or its expert cannot be built for this robot.
    """
    from embodichain.lab.gym.policies import resolve_policy

    try:
        with trial_env(task, embodiment, num_envs=EPISODES) as env:
            obs, _ = env.reset(seed=0)
            expert = resolve_policy("expert")
            successes = 0
            failure = ""
            for _ in range(env.max_episode_steps):
                action = expert(obs, env)
                failures = getattr(expert, "failures", ())
                failure = failure or next((str(reason) for reason in failures if reason), "")
                obs, _, terminated, truncated, info = env.step(action)
                successes += int((info["success"] & (terminated | truncated)).sum())
            if successes == EPISODES:
                return Trial(1.0)
            slow = "it ended before the result was within the bound of success"
            return Trial(successes / EPISODES, failure or slow)
    except ConfigError as error:
        return Trial(0.0, str(error.problems[0]) if error.problems else str(error))


@contextmanager
def trial_env(task: str, embodiment: NewEmbodiment | None, *, num_envs: int) -> Iterator[BaseEnv]:
    """Build environments of a task that is not written yet; they are closed at the end.

    Args:
        task: The task's YAML.
        embodiment: Its embodiment, if it has one.
        num_envs: How many.
    """
    import embodichain

    with tempfile.TemporaryDirectory() as folder, _quiet():
        write_trial_files(Path(folder), task, embodiment)
        env = embodichain.make(TRIAL, num_envs=num_envs, seed=0, config_dir=folder)
        try:
            yield env
        finally:
            env.close()


@contextmanager
def _quiet() -> Iterator[None]:
    """Leave out messages about the file: `validate` has them."""
    logger = logging.getLogger("embodichain")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
