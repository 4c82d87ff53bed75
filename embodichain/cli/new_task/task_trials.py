"""`try_expert`: whether the expert of a task solves it, before its file is written."""

from __future__ import annotations

import logging
import re
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from embodichain.cli.new_task.embodied_robot import TRIAL, write_trial_files
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.cli.new_task.embodied_robot import NewEmbodiment
    from embodichain.lab.gym.envs import BaseEnv

__all__ = ["EPISODES", "Trial", "trial_env", "try_expert"]

EPISODES = 48
"""Episodes of a trial."""
_POOR = 0.5
"""Share of successes below which an expert does not solve its task."""
_SLOW = "it ended before the result was within the bound of success"
_MEASURED = re.compile(r"-?\d+(\.\d+)? (?=mm|m\b|rad|N)")
"""A measured number, which differs between episodes that fail alike."""


@dataclass(frozen=True)
class Trial:
    """How a task's expert did.

    Attributes:
        success: Share of episodes that ended in success.
        failure: Why most of the others did not, for people; empty without one.
        failure_count: How many of them failed so.
    """

    success: float
    failure: str = ""
    failure_count: int = 0

    @property
    def is_poor(self) -> bool:
        """Whether the expert fails more often than not: the task is not to be trained as it is."""
        return self.success < _POOR


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
            reasons: list[str] = []
            is_first_episode = np.ones(EPISODES, np.bool_)
            for _ in range(env.max_episode_steps):
                action = expert(obs, env)
                failures = [*getattr(expert, "failures", [None] * EPISODES)]
                obs, _, terminated, truncated, info = env.step(action)
                has_ended = is_first_episode & (terminated | truncated).numpy(force=True)
                has_failed = has_ended & ~info["success"].numpy(force=True)
                reasons += [failures[row] or _SLOW for row in np.flatnonzero(has_failed)]
                is_first_episode &= ~has_ended
            return _judge(reasons)
    except ConfigError as error:
        message = str(error.problems[0]) if error.problems else str(error)
        return Trial(0.0, message, EPISODES)


def _judge(reasons: Sequence[str]) -> Trial:
    """Return how an expert did, of the reasons of the episodes that failed."""
    if not reasons:
        return Trial(1.0)
    kinds = [_MEASURED.sub("", reason) for reason in reasons]
    ((kind, count),) = Counter(kinds).most_common(1)
    success = (EPISODES - len(reasons)) / EPISODES
    return Trial(success, reasons[kinds.index(kind)], count)


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
