"""The episodes of a log: from the channel `/episode`, and from the recorded steps."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from embodichain.recording.format.log_error import DamageError
from embodichain.recording.format.messages.schema import message_class
from embodichain.recording.read.arrays import LogArrays
from embodichain.utils.errors import ConfigError

__all__ = [
    "LogEpisode",
    "decode_ends",
    "episode_of",
    "find_episodes",
]


@dataclass(frozen=True, slots=True)
class LogEpisode:
    """One episode of one environment, possibly only the part that is in the log.

    Attributes:
        env: The environment.
        episode: Its episode id, from 0 within the environment.
        first_step: Its first control step in the log.
        last_step: Its last control step in the log, included.
        total_reward: Undiscounted sum of rewards over these steps.
        terminated: As in Gymnasium.
        truncated: As in Gymnasium. Both are False if the log ended first.
        success: Whether its last step was a success: by the metric `success` (above 0) of a task
            that has one, else by a termination of kind success; None if the task does not define
            it, or the log ended first.
        reasons: What ended it: termination terms that fired, `success`, `fail`, `diverged`; empty
            if it reached the time limit or the log ended first.
        rewards: Term to its weighted sum over the episode; empty if the log ended first.
        metrics: Metric to its value at the episode's end; empty if the log ended first.
        drawn: What was drawn when it began: ``TERM.NAME`` to the numbers of the last time that an
            event of mode `reset` or `startup` acted on the environment, and
            ``observations.TERM.delay`` and ``actions.TERM.delay`` where a delay is drawn; empty if
            the log ended first, or an older version wrote it.
        counted: Whether it is part of the run's results: `run` and `eval` count the first episodes
            of each environment, `collect` those that it lists as success or failure; None if the
            log does not say, as one of a user's program or of an older version.
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
    drawn: Mapping[str, list[float]] = field(default_factory=dict)
    counted: bool | None = None

    @property
    def steps(self) -> int:
        """Number of control steps."""
        return self.last_step - self.first_step + 1


def decode_ends(data: bytes | memoryview) -> list[LogEpisode]:
    """Read a message of `EPISODE_TOPIC`: the episodes that ended in its control step.

    Raises:
        DamageError: If the message is damaged.
    """
    message = message_class("Episodes")()
    try:
        message.ParseFromString(bytes(data))
    except DecodeError as error:
        raise DamageError(f"an end of episodes is damaged: {error}") from error
    count = len(message.env_ids)
    terminated = _flags(message.terminated)
    truncated = _flags(message.truncated)
    reasons = _rows(message.reason, _flags(message.reasons), count)
    rewards = _rows(message.reward_term, message.reward_sums, count)
    metrics = _rows(message.metric, message.metrics, count)
    drawn = _draws(message, count)
    success: list[bool | None] = [None] * count
    if message.success:
        success = list(_flags(message.success))
    if "success" in message.metric:  # logs of older versions have the termination in `success`
        success = [row["success"] > 0 for row in metrics]
    columns = (
        message.episode_id,
        message.length,
        message.total_reward,
        terminated,
        truncated,
        success,
    )
    if any(len(column) != count for column in columns):
        raise DamageError("an end of episodes lacks some of them")
    return [
        LogEpisode(
            env=message.env_ids[i],
            episode=message.episode_id[i],
            first_step=message.step - message.length[i] + 1,
            last_step=message.step,
            total_reward=message.total_reward[i],
            terminated=terminated[i],
            truncated=truncated[i],
            success=success[i],
            reasons=tuple(name for name, ended_it in reasons[i].items() if ended_it),
            rewards=rewards[i],
            metrics=metrics[i],
            drawn=drawn[i],
        )
        for i in range(count)
    ]


def _flags(data: bytes) -> list[bool]:
    return [byte != 0 for byte in data]


def _rows(names: Sequence[str], values: Sequence[Any], count: int) -> list[dict[str, Any]]:
    """Name to value for each of some episodes; `values` is (count, names), row-major."""
    width = len(names)
    if len(values) != count * width:
        raise DamageError(f"{len(values)} values of {width} names in {count} episodes")
    rows = []
    for index in range(count):
        row = values[index * width : (index + 1) * width]
        rows.append(dict(zip(names, row, strict=True)))
    return rows


