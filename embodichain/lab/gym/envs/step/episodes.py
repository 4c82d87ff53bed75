"""`Episodes`: counters of the episodes of N environments, and how they end; autoreset modes.

`add_finals` edits the entries of `info` for environments that autoreset resets.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import NO_LIMIT
from embodichain.utils.array_types import EnvIndex
from embodichain.utils.arrays import Arrays, tensor_of
from embodichain.utils.short_repr import short_repr
from embodichain.utils.suggest import did_you_mean

__all__ = [
    "AutoresetMode",
    "Episodes",
    "add_finals",
    "parse_mode",
    "seed_globals",
]

Mask = NDArray[np.bool_]


class Episodes:
    """Counts steps and episodes; its arrays may be read, and are written by its methods only.

    Args:
        num_envs: N.
        limit: Control steps after which an episode is truncated, or `NO_LIMIT`.
        arrays: Makes the arrays.

    Attributes:
        begun: Whether environments were reset.
        counts_present: Whether `count` contains the present step.
        elapsed: (N,) int32 finished control steps of the current episodes.
        ids: (N,) int64 number of the current episode, from 0; -1 before the first reset.
        success: (N,) bool whether the last step was a success.
        pending: (N,) bool environments that the next step resets instead of stepping, or None
            (autoreset mode NEXT_STEP only).
        last_action: (N, A) float64 action as last given; zeros at the start of an episode. Replaced
            and never written to: observers may store it.
        cut: (N,) bool episodes that end, as truncated, with the next step, or None.
    """

    def __init__(self, num_envs: int, limit: int, arrays: Arrays) -> None:
        self._arrays = arrays
        self._num_envs = num_envs
        self._one: NDArray[np.int32] = arrays.full(num_envs, 1, np.int32)
        self.limit = limit
        self.begun = False
        self.counts_present = True
        self.elapsed: NDArray[np.int32] = arrays.full(num_envs, 0, np.int32)
        self.ids: NDArray[np.int64] = arrays.full(num_envs, -1, np.int64)
        self.success: Mask = arrays.full(num_envs, False, np.bool_)
        self.pending: Mask | None = None
        self._on_device = arrays.on_device
        # On a device it is always there: a captured step reads it.
        self.cut: Mask | None = self.success.copy() if self._on_device else None
        self.last_action: NDArray[np.float64] = arrays.full((num_envs, 0), 0.0)

    def __repr__(self) -> str:
        """Return N and the time limit."""
        limit = None if self.limit == NO_LIMIT else self.limit
        return short_repr(self, num_envs=self._num_envs, limit=limit)

    @property
    def limit(self) -> int:
        """Control steps after which an episode is truncated, or `NO_LIMIT`."""
        return self._limit

    @limit.setter
    def limit(self, steps: int) -> None:
        self._limit = steps
        self._limits: NDArray[np.int32] = self._arrays.full(self._num_envs, steps, np.int32)

    def set_last_action(self, ids: EnvIndex, action: Any) -> None:
        """Set the last action of environments (n,)."""
        self.last_action = self.last_action.copy()
        self.last_action[ids] = action

    def advance(self) -> None:
        """Count a control step of all environments."""
        # One number in place takes three times as long.
        self.elapsed[...] = self.elapsed + self._one

    @property
    def count(self) -> NDArray[np.int32]:
        """(N,) int32 control steps, with or without the present one (see `counting`); a copy."""
        if self.counts_present:
            return self.elapsed.copy()
        return self.elapsed - np.int32(1)

    def counting(self, present: bool) -> _Counting:
        """Say whether the present step counts in `count`, within a ``with`` statement.

        It counts for terms and after a step. EmbodiChain counts it after the hooks that observe and
        judge; these see the steps before it. So in the first step of an episode a term reads 1 and
        `get_reward` of a class reads 0; in `info` of that step it is 1.
        """
        return _Counting(self, present)

    def begin(self, ids: EnvIndex) -> None:
        """Start the next episode of environments (n,)."""
        self.begun = True
        self.elapsed[ids] = 0
        self.ids[ids] += 1
        self._forget(ids)
        if self.cut is not None:
            self.cut[ids] = False

    def restore(self, ids: EnvIndex, elapsed: int, episode: int) -> None:
        """Continue an episode in environments (n,)."""
        self.begun = True
        self.elapsed[ids] = elapsed
        self.ids[ids] = episode
        self._forget(ids)
        self.settle(ids)

    def _forget(self, ids: EnvIndex) -> None:
        self.success = self.success.copy()  # arrays returned earlier must not change
        self.success[ids] = False

    def settle(self, ids: EnvIndex) -> None:
        """Clear the pending reset of environments (n,) that were reset explicitly."""
        if self.pending is not None:
            self.pending[ids] = False

    def truncate(self, ids: Any) -> None:
        """End the episodes of environments with the next step."""
        if self.cut is None:
            self.cut = np.zeros_like(self.success)
        self.cut[ids] = True

    def take_truncated(self) -> Mask:
        """Return (N,) episodes that this step truncates: at the limit, or by `truncate`.

        The marks of `truncate` are cleared.
        """
        truncated: Mask = self.elapsed >= self._limits
        if self.cut is not None:
            truncated |= self.cut
            if self._on_device:
                self.cut[...] = False
            else:
                self.cut = None
        return truncated

    def state_dict(self) -> dict[str, Any]:
        """Return copies of everything but the limit."""
        return {
            "elapsed": self.elapsed.copy(),
            "ids": self.ids.copy(),
            "success": self.success.copy(),
            "last_action": self.last_action.copy(),
            "pending": None if self.pending is None else self.pending.copy(),
            "cut": None if self.cut is None else self.cut.copy(),
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self.elapsed = saved["elapsed"].copy()
        self.ids = saved["ids"].copy()
        self.begun = bool(self._arrays.host(self.ids)[0] >= 0)
        self.success = saved["success"].copy()
        self.last_action = saved["last_action"].copy()
        self.pending = None if saved["pending"] is None else saved["pending"].copy()
        if saved["cut"] is not None:
            self.cut = saved["cut"].copy()
        elif self._on_device:
            self.cut = np.zeros_like(self.success)
        else:
            self.cut = None


class _Counting:
    """The context of `Episodes.counting`; a generator would take four times as long."""

    __slots__ = ("_before", "_episodes", "_present")

    def __init__(self, episodes: Episodes, present: bool) -> None:
        self._episodes = episodes
        self._present = present
        self._before = present

    def __enter__(self) -> None:
        self._before = self._episodes.counts_present
        self._episodes.counts_present = self._present

    def __exit__(self, *error: object) -> None:
        self._episodes.counts_present = self._before


FINAL_KEYS = ("final_obs", "final_info", "_final_obs", "_final_info", "final_observation")


def parse_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Return Gymnasium's mode for a mode, its name or its value.

    Raises:
        ValueError: If there is no such mode; lists them.
    """
    if isinstance(mode, AutoresetMode):
        return mode
    names = {m.name: m for m in AutoresetMode} | {m.value: m for m in AutoresetMode}
    named_mode = names.get(mode) or names.get(str(mode).upper())
    if named_mode is None:
        allowed = ", ".join(m.name for m in AutoresetMode)
        raise ValueError(
            f"unknown autoreset_mode {mode!r}; one of: {allowed}.{did_you_mean(str(mode), names)}"
        )
    return named_mode


def seed_globals(env: gym.Env[Any, Any], seed: int) -> None:
    """Seed the generators that code outside this package may use: `np_random` and torch's.

    This package does not draw from torch's generator; users' classes may.
    """
    gym.Env.reset(env, seed=seed if seed >= 0 else seed % 2**64)
    torch.manual_seed(seed % 2**64)


def add_finals(info: dict[str, Any], obs: Any, done: NDArray[np.bool_]) -> None:
    """Put the final observation and info of environments that are done into ``info``.

    ``final_obs`` (``final_observation`` is the same object) and ``final_info`` have a row for
    every environment; only rows where ``_final_obs`` is True are final.
    """
    mask = tensor_of(done)
    info["final_info"] = {key: value for key, value in info.items() if key not in FINAL_KEYS}
    info["final_obs"] = obs
    info["final_observation"] = obs
    info["_final_obs"] = mask
    info["_final_info"] = mask
