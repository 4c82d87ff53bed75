"""`TensorEnv`: a batched environment as learners of tensors read it, and what its episodes were.

Everything stays on the environment's device: nothing in a step is copied to the host, and no
decision depends on a value of a tensor.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from torch import Tensor

from embodichain.learning.sb3.vec_env import ENDS
from embodichain.learning.spaces import ActionScale, observation_box, require_torch_batch

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["GROUP", "EpisodeRecorder", "Groups", "TensorEnv", "TensorStep", "to_bounds"]

GROUP = "policy"
"""The observation group of the actor."""
_FLAGS = ("success", *filter(None, ENDS.values()))
"""Entries of the info that say how an episode ended."""
_TERMINATION = "Episode_Termination"

Groups = dict[str, Tensor]


@dataclass(frozen=True, slots=True)
class TensorStep:
    """The results of one control step of N environments.

    Attributes:
        groups: Observation group -> (N, K) float32; of the new episode where one ended.
        final: The same from before resets.
        reward: (N,) float32.
        terminated: (N,) bool episodes that ended by themselves.
        time_out: (N,) bool episodes that were cut off: truncated and not terminated.
        info: The environment's info.
    """

    groups: Groups
    final: Groups
    reward: Tensor
    terminated: Tensor
    time_out: Tensor
    info: dict[str, Any]

    @property
    def done(self) -> Tensor:
        """(N,) bool episodes that ended."""
        return self.terminated | self.time_out


class TensorEnv:
    """A batched environment with observation groups (N, K) and actions in [-1, 1], as tensors.

    Learners keep observations, rewards and flags until the next step has returned, so the
    environment must not overwrite them before. ``info`` is read at once.

    Args:
        env: A batched environment (wrapped or not) with ``autoreset_mode`` SAME_STEP.
        critic_groups: Observation groups of the critic; empty: `GROUP`, which the actor reads.
        action_scale: What learners' actions are multiplied by.

    Attributes:
        env: The environment.
        base: The environment without wrappers.
        num_envs: N.
        action_scale: What learners' actions are multiplied by.
        device: Where the tensors are.
        critic_groups: Observation groups of the critic.
        spaces: Observation group -> space of one environment, (K,).
        action_space: Actions of one environment, (A,) in [-1, 1].
        step_seconds: Wall time spent in `step` so far; of a GPU, until the work is queued.

    Raises:
        ConfigError: If a group is empty or has images, or the action space has no finite bounds.
        TypeError: If the environment is one of `gymnasium.make` or `make_vec` with numpy arrays.
        ValueError: If the environment does not reset in the same step.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        critic_groups: Iterable[str] = (),
        action_scale: float = 1.0,
    ) -> None:
        require_torch_batch(env, type(self).__name__)
        self.env = env
        self.base = cast("BaseEnv", env.unwrapped)
        self.num_envs = self.base.num_envs
        self.action_scale = action_scale
        self.device: torch.device = self.base.device
        self.critic_groups = tuple(critic_groups) or (GROUP,)
        self.spaces: dict[str, spaces.Box] = {
            group: observation_box(self.base, group)
            for group in dict.fromkeys((GROUP, *self.critic_groups))
        }
        self.action_space = ActionScale(self.base.single_action_space).space
        space: Any = self.base.single_action_space
        self.low = torch.as_tensor(space.low, dtype=torch.float32, device=self.device)
        """(A,) lower bounds of the task's actions."""
        self.high = torch.as_tensor(space.high, dtype=torch.float32, device=self.device)
        """(A,) upper bounds of the task's actions."""
        self.step_seconds = 0.0

    def reset(self, seed: int | None = None) -> Groups:
        """Reset every environment; return the observation groups, (N, K) each."""
        return self.groups(self.env.reset(seed=seed)[0])

    def groups(self, obs: Any) -> Groups:
        """Return the groups of an observation of the environment, (N, K) each."""
        flatten = self.base.observation_manager.flatten
        return {name: flatten(obs, name) for name in self.spaces}

    def step(self, actions: Tensor) -> TensorStep:
        """Step all environments.

        Args:
            actions: (N, A); times `action_scale`, they are clipped to [-1, 1] and scaled to the
                task's bounds.

        Raises:
            ValueError: If the shape is wrong, or on the CPU if an action is not finite.
        """
        start = time.perf_counter()
        scaled = to_bounds(actions * self.action_scale, self.low, self.high)
        obs, reward, terminated, truncated, info = self.env.step(scaled)
        groups = self.groups(obs)
        final = self.groups(info["final_obs"]) if "final_obs" in info else groups
        time_out = cast(Tensor, truncated) & ~cast(Tensor, terminated)
        self.step_seconds += time.perf_counter() - start
        return TensorStep(
            groups=groups,
            final=final,
            reward=cast(Tensor, reward),
            terminated=cast(Tensor, terminated),
            time_out=time_out,
            info=info,
        )


