"""Messages about episodes: `embodichain.Episodes`, how they ended, and `embodichain.Counted`.

The channel `/episode` has one message for each control step in which episodes of any environment
ended: returns, sums of each reward term, metrics, the reasons, and what was drawn for them. The
channel `/counted` lists the episodes that make up the results of a `collect`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.observers import StepRecord
from embodichain.recording.format.draws import Drawn
from embodichain.recording.format.messages.schema import message_class

__all__ = [
    "COUNTED_TOPIC",
    "EPISODE_TOPIC",
    "Ends",
    "EpisodeSums",
    "encode_counted",
    "encode_ends",
]

COUNTED_TOPIC = "/counted"
EPISODE_TOPIC = "/episode"
_OUTCOMES = {"success": "success_terminated", "fail": "fail", "diverged": "diverged"}
"""Reason of an end -> the entry of ``info`` that says so."""


class Table(NamedTuple):
    """K named values of each of n episodes.

    Attributes:
        names: The K names.
        values: (n, K).
    """

    names: list[str]
    values: NDArray[Any]


@dataclass(frozen=True, slots=True)
class Ends:
    """Episodes that end in a control step, as copies.

    Attributes:
        env_ids: (n,) environments.
        terminated: (n,) bool.
        truncated: (n,) bool.
        success: (n,) bool; None if the task does not define it.
        reasons: Termination terms that fired, success, fail, diverged: (n, K) bool.
        rewards: Weighted sums over the episode by reward term: (n, K).
        metrics: Metrics at the episode's end: (n, K).
        drawn: What was drawn for the episodes.
    """

    env_ids: NDArray[np.int64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    success: NDArray[np.bool_] | None
    reasons: Table
    rewards: Table
    metrics: Table
    drawn: Drawn

    @classmethod
    def of(
        cls,
        step: StepRecord,
        terms: Mapping[str, Any],
        *,
        judged: bool,
        draws: Callable[[NDArray[np.int64]], Drawn] | None = None,
    ) -> Ends | None:
        """The ends of a step; None if no episode ends in it.

        Args:
            step: The step.
            terms: Termination term to its (N,) values in this step.
            judged: Whether the task defines success.
            draws: Called with (n,) environments, returns what was drawn for the episodes that end
                in them; None if that is not known.
        """
        env_ids = np.flatnonzero(step.terminated | step.truncated)
        if not len(env_ids):
            return None
        info = step.info
        success = None
        if judged and info.get("success") is not None:
            success = np.asarray(info["success"])[env_ids] != 0
        reasons = dict(terms)
        for reason, key in _OUTCOMES.items():
            if key in info:
                reasons[reason] = info[key]
        return cls(
            env_ids=env_ids,
            terminated=step.terminated[env_ids],
            truncated=step.truncated[env_ids],
            success=success,
            reasons=_table(reasons, env_ids, np.bool_),
            rewards=_table(info.get("episode_sums", {}), env_ids, np.float64),
            metrics=_table(info.get("metrics", {}), env_ids, np.float64),
            drawn=Drawn.none(len(env_ids)) if draws is None else draws(env_ids),
        )


def _table(values: Mapping[str, Any], env_ids: NDArray[np.int64], dtype: Any) -> Table:
    """The values of some environments, of (N,) values by name."""
    columns = np.empty((len(env_ids), len(values)), dtype)
    for index, value in enumerate(values.values()):
        columns[:, index] = np.asarray(value)[env_ids]
    return Table(list(values), columns)


class EpisodeSums:
    """Returns and lengths of the episodes in progress, of all environments.

    Args:
        num_envs: Number of environments N.
    """

    def __init__(self, num_envs: int) -> None:
        self._episodes = np.full(num_envs, -1, np.int64)
        self.returns = np.zeros(num_envs)
        """(N,) sums of rewards, in the order of the steps."""
        self.lengths = np.zeros(num_envs, np.int64)
        """(N,) numbers of control steps."""

    @property
    def episodes(self) -> NDArray[np.int64]:
        """(N,) the episodes of the last step; -1 before the first."""
        return self._episodes

    def load(
        self, episodes: NDArray[np.int64], returns: NDArray[Any], lengths: NDArray[np.int64]
    ) -> None:
        """Continue with these episodes, sums and numbers, (N,) each."""
        self._episodes = episodes.copy()
        self.returns[:] = returns
        self.lengths[:] = lengths

    def add(self, reward: NDArray[Any], episode_ids: NDArray[np.int64]) -> None:
        """Add a control step: (N,) rewards, and the episodes it belongs to."""
        self.add_steps(reward[None], episode_ids)

    def add_steps(self, rewards: NDArray[Any], episode_ids: NDArray[np.int64]) -> None:
        """Add S control steps: (S, N) rewards, and the (N,) episodes that all of them belong to."""
        is_new = self._episodes != episode_ids
        if is_new.any():
            self.returns[is_new] = 0
            self.lengths[is_new] = 0
            self._episodes = episode_ids.copy()
        # One step after the other, as if each had been added alone: `sum` may add in pairs.
        sums = np.concatenate([self.returns[None], rewards])
        self.returns[:] = np.add.accumulate(sums)[-1]
        self.lengths += len(rewards)


def encode_ends(step: int, ends: Ends, sums: EpisodeSums, episode_ids: NDArray[np.int64]) -> bytes:
    """The message of `EPISODE_TOPIC` for episodes that ended in a control step.

    Args:
        step: The control step.
        ends: The episodes that ended.
        sums: Returns and lengths, including this step.
        episode_ids: (N,) episodes of this step.
    """
    ids = ends.env_ids
    message = message_class("Episodes")(
        step=step,
        env_ids=ids.tolist(),
        episode_id=episode_ids[ids].tolist(),
        length=sums.lengths[ids].tolist(),
        total_reward=sums.returns[ids].tolist(),
        terminated=ends.terminated.tobytes(),
        truncated=ends.truncated.tobytes(),
        success=b"" if ends.success is None else ends.success.tobytes(),
        reason=ends.reasons.names,
        reasons=ends.reasons.values.tobytes(),
        reward_term=ends.rewards.names,
        reward_sums=ends.rewards.values.ravel().tolist(),
        metric=ends.metrics.names,
        metrics=ends.metrics.values.ravel().tolist(),
        draw=ends.drawn.names,
        draw_width=ends.drawn.widths,
        drawn=ends.drawn.values.ravel().tolist(),
        was_drawn=ends.drawn.was_made.tobytes(),
    )
    data: bytes = message.SerializeToString()
    return data


def encode_counted(env_ids: Sequence[int], episodes: Sequence[int]) -> bytes:
    """The message of `COUNTED_TOPIC` for episodes that count.

    Args:
        env_ids: The environment of each.
        episodes: The id of each within its environment.
    """
    message = message_class("Counted")(env_ids=env_ids, episode_id=episodes)
    data: bytes = message.SerializeToString()
    return data
