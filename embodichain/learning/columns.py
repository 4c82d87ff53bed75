"""Names of the columns of a flat observation: what tells two tasks of the same width apart."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["check_columns", "observation_columns"]


def observation_columns(env: BaseEnv, group: str = "policy") -> tuple[str, ...]:
    """Return a name for each column of a group's flat vector: ``robot/qpos[0]``.

    Args:
        env: The environment.
        group: The observation group.

    Raises:
        ValueError: If no observation is in the group.
    """
    columns: list[str] = []
    for name in env.observation_manager.group_terms(group):
        space: Any = env.single_observation_space
        for key in name.split("/"):
            space = space[key]
        for index in itertools.product(*map(range, space.shape)):
            columns.append(f"{name}[{','.join(map(str, index))}]" if index else name)
    return tuple(columns)


def check_columns(name: str, columns: Sequence[str], env: BaseEnv, group: str) -> None:
    """Check that a policy sees in an environment what it saw in training.

    Args:
        name: What messages call the policy.
        columns: What it was trained on.
        env: Where it will act.
        group: The observation group.

    Raises:
        ConfigError: If the columns are others; names the first that differs.
    """
    here = observation_columns(env, group)
    pairs = itertools.zip_longest(columns, here)
    different = next((i for i, (was, is_) in enumerate(pairs) if was != is_), None)
    if different is None:
        return
    was = columns[different] if different < len(columns) else "nothing"
    is_ = here[different] if different < len(here) else "nothing"
    message = (
        f"{name} was made for other observations: column {different} of {len(columns)} was {was}, "
        f"this task has {is_} ({len(here)} columns)"
    )
    raise ConfigError([Problem("policy", message)])
