"""Two keys of a task that set one value, in other units or words: the one given last counts.

``episode_length_s: 2`` in a file or override replaces an inherited ``max_episode_steps: 100``, and
the other way round.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from embodichain.utils.errors import Problem

__all__ = ["keep_last_given"]

_SAME = {"episode_length_s": "max_episode_steps", "decimation": "sim_steps_per_control"}
"""Task keys that override another key if set, see `EnvCfg`."""


def keep_last_given(tree: dict[str, Any], rank: Callable[[str], int]) -> list[Problem]:
    """Remove the key of each pair that was given first, in place.

    Args:
        tree: Plain dicts and lists.
        rank: Function from a key path to the number of the last file or override that sets it, in
            the order in which they are merged; -1 is none.

    Returns:
        A problem for each pair that one file or override sets.
    """
    task: Any = tree.get("task")
    if not isinstance(task, dict):
        return []
    problems: list[Problem] = []
    for name, other in _SAME.items():
        if task.get(name) is None or other not in task:
            continue
        name_rank = rank(f"task.{name}")
        other_rank = rank(f"task.{other}")
        if name_rank == other_rank != -1:
            message = f"task.{name} sets it too; set one of them"
            problems.append(Problem(f"task.{other}", message))
        elif name_rank >= other_rank:
            del task[other]
        else:
            del task[name]
    return problems
