"""The episodes of a log, found in its steps. Reads no file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from embodichain.recording.arrays import LogArrays
from embodichain.recording.episode_ends import EndedEpisode
from embodichain.utils.errors import ConfigError

__all__ = ["Ended", "LogEpisode", "episode_of", "find_episodes", "of_ended", "with_unrecorded"]

Ended = Mapping[tuple[int, int], EndedEpisode]
"""Environment and episode id to what `/episode` tells."""


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
        success: Whether its last step was one; None where the log does not say: the task has no
            notion of it, or the log ended first.
        reasons: What ended it: termination terms that fired, `success`, `fail`, `diverged`; empty
            where time ran out or the log ended first.
        rewards: Term to its sum over the episode, weighted; empty where the log ended first.
        metrics: Metric to its value at the episode's end; empty where the log ended first.
    """

    env: int
    episode: int
    first_step: int
    last_step: int
    total_reward: float
    terminated: bool
    truncated: bool
    success: bool | None = None
    reasons: tuple[str, ...] = ()
    rewards: Mapping[str, float] = field(default_factory=dict)
    metrics: Mapping[str, float] = field(default_factory=dict)

    @property
    def steps(self) -> int:
        """Control steps."""
        return self.last_step - self.first_step + 1


def episode_of(episodes: Sequence[LogEpisode], env: int, episode: int) -> LogEpisode:
    """The episode with an id of an environment.

    Raises:
        ConfigError: If there is none.
    """
    mine = {e.episode: e for e in episodes if e.env == env}
    if episode not in mine:
        there = f"there are {min(mine)} to {max(mine)}" if mine else "there is none"
        raise ConfigError(f"no episode {episode} of environment {env} in the log: {there}")
    return mine[episode]


def find_episodes(data: LogArrays, ended: Ended) -> list[LogEpisode]:
    """Episodes by environment, then in time.

    Args:
        data: `episodes`, `rewards`, `terminated` and `truncated` of all steps.
        ended: What is known of those that ended.
    """
    found: list[LogEpisode] = []
    for column, env in enumerate(data.env_ids.tolist()):
        ids = data["episodes"][:, column]
        if not len(ids):
            continue
        starts = np.concatenate([[0], np.flatnonzero(np.diff(ids)) + 1])
        ends = np.concatenate([starts[1:], [len(ids)]]) - 1
        for first, last in zip(starts.tolist(), ends.tolist(), strict=True):
            known = ended.get((env, int(ids[first])))
            found.append(
                LogEpisode(
                    env,
                    int(ids[first]),
                    int(data.steps[first]),
                    int(data.steps[last]),
                    float(np.add.accumulate(data["rewards"][first : last + 1, column])[-1]),
                    bool(data["terminated"][last, column]),
                    bool(data["truncated"][last, column]),
                    *_told(known),
                )
            )
    return found


def of_ended(ended: Ended) -> list[LogEpisode]:
    """Episodes of a log without steps, by environment: those that ended."""
    return [
        LogEpisode(
            end.env,
            end.episode,
            end.step - end.steps + 1,
            end.step,
            end.total_reward,
            end.terminated,
            end.truncated,
            *_told(end),
        )
        for _, end in sorted(ended.items())
    ]


def with_unrecorded(found: list[LogEpisode], ended: Ended) -> list[LogEpisode]:
    """Every episode of a log that holds only some of them (`record.every`), by environment.

    Args:
        found: What its steps tell: of episodes that were recorded in part, that part.
        ended: What is known of those that ended; this is of the whole episode.
    """
    whole = of_ended(ended)
    rest = {(e.env, e.episode): e for e in found if (e.env, e.episode) not in ended}
    return sorted([*whole, *rest.values()], key=lambda e: (e.env, e.episode))


def _told(
    end: EndedEpisode | None,
) -> tuple[bool | None, tuple[str, ...], Mapping[str, float], Mapping[str, float]]:
    return (end.success, end.reasons, end.rewards, end.metrics) if end else (None, (), {}, {})