def to_bounds(actions: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Return actions (N, A), clipped to [-1, 1] and scaled to bounds (A,).

    Columns with infinite bounds stay as they are.
    """
    is_unbounded = torch.isinf(low)
    # Finite numbers in place of infinite ones, whose results are not used: 0 * inf is NaN.
    clipped = torch.where(is_unbounded, 0.0, actions).clamp(-1.0, 1.0)
    low = torch.where(is_unbounded, -1.0, low)
    high = torch.where(is_unbounded, 1.0, high)
    scaled = 0.5 * ((1.0 - clipped) * low + (1.0 + clipped) * high)
    return torch.where(is_unbounded, actions, scaled)


class EpisodeRecorder:
    """Keeps on the device what the episodes of a rollout were; one copy to the host at its end.

    Args:
        env: The environment.

    Attributes:
        returns: (N,) float32 sums of rewards of the current episodes.
    """

    def __init__(self, env: TensorEnv) -> None:
        self._base = env.base
        self.returns = torch.zeros(env.num_envs, device=env.device)
        self._names: list[str] = []
        self._rows: list[Tensor] = []

    def add(self, step: TensorStep) -> None:
        """Keep the numbers of one control step."""
        done = step.done
        returns = self.returns + step.reward
        values = {
            "done": done,
            "return": returns,
            "length": step.info["elapsed_steps"],
            **{name: step.info[name] for name in _FLAGS},
            **_add_prefix("Episode_Reward", step.info["episode_sums"]),
            **_add_prefix("Episode_Metrics", step.info["metrics"]),
            **_add_prefix(_TERMINATION, self._base.termination_manager.values),
        }
        self._names = list(values)
        self._rows.append(torch.stack([value.to(torch.float32) for value in values.values()]))
        self.returns = returns.masked_fill(done, 0.0)

    def finish(self) -> dict[str, NDArray[np.float32]]:
        """Return and forget the recorded episodes: name -> (E,) values of those that ended.

        ``return``, ``length`` and ``success`` (for tasks that have a success), then the columns of
        `progress.csv`, see `train_logs.log_episode`.
        """
        table = torch.stack(self._rows).numpy(force=True)  # (T, values, N)
        self._rows.clear()
        is_done = table[:, self._names.index("done")] > 0
        episodes = {name: table[:, i][is_done] for i, name in enumerate(self._names)}
        del episodes["done"]
        flags = {cause: episodes.pop(key) > 0 for cause, key in ENDS.items() if key}
        if not self._base.judges_success:
            del episodes["success"]
        for name, values in episodes.items():
            if name.startswith(f"{_TERMINATION}/"):
                values *= ~flags["diverged"]
        # Last, as a cause takes the place of a termination term with its name.
        causes = np.select(list(flags.values()), list(flags), "time_out")
        for cause in ENDS:
            episodes[f"{_TERMINATION}/{cause}"] = (causes == cause).astype(np.float32)
        return episodes


def _add_prefix(prefix: str, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {f"{prefix}/{name}": value for name, value in values.items()}
