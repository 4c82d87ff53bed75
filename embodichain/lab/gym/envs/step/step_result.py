"""`StepResult`: what a control step computes, as arrays. The dict ``info`` is made of it.

A step fills it from top to bottom. Who reads a few numbers of a step, such as `SB3VecEnv`, reads
them here, and no tensor and no dict is made; `BaseEnv.step` returns `StepResult.info`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.value_managers import TermRows
from embodichain.lab.gym.envs.step.episodes import add_finals
from embodichain.utils.arrays import is_host, tensor_of

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observation import Observation

__all__ = ["StepResult", "none_set", "zeroed"]

Mask = NDArray[np.bool_]


@dataclass(slots=True, eq=False)
class StepResult:
    """A control step of N environments. Do not write to its arrays: the environment reads some.

    Attributes:
        success_terminated: (N,) bool, a success that ends episodes.
        fail: (N,) bool, a failure, which ends episodes.
        time_out: (N,) bool of terminations that truncate; None without such a term.
        success: (N,) bool, the metric ``success`` above 0, and without it `success_terminated`.
        metrics: Name -> (N,) metric of the episode so far, those of actions and commands included,
            without those that only `class_info` has.
        curriculum: The last results of the curricula.
        terminations: Values of the termination terms.
        reward: (N,) float32.
        rewards: Values of the reward terms, without weights.
        episode_sums: Sums of value x weight over the episode, this step included.
        terminated: (N,) bool.
        truncated: (N,) bool.
        obs: The observation; where environments were reset in place, that of the new episode.
        diverged: (N,) bool.
        elapsed_steps: (N,) int32 control steps of the episodes, this one included.
        done: (N,) bool, terminated or truncated; None if it is known that none is.
        final_obs: The observation before environments that are done were reset in place, or None.
        class_info: The dict that hooks and terms have read and filled, or None if none does.
    """

    success_terminated: Mask
    fail: Mask
    time_out: Mask | None
    success: Mask
    metrics: dict[str, NDArray[Any]]
    curriculum: dict[str, float]
    class_info: dict[str, Any] | None
    terminations: TermRows
    reward: NDArray[np.float32] = field(init=False)
    rewards: TermRows = field(init=False)
    episode_sums: TermRows = field(init=False)
    terminated: Mask = field(init=False)
    truncated: Mask = field(init=False)
    obs: Observation = field(init=False)
    diverged: Mask = field(init=False)
    elapsed_steps: NDArray[np.int32] = field(init=False)
    done: Mask | None = None
    final_obs: Observation | None = None
    _info: dict[str, Any] | None = None

    def end(self, truncated: Mask, ignore_terminations: bool) -> None:
        """Set `terminated` and `truncated`.

        Args:
            truncated: (N,) episodes at their limit; may be changed.
            ignore_terminations: Whether success and failure do not end episodes.
        """
        if self.time_out is not None:
            truncated |= self.time_out
        terminated = self.success_terminated | self.fail
        if ignore_terminations:
            terminated = np.zeros_like(terminated)
        self.set_ends(terminated, truncated)

    def set_ends(self, terminated: Mask, truncated: Mask) -> None:
        """Set `terminated` and `truncated`, (N,) bool, and `done`."""
        self.terminated = terminated
        self.truncated = truncated
        done = terminated | truncated
        self.done = None if none_set(done) else done

    def exclude(self, mask: Mask) -> None:
        """Set what was judged of environments, (N,) bool, to 0; their reward, too."""
        counted = ~mask
        self.success_terminated = self.success_terminated & counted
        self.fail = self.fail & counted
        self.success = self.success & counted
        self.metrics = {name: _zeroed(values, mask) for name, values in self.metrics.items()}
        self.reward = _zeroed(self.reward, mask)
        self.rewards = self.rewards.zeroed(mask)
        self.episode_sums = self.episode_sums.zeroed(mask)
        if self.class_info is not None:
            self.class_info = zeroed(self.class_info, mask)

    def exclude_step(self, mask: Mask) -> None:
        """Set all results of environments, (N,) bool, to 0: the step does not count for them."""
        self.exclude(mask)
        self.set_ends(self.terminated & ~mask, self.truncated & ~mask)
        self.diverged = self.diverged & ~mask
        self.elapsed_steps = _zeroed(self.elapsed_steps, mask)

    def entries(self) -> dict[str, Any]:
        """The entries of ``info`` as arrays (N,), or maps of arrays by name: do not write to them.

        Those of a class's hooks and of final observations are left out.
        """
        entries: dict[str, Any] = {
            "elapsed_steps": self.elapsed_steps,
            "success": self.success,
            "success_terminated": self.success_terminated,
            "fail": self.fail,
            "diverged": self.diverged,
            "metrics": self.metrics,
            "rewards": self.rewards if self.rewards.names else {},
            "episode_sums": self.episode_sums if self.episode_sums.names else {},
        }
        if self.curriculum:
            entries["curriculum"] = self.curriculum
        return entries

    def info(self) -> dict[str, Any]:
        """Return the dict that `BaseEnv.step` returns, the same one at every call.

        Its tensors are owned by the caller.
        """
        info = self._info
        if info is None:
            info = self.class_info
            if info is None:
                info = _as_tensors(self.entries())
            else:
                info["elapsed_steps"] = tensor_of(self.elapsed_steps)
                info["diverged"] = tensor_of(self.diverged.copy())
            self._info = info
        if self.final_obs is not None and "final_info" not in info:
            add_finals(info, self.final_obs, cast("Mask", self.done))
        return info


def _as_tensors(entries: Mapping[str, Any]) -> dict[str, Any]:
    """Copies of arrays as tensors; `TermRows`, which copy what is read, and numbers as they are."""
    tensors: dict[str, Any] = {}
    for name, value in entries.items():
        if isinstance(value, dict):
            tensors[name] = _as_tensors(value)
        elif isinstance(value, (TermRows, float)):
            tensors[name] = value
        else:
            tensors[name] = tensor_of(value.copy())
    return tensors


def none_set(mask: Mask) -> bool:
    """Whether no flag of a mask is set; for few environments, twice as fast as a reduction.

    False on a device, where it is not known: what depends on the mask is then computed for all.
    """
    if not is_host(mask):
        return False
    return b"\1" not in mask.tobytes()


def _zeroed(values: NDArray[Any], mask: Mask) -> NDArray[Any]:
    return np.where(mask, values.dtype.type(0), values)


def zeroed(info: Mapping[str, Any], mask: Mask) -> dict[str, Any]:
    """Return a copy of ``info`` with some rows of every (N, ...) tensor zeroed, nested ones too.

    Args:
        info: Not changed, nor are its tensors.
        mask: (N,) bool, the rows that are zeroed.
    """
    copy = dict(info)
    tensor_mask = tensor_of(mask)
    for key, value in info.items():
        if isinstance(value, TermRows):
            copy[key] = value.zeroed(mask)
        elif isinstance(value, Mapping):
            copy[key] = zeroed(value, mask)
        elif isinstance(value, torch.Tensor) and value.shape[:1] == tensor_mask.shape:
            copy[key] = value.masked_fill(tensor_mask.reshape(-1, *[1] * (value.ndim - 1)), 0)
    return copy
