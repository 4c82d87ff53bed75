"""`share_of_successes`: whether the expert of a task solves it, before its file is written."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.cli.new_task.embodied_robot import TRIAL, write_trial_files
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.cli.new_task.embodied_robot import NewEmbodiment
    from embodichain.lab.gym.envs import BaseEnv

__all__ = ["quiet", "share_of_successes", "trial_env"]

_EPISODES = 48


def share_of_successes(task: str, embodiment: NewEmbodiment) -> float:
    """Share of episodes, from seed 0, that a task's expert ends in success.

    Args:
        task: The task's YAML.
        embodiment: Its embodiment.

    Returns:
        The share; 0 if the task or its expert cannot be built for this robot.
    """
    from embodichain.lab.gym.policies import resolve_policy

    try:
        with trial_env(task, embodiment, num_envs=_EPISODES) as env:
            obs, _ = env.reset(seed=0)
            expert = resolve_policy("expert")
            success = 0.0
            for _ in range(env.max_episode_steps):
                obs, _, terminated, truncated, info = env.step(expert(obs, env))
                is_over = terminated | truncated
                success += float((info["success"] & is_over).sum())
            return success / _EPISODES
    except ConfigError as error:
        logging.getLogger(__name__).debug("the trial of an expert was refused: %s", error)
        return 0.0


@contextmanager
def trial_env(task: str, embodiment: NewEmbodiment | None, *, num_envs: int) -> Iterator[BaseEnv]:
    """Build environments of a task that is not written yet; they are closed at the end.

    Args:
        task: The task's YAML.
        embodiment: Its embodiment, if it has one.
        num_envs: How many.
    """
    import embodichain

    with tempfile.TemporaryDirectory() as folder, quiet():
        write_trial_files(Path(folder), task, embodiment)
        env = embodichain.make(TRIAL, num_envs=num_envs, seed=0, config_dir=folder)
        try:
            yield env
        finally:
            env.close()


@contextmanager
def quiet() -> Iterator[None]:
    """Leave out messages about the file: `validate` has them."""
    logger = logging.getLogger("embodichain")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
