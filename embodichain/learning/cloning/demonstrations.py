"""`Demonstrations`: recorded episodes as a learner sees them; they may fill a replay buffer."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.vec_env import VecNormalize

from embodichain.learning.sb3.normalization import number_keys
from embodichain.learning.sb3.vec_env import SB3VecEnv
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["Demonstration", "Demonstrations", "fill", "learn_scales"]

F32 = NDArray[np.float32]
Entries = dict[str, NDArray[Any]]
"""Name of an entry -> values; an observation that is one array has the name ""."""


class Demonstration(Protocol):
    """One recorded episode of T control steps."""

    @property
    def observations(self) -> Mapping[str, NDArray[Any]]:
        """Entries of the task's observation by name, (T+1, ...), the final one included."""

    @property
    def actions(self) -> F32:
        """(T, A) actions in the task's units."""

    @property
    def rewards(self) -> F32:
        """(T,) rewards."""

    @property
    def terminated(self) -> bool:
        """Whether it ended in a terminal state."""


@dataclass(frozen=True, slots=True)
class Demonstrations:
    """E episodes of M control steps in total, as a learner in an `SB3VecEnv` sees them.

    Attributes:
        observations: Entry -> (M+E, ...), not normalized; each episode has one more than steps.
        actions: (M, A) in [-1, 1].
        rewards: (M,).
        lengths: (E,) control steps of each episode.
        terminated: (E,) whether the episode ended in a terminal state.
    """

    observations: Entries
    actions: F32
    rewards: F32
    lengths: NDArray[np.int64]
    terminated: NDArray[np.bool_]

    @classmethod
    def of(cls, episodes: Iterable[Demonstration], env: SB3VecEnv) -> Demonstrations:
        """Convert recorded episodes.

        Args:
            episodes: The episodes, read once.
            env: The environment that will be learned in.

        Raises:
            ConfigError: If there is no episode, or its observations or actions are not the task's.
        """
        observations: list[Entries] = []
        actions: list[F32] = []
        rewards: list[F32] = []
        terminated: list[bool] = []
        for episode in episodes:
            try:
                observations.append(env.recorded_view(episode.observations))
                actions.append(env.recorded_actions(episode.actions))
            except ValueError as error:
                message = f"its episodes are not of this task: {error}"
                raise ConfigError([Problem("dataset", message)]) from error
            rewards.append(np.asarray(episode.rewards, np.float32))
            terminated.append(bool(episode.terminated))
        if not observations:
            raise ConfigError([Problem("dataset", "it has no successful episode")])
        return cls(
            observations={
                key: np.concatenate([entries[key] for entries in observations])
                for key in observations[0]
            },
            actions=np.concatenate(actions),
            rewards=np.concatenate(rewards),
            lengths=np.array([len(episode_actions) for episode_actions in actions], np.int64),
            terminated=np.array(terminated, np.bool_),
        )

    @property
    def steps(self) -> int:
        """M."""
        return len(self.actions)

    @property
    def before(self) -> NDArray[np.int64]:
        """(M,) row in `observations` of the observation before each step; the next is after it."""
        return np.arange(self.steps) + self.episode

    @property
    def episode(self) -> NDArray[np.int64]:
        """(M,) the episode of each step."""
        return np.repeat(np.arange(len(self.lengths)), self.lengths)

    def rows(self, numbers: NDArray[np.int64]) -> Any:
        """Rows of the observations: an array (n, ...), or a dict of them."""
        if "" in self.observations:
            return self.observations[""][numbers]
        return {key: entry[numbers] for key, entry in self.observations.items()}

    @property
    def checksum(self) -> int:
        """A number that other demonstrations do not have."""
        return zlib.crc32(np.ascontiguousarray(self.actions).tobytes())


def learn_scales(normalizer: VecNormalize, found: Demonstrations, *, rewards: bool) -> None:
    """Add demonstrations to the running statistics of a normalizer.

    Args:
        normalizer: Its observations are those of `found`.
        found: The demonstrations.
        rewards: Whether to add their discounted returns too, whose variance scales rewards.
    """
    if normalizer.norm_obs:
        scales: Any = normalizer.obs_rms
        for key in number_keys(normalizer.observation_space):
            entry_scales = scales[key] if isinstance(scales, dict) else scales
            entry_scales.update(np.asarray(found.observations[key], np.float64))
    if rewards and normalizer.norm_reward:
        normalizer.ret_rms.update(_returns(found, normalizer.gamma))


def _returns(demonstrations: Demonstrations, gamma: float) -> NDArray[np.float64]:
    """(M,) the discounted sum of the rewards up to each step, as `VecNormalize` counts them."""
    lengths = demonstrations.lengths
    returns = np.zeros(demonstrations.steps)
    starts = np.cumsum(lengths) - lengths
    running = np.zeros(len(starts))
    for t in range(int(lengths.max())):
        is_running = t < lengths
        rows = starts[is_running] + t
        running[is_running] = running[is_running] * gamma + demonstrations.rewards[rows]
        returns[rows] = running[is_running]
    return returns


def fill(buffer: ReplayBuffer, found: Demonstrations) -> int:
    """Put every transition of demonstrations into an empty replay buffer.

    A buffer has a column for each environment. Episodes are cut into columns of equal length; where
    an episode is cut, the transition is marked as truncated, which changes no target of one step
    and ends the sums of n-step returns. The last column is filled up with its first transitions
    again, if M is not a multiple of the number of columns.

    Args:
        buffer: The buffer of a model that has not learned yet.
        found: The demonstrations.

    Returns:
        The number of transitions added.

    Raises:
        ConfigError: If they do not fit into the buffer.
    """
    columns = buffer.n_envs
    rows = -(-found.steps // columns)
    if rows > buffer.buffer_size:
        room = buffer.buffer_size * columns
        message = f"has room for {room:,} transitions, the data set has {found.steps:,}"
        raise ConfigError([Problem("algo.buffer_size", message)])
    # (columns, rows): each column has `rows` steps, one after the other.
    steps = (np.arange(rows * columns) % found.steps).reshape(columns, rows)
    is_last = np.zeros(found.steps, np.bool_)
    is_last[np.cumsum(found.lengths) - 1] = True
    dones = is_last[steps]
    timeouts = dones & ~found.terminated[found.episode[steps]]
    # The end of a column cuts an episode that goes on in the next one.
    timeouts[:, -1] |= ~dones[:, -1]
    dones[:, -1] = True
    before = found.before[steps]
    for row in range(rows):
        buffer.add(
            obs=found.rows(before[:, row]),
            next_obs=found.rows(before[:, row] + 1),
            action=found.actions[steps[:, row]],
            reward=found.rewards[steps[:, row]],
            done=dones[:, row],
            infos=[{"TimeLimit.truncated": bool(is_cut)} for is_cut in timeouts[:, row]],
        )
    return steps.size
