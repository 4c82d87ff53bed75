"""The channel `/episode`: how the episodes of every environment ended, viewed or not.

One message for each control step in which episodes ended. Rewards of single steps are in
`/sim/step`; the sums by term, metrics and reasons are here, because they cost next to nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.observers import StepRecord
from embodichain.recording import wire
from embodichain.recording.mcap_file import Part

__all__ = ["TOPIC", "EndedEpisode", "Ends", "EpisodeLog", "by_episode", "decode_ends"]

TOPIC = "/episode"
_OUTCOMES = ("success", "fail", "diverged")

Table = tuple[list[str], NDArray[Any]]
"""Names, and a column for each: (n, K)."""


@dataclass(frozen=True, slots=True)
class Ends:
    """What is known of episodes that end in a step, taken out of what may change afterwards.

    Attributes:
        env_ids: (n,) environments.
        terminated: (n,) bool.
        truncated: (n,) bool.
        success: (n,) bool; None where the task does not say.
        reasons: Termination terms that fired, success, fail, diverged: (n, K) bool.
        rewards: Sums of the episode by term, weighted: (n, K).
        metrics: (n, K).
    """

    env_ids: NDArray[np.int64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    success: NDArray[np.bool_] | None
    reasons: Table
    rewards: Table
    metrics: Table

    @classmethod
    def of(cls, step: StepRecord, terms: Mapping[str, Any]) -> Ends | None:
        """Of a step; None if no episode ends in it.

        Args:
            step: The step.
            terms: Termination term to its (N,) values in this step.
        """
        # A search in bytes: a tenth of the time of `any`, in every step.
        if 1 not in step.terminated.tobytes() and 1 not in step.truncated.tobytes():
            return None
        ids, info = np.flatnonzero(step.terminated | step.truncated), step.info
        success = info.get("success")
        reasons = {**terms, **{name: info[name] for name in _OUTCOMES if name in info}}
        return cls(
            ids,
            step.terminated[ids],
            step.truncated[ids],
            None if success is None else np.asarray(success)[ids] != 0,
            _table(reasons, ids, np.bool_),
            _table(info.get("episode_sums", {}), ids, np.float64),
            _table(info.get("metrics", {}), ids, np.float64),
        )


def _table(values: Mapping[str, Any], ids: NDArray[np.int64], dtype: Any) -> Table:
    found = np.empty((len(ids), len(values)), dtype)
    for column, value in enumerate(values.values()):
        found[:, column] = np.asarray(value)[ids]
    return list(values), found


class EpisodeLog:
    """Adds up rewards, and encodes what ends; where the log is written.

    Args:
        num_envs: N.
    """

    def __init__(self, num_envs: int) -> None:
        self._episodes = np.full(num_envs, -1, np.int64)
        self._known = self._episodes.tobytes()
        self._sums = np.zeros(num_envs)
        self._lengths = np.zeros(num_envs, np.int64)

    def add(
        self, step: int, reward: NDArray[Any], episode_ids: NDArray[np.int64], ends: Ends | None
    ) -> tuple[Part, ...] | None:
        """Take a step in; the message, if an episode ends in it."""
        if episode_ids.tobytes() != self._known:  # a comparison of bytes is cheap to start
            self._known = episode_ids.tobytes()
            new = self._episodes != episode_ids
            self._sums[new] = self._lengths[new] = 0
            self._episodes = episode_ids.copy()
        self._sums += reward
        self._lengths += 1
        if ends is None:
            return None
        ids = ends.env_ids
        message = (
            wire.uint(1, step) + wire.array(2, ids, "<u4") + wire.array(3, episode_ids[ids], "<i8"),
            wire.array(4, self._lengths[ids], "<u4") + wire.array(5, self._sums[ids], "<f8"),
            wire.text(6, ends.terminated.tobytes()) + wire.text(7, ends.truncated.tobytes()),
            b"" if ends.success is None else wire.text(8, ends.success.tobytes()),
            _encode_table(9, ends.reasons),
            _encode_table(11, ends.rewards),
            _encode_table(13, ends.metrics),
        )
        self._sums[ids] = self._lengths[ids] = 0
        return message

    def add_steps(self, rewards: NDArray[Any], episode_ids: NDArray[np.int64]) -> None:
        """Take steps in that end no episode, (K, N) of each."""
        if episode_ids.tobytes() != self._known * len(rewards):
            for reward, ids in zip(rewards, episode_ids, strict=True):
                self.add(0, reward, ids, None)
            return
        # Sums one after another, as `add` makes them: `np.sum` may go about it in another order.
        self._sums = np.add.accumulate(np.vstack([self._sums, rewards]))[-1]
        self._lengths += len(rewards)


def _encode_table(number: int, table: Table) -> bytes:
    names, values = table
    data = b"".join(wire.text(number, name) for name in names)
    return data + wire.text(number + 1, np.ascontiguousarray(values).tobytes())


@dataclass(frozen=True, slots=True)
class EndedEpisode:
    """An episode that ended, as `/episode` tells it.

    Attributes:
        step: Control step that ended it.
        env: The environment.
        episode: Its episode id.
        steps: Control steps of it that were seen.
        total_reward: Sum of rewards over them.
        terminated: Whether it ended by itself.
        truncated: Whether it ended by a limit.
        success: None where the task does not say.
        reasons: Termination terms that fired, `success`, `fail`, `diverged`; empty: time ran out.
        rewards: Term to its sum over the episode, weighted.
        metrics: Metric to its value at the end.
    """

    step: int
    env: int
    episode: int
    steps: int
    total_reward: float
    terminated: bool
    truncated: bool
    success: bool | None = None
    reasons: tuple[str, ...] = ()
    rewards: Mapping[str, float] = field(default_factory=dict)
    metrics: Mapping[str, float] = field(default_factory=dict)


def decode_ends(data: bytes | memoryview) -> list[EndedEpisode]:
    """Read a message of `/episode`.

    Raises:
        WireError: If the bytes are none.
    """
    f = wire.parse(data)
    step = f.get(1, [0])[-1]
    columns = [
        wire.unpack(f, number, dtype)
        for number, dtype in ((2, "<u4"), (3, "<i8"), (4, "<u4"), (5, "<f8"), (6, "?"), (7, "?"))
    ]
    n, success = len(columns[0]), wire.unpack(f, 8, "?")
    if not isinstance(step, int) or any(len(c) != n for c in columns):
        raise wire.WireError("an end of episodes lacks some of them")
    if len(success) not in (0, n):
        raise wire.WireError("an end of episodes lacks successes")
    fired, rewards, metrics = (
        _decode_table(f, number, n, dtype) for number, dtype in ((9, "?"), (11, "<f8"), (13, "<f8"))
    )
    found = []
    for i in range(n):
        env, episode, steps, total, terminated, truncated = (c[i].item() for c in columns)
        known = bool(success[i]) if len(success) else None
        why = tuple(name for name, value in fired[i].items() if value)
        flags = terminated, truncated, known
        found.append(
            EndedEpisode(step, env, episode, steps, total, *flags, why, rewards[i], metrics[i])
        )
    return found


def by_episode(messages: Iterable[list[EndedEpisode]]) -> dict[tuple[int, int], EndedEpisode]:
    """Environment and episode id to how the episode ended, first."""
    found: dict[tuple[int, int], EndedEpisode] = {}
    for ends in messages:
        for end in ends:
            found.setdefault((end.env, end.episode), end)
    return found


def _decode_table(fields: wire.Fields, number: int, n: int, dtype: str) -> list[dict[str, Any]]:
    names = list(_texts(fields.get(number, [])))
    values = wire.unpack(fields, number + 1, dtype)
    if len(values) != n * len(names):
        raise wire.WireError(f"{len(values)} values of {len(names)} names in {n} episodes")
    rows = values.reshape(n, len(names)).tolist()
    return [dict(zip(names, row, strict=True)) for row in rows]


def _texts(values: list[Any]) -> Iterator[str]:
    for value in values:
        try:
            yield bytes(value).decode()
        except (TypeError, UnicodeDecodeError) as error:
            raise wire.WireError(f"a name is not text: {error}") from error
