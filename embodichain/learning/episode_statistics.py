"""Statistics of the first episodes of each environment in a batch: returns, lengths, successes.

Imports neither torch nor Stable-Baselines3.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from embodichain.lab.gym.failures import failures_of
from embodichain.lab.gym.policies import PlannedPolicy

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.policies import Policy

__all__ = ["EpisodeStatistics", "as_array", "play"]

Flags = NDArray[np.bool_]


class EpisodeStatistics:
    """Counts the finished episodes of N environments.

    Args:
        num_envs: N.
        quota: Episodes that count for each environment, one number or (N,); later ones are
            ignored, so that environments with short episodes do not weigh more.
    """

    def __init__(self, num_envs: int, quota: ArrayLike) -> None:
        self.num_envs = num_envs
        self.quota = np.broadcast_to(np.asarray(quota, np.int64), (num_envs,))
        """(N,) episodes that count."""
        self.wanted = int(self.quota.sum())
        """Sum of the quotas."""
        self.counts = np.zeros(num_envs, np.int64)
        """(N,) episodes finished and counted."""
        self.steps = 0
        """Control steps of the batch."""
        self._return = np.zeros(num_envs)
        self._length = np.zeros(num_envs, np.int64)
        self._missing = self.wanted
        self._records: list[dict[str, NDArray[Any]]] = []

    @property
    def complete(self) -> bool:
        """Whether every environment has finished its quota."""
        return self._missing == 0

    @property
    def episodes(self) -> int:
        """Episodes counted so far, over all environments."""
        return self.wanted - self._missing

    def add(self, reward: NDArray[Any], done: Flags, values: Mapping[str, NDArray[Any]]) -> None:
        """Count one control step.

        Args:
            reward: (N,) rewards of the step.
            done: (N,) whether the episode ended in this step.
            values: Name -> (N,) values to keep of episodes that end in this step.
        """
        self.steps += 1
        self._return += reward
        self._length += 1
        if done.any():
            self._finish(done, values)

    def _finish(self, done: Flags, values: Mapping[str, NDArray[Any]]) -> None:
        ids = np.flatnonzero(done & (self.counts < self.quota))
        if ids.size:
            record = {name: np.asarray(value)[ids] for name, value in values.items()}
            record["env"] = ids
            record["episode"] = self.counts[ids]
            record["return"] = self._return[ids]
            record["length"] = self._length[ids]
            record["step"] = np.full(ids.size, self.steps)
            self._records.append(record)
            self.counts[ids] += 1
            self._missing -= ids.size
        self._return[done] = 0.0
        self._length[done] = 0

    # -- parts of a batch ------------------------------------------------------------------------

    def part(self, rows: slice) -> dict[str, Any]:
        """Return the state of some adjacent environments, for `load_state_dict` where they run."""
        return {
            "quota": self.quota[rows].copy(),
            "counts": self.counts[rows].copy(),
            "return": self._return[rows].copy(),
            "length": self._length[rows].copy(),
            "steps": self.steps,
        }

    def state_dict(self) -> dict[str, Any]:
        """Return copies of the state of all environments, without values of counted episodes."""
        return self.part(slice(None))

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where `state_dict` or `part` was taken."""
        self.counts[:] = state["counts"]
        self.steps = state["steps"]
        self._return[:] = state["return"]
        self._length[:] = state["length"]
        self._missing = int((self.quota - self.counts).sum())

    def take(self) -> list[dict[str, NDArray[Any]]]:
        """Return the values of counted episodes, and forget them: name -> one for each."""
        records = self._records
        self._records = []
        return records

    def merge(self, parts: Sequence[tuple[int, Sequence[Mapping[str, NDArray[Any]]]]]) -> None:
        """Add episodes that were counted in parts of the batch, in the order of their ends.

        Args:
            parts: The first environment of each part, and what `take` returned there.
        """
        records_by_step: dict[int, list[dict[str, NDArray[Any]]]] = {}
        for first, records in parts:
            for record in records:
                step = int(record["step"][0])  # one for all episodes of a record
                in_batch = {**record, "env": record["env"] + first}
                records_by_step.setdefault(step, []).append(in_batch)
        for step in sorted(records_by_step):
            same_step = records_by_step[step]
            joined = {
                name: np.concatenate([record[name] for record in same_step])
                for name in same_step[0]
            }
            self._records.append(joined)
            np.add.at(self.counts, joined["env"], 1)
            self._missing -= len(joined["env"])

    def column(self, name: str) -> NDArray[Any]:
        """(E,) one value per counted episode, in the order of their ends."""
        columns = [record[name] for record in self._records if name in record]
        if not columns:
            return np.zeros(0)
        return np.concatenate(columns)

    def names(self) -> list[str]:
        """Return the names that `column` accepts."""
        names: dict[str, None] = {}
        for record in self._records:
            names |= dict.fromkeys(record)
        return list(names)

    def mean(self, name: str) -> float | None:
        """Mean over the counted episodes; None before the first."""
        column = self.column(name)
        if not column.size:
            return None
        return float(column.mean())


def play(env: BaseEnv, policy: Policy, obs: Any, counted: EpisodeStatistics) -> Iterator[None]:
    """Step a batch until every environment has finished its quota; yields after each control step.

    Episodes of a `PlannedPolicy` have the value `failure`: why an episode failed, or "".

    Args:
        env: A batched environment that was just reset and resets its environments itself.
        policy: The policy; it is reset for environments that begin a new episode.
        obs: The observation that the reset returned.
        counted: The statistics, updated in place.
    """
    has_success = env.judges_success
    while not counted.complete:
        obs, reward, terminated, truncated, info = env.step(policy(obs, env))
        is_terminated = as_array(terminated)
        done = is_terminated | as_array(truncated)
        if not done.any():
            counted.add(as_array(reward), done, {})
        else:
            values = _episode_values(info, is_terminated, has_success)
            if isinstance(policy, PlannedPolicy):
                values["failure"] = failures_of(env, policy, done, is_terminated, values)
            counted.add(as_array(reward), done, values)
            policy.reset(np.flatnonzero(done))
        yield


def _episode_values(
    info: Mapping[str, Any], terminated: Flags, has_success: bool
) -> dict[str, NDArray[Any]]:
    """Return the values to count of episodes that end in a step: name -> (N,).

    Args:
        info: The info of the step, from before an automatic reset.
        terminated: (N,) whether each environment terminated.
        has_success: `BaseEnv.judges_success` of the task.
    """
    values: dict[str, NDArray[Any]] = {
        "terminated": terminated,
        "diverged": as_array(info["diverged"]),
    }
    if has_success:
        values["success"] = as_array(info["success"])
    for name, value in info["metrics"].items():
        values[f"metrics/{name}"] = as_array(value)
    for name, value in info["episode_sums"].items():
        values[f"rewards/{name}"] = as_array(value)
    return values


def as_array(value: Any) -> NDArray[Any]:
    """Return a tensor of an environment as a numpy array."""
    return value.numpy(force=True)
