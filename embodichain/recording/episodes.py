"""The episodes of a log, found in its steps. Reads no file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.arrays import LogArrays

__all__ = ["LogEpisode", "find_episodes"]

Sampled = Mapping[int, tuple[NDArray[np.int64], NDArray[np.bool_]]]
"""Environment to sampled steps and whether each was a success."""


@dataclass(frozen=True, slots=True)
class LogEpisode:
    """One episode of one environment, as far as it is in the log.

    Attributes:
        env: The environment.
        episode: Its episode id, from 0 within the environment.
        first_step: Its first control step in the log.
        last_step: Its last control step in the log, included.
        total_reward: Sum of rewards over them, undiscounted.
        terminated: Whether it ended by itself.
        truncated: Whether it ended by a limit. Neither: the log ended first.
        success: Whether its last step was one; None where the log does not say. Only viewed
            environments say, when that step was sampled (`record.view_hz`).
    """

    env: int
    episode: int
    first_step: int
    last_step: int
    total_reward: float
    terminated: bool
    truncated: bool
    success: bool | None = None

    @property
    def steps(self) -> int:
        """Control steps."""
        return self.last_step - self.first_step + 1


def find_episodes(data: LogArrays, success: Sampled) -> list[LogEpisode]:
    """Episodes by environment, then in time.

    Args:
        data: `episodes`, `rewards`, `terminated` and `truncated` of all steps.
        success: Where it is known.
    """
    found: list[LogEpisode] = []
    for column, env in enumerate(data.env_ids.tolist()):
        ids = data["episodes"][:, column]
        if not len(ids):
            continue
        starts = np.concatenate([[0], np.flatnonzero(np.diff(ids)) + 1])
        ends = np.concatenate([starts[1:], [len(ids)]]) - 1
        known = success.get(env)
        for first, last in zip(starts.tolist(), ends.tolist(), strict=True):
            step = int(data.steps[last])
            found.append(
                LogEpisode(
                    env,
                    int(ids[first]),
                    int(data.steps[first]),
                    step,
                    float(np.add.accumulate(data["rewards"][first : last + 1, column])[-1]),
                    bool(data["terminated"][last, column]),
                    bool(data["truncated"][last, column]),
                    None if known is None else _at(known, step),
                )
            )
    return found


def _at(known: tuple[NDArray[np.int64], NDArray[np.bool_]], step: int) -> bool | None:
    steps, values = known
    at = int(np.searchsorted(steps, step))
    return bool(values[at]) if at < len(steps) and steps[at] == step else None