def _draws(message: Any, count: int) -> list[dict[str, list[float]]]:
    """What was drawn for each of some episodes: name to its numbers."""
    names = message.draw
    widths = message.draw_width
    values = message.drawn
    was_drawn = message.was_drawn
    total = sum(widths)
    if (
        len(widths) != len(names)
        or len(values) != count * total
        or len(was_drawn) != count * len(names)
    ):
        raise DamageError(f"{len(values)} numbers of {len(names)} draws in {count} episodes")
    rows: list[dict[str, list[float]]] = []
    start = 0
    for index in range(count):
        row: dict[str, list[float]] = {}
        flags = was_drawn[index * len(names) : (index + 1) * len(names)]
        for name, width, flag in zip(names, widths, flags, strict=True):
            if flag:
                row[name] = list(values[start : start + width])
            start += width
        rows.append(row)
    return rows


def episode_of(episodes: Sequence[LogEpisode], env: int, episode: int) -> LogEpisode:
    """The episode of an environment with this id.

    Raises:
        ConfigError: If there is none.
    """
    by_id = {e.episode: e for e in episodes if e.env == env}
    if episode not in by_id:
        available = "there is none"
        if by_id:
            available = f"there are {min(by_id)} to {max(by_id)}"
        raise ConfigError(f"no episode {episode} of environment {env} in the log: {available}")
    return by_id[episode]


def find_episodes(
    ends: Iterable[LogEpisode], data: LogArrays | None, every: int = 1
) -> list[LogEpisode]:
    """Episodes, sorted by environment, then by time.

    Args:
        ends: Episodes that ended.
        data: `episodes`, `rewards`, `terminated` and `truncated` of all recorded steps; None for
            a log without steps.
        every: k if only every k-th episode was recorded; the others are listed too.
    """
    ended: dict[tuple[int, int], LogEpisode] = {}  # by environment and episode
    for end in ends:
        ended.setdefault((end.env, end.episode), end)
    episodes: dict[tuple[int, int], LogEpisode] = {}
    if data is not None:
        for episode in _in_steps(data, ended):
            episodes[episode.env, episode.episode] = episode
    if data is None or every > 1:
        episodes |= ended
    return [episodes[key] for key in sorted(episodes)]


def _in_steps(data: LogArrays, ended: Mapping[tuple[int, int], LogEpisode]) -> Iterator[LogEpisode]:
    """The episodes of recorded steps, complete or not."""
    for column, env in enumerate(data.env_ids.tolist()):
        ids = data["episodes"][:, column]
        if not len(ids):
            continue
        starts = np.concatenate([[0], np.flatnonzero(np.diff(ids)) + 1])
        lasts = np.concatenate([starts[1:], [len(ids)]]) - 1
        is_done = data["terminated"][:, column] | data["truncated"][:, column]
        for first, last in zip(starts.tolist(), lasts.tolist(), strict=True):
            last = _end_of_episode(is_done, first, last)
            rewards = data["rewards"][first : last + 1, column]
            episode = LogEpisode(
                env=env,
                episode=int(ids[first]),
                first_step=int(data.steps[first]),
                last_step=int(data.steps[last]),
                # Step after step, as the recorder added them: `sum` rounds otherwise.
                total_reward=float(np.add.accumulate(rewards)[-1]),
                terminated=bool(data["terminated"][last, column]),
                truncated=bool(data["truncated"][last, column]),
            )
            end = ended.get((env, episode.episode))
            if end is not None:
                episode = replace(
                    episode,
                    success=end.success,
                    reasons=end.reasons,
                    rewards=end.rewards,
                    metrics=end.metrics,
                    drawn=end.drawn,
                )
            yield episode


def _end_of_episode(is_done: NDArray[np.bool_], first: int, last: int) -> int:
    """The row in which an episode ended, else its last row.

    With Gymnasium's NEXT_STEP an environment is reset in the step after the end. That step has the
    number of the episode, no reward, and is not a part of it.

    Args:
        is_done: (S,) whether the environment was done after each recorded step.
        first: The episode's first row.
        last: The last row with its number.
    """
    if is_done[last]:
        return last
    ends = np.flatnonzero(is_done[first:last])
    return first + int(ends[0]) if len(ends) else last
