"""`Shard`: some adjacent environments of a batch, where they run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.gym.envs.observation import as_array
from embodichain.lab.gym.envs.step.episodes import FINAL_KEYS
from embodichain.lab.gym.shards.step_tables import StepTable

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.envs.observation import Observation

__all__ = ["Shard", "ShardLog"]

_NO_ENVIRONMENTS = np.zeros(0, np.int64)


class ShardLog(Protocol):
    """The log of a shard; it is sent to where the shard runs."""

    def begin(self, env: BaseEnv, place: Any) -> None:
        """Attach the log's recorder to the environments.

        Args:
            env: The environments.
            place: What `save` returned, to continue from there; None begins the log.
        """

    def save(self) -> Any:
        """Write everything so far, and return the place in plain values."""


class Shard:
    """Owns the environments of a shard. Its methods are called by name, from another process.

    Args:
        build: Builds the environments.
    """

    def __init__(self, build: Callable[[], BaseEnv]) -> None:
        self.env = build()
        self._log: ShardLog | None = None

    def record(self, log: ShardLog, place: Any = None) -> None:
        """Record from now on; see `ShardLog.begin`."""
        log.begin(self.env, place)
        self._log = log

    def reset(
        self,
        seed: int | None,
        ids: NDArray[np.int64] | None,
        options: Mapping[str, Any],
        everything: bool = True,
    ) -> StepTable:
        """Reset environments (n,) of this shard, None for all; see `BaseEnv.reset`.

        Args:
            seed: The seed, or None.
            ids: The environments.
            options: Other options.
            everything: Whether all environments of all shards are reset.
        """
        shard_options = dict(options)
        if ids is not None:
            shard_options["reset_ids"] = ids.copy()
        if seed is not None:
            self.env.reseed(seed, startup=everything)
        obs, info = self.env.reset(options=shard_options)
        return self._table(obs, info, {})

    def step(self, action: NDArray[Any], others_reset: bool) -> StepTable:
        """Take a control step.

        Args:
            action: (n, A) for the environments of this shard.
            others_reset: Whether environments of other shards, and none of this one, were reset
                since the last step: curricula then act here too, as in one batch.
        """
        if others_reset:
            self.env.curriculum_manager.compute(_NO_ENVIRONMENTS)
        obs, reward, terminated, truncated, info = self.env.step(torch.from_numpy(action.copy()))
        arrays: dict[tuple[str, ...], NDArray[Any]] = {
            ("reward",): as_array(reward),
            ("terminated",): as_array(terminated),
            ("truncated",): as_array(truncated),
        }
        ended = self.env.termination_manager.values
        arrays |= {("ends", name): as_array(value) for name, value in ended.items()}
        return self._table(obs, info, arrays)

    def _table(
        self, obs: Any, info: Mapping[str, Any], arrays: dict[tuple[str, ...], NDArray[Any]]
    ) -> StepTable:
        """Add observation and info to the arrays of a step; the names are those of `ShardedEnv`."""
        observation: Observation = obs
        arrays[("obs",)] = observation.rows
        for path, value in observation.others.items():
            arrays["other", *path] = as_array(value)
        if "final_obs" in info:
            # Only the rows of environments that are done: in most steps few are.
            done = as_array(info["_final_obs"])
            final: Observation = info["final_obs"]
            arrays[("final",)] = final.rows[done]
            for path, value in final.others.items():
                arrays["final other", *path] = as_array(value)[done]
        shared_info: dict[tuple[str, ...], Any] = {}
        for key, value in info.items():
            if key not in FINAL_KEYS:
                self._add_info((key,), value, arrays, shared_info)
        values = {
            "info": shared_info,
            "curriculum": dict(self.env.curriculum_manager.values),
            "physics_seconds": self.env.sim.physics_seconds,
        }
        return StepTable.of(arrays, values)

    def _add_info(
        self,
        path: tuple[str, ...],
        value: Any,
        arrays: dict[tuple[str, ...], NDArray[Any]],
        shared_info: dict[tuple[str, ...], Any],
    ) -> None:
        """Add an entry of info: rows to the arrays, anything else to what all shards share."""
        if isinstance(value, Mapping) and len(value):
            for key, part in value.items():
                self._add_info((*path, str(key)), part, arrays, shared_info)
        elif isinstance(value, (torch.Tensor, np.ndarray)):
            rows = as_array(value)
            if rows.shape[:1] != (self.env.num_envs,):
                shape = f"{tuple(value.shape)} in a shard of {self.env.num_envs} environments"
                raise ValueError(f"info entry {'/'.join(path)} has no row for each: {shape}")
            arrays["info", *path] = rows
        else:
            shared_info[path] = {} if isinstance(value, Mapping) else value

    def advance(self, work: Callable[..., Any], *args: Any) -> Any:
        """Call ``work(env, *args)`` and return its result."""
        return work(self.env, *args)

    def set_run_dir(self, folder: Path | None) -> None:
        """Set the folder for the states of environments that diverge."""
        self.env.run_dir = folder

    def state(self) -> dict[str, Any]:
        """The state of the environments, see `BaseEnv.state_dict`."""
        return self.env.state_dict()

    def save(self) -> dict[str, Any]:
        """The state from which the shard can be rebuilt, with its place in the log."""
        place = None if self._log is None else self._log.save()
        return {"env": self.env.state_dict(), "run_dir": self.env.run_dir, "place": place}

    def load(self, saved: Mapping[str, Any]) -> None:
        """Continue where `save` or `state` was called, to the bit; a log is begun separately."""
        if "run_dir" in saved:
            self.env.run_dir = saved["run_dir"]
        self.env.load_state_dict(saved.get("env", saved))

    def close(self) -> None:
        """Close the environments, and the log with them."""
        self.env.close()
