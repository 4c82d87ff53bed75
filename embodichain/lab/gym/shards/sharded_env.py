"""`ShardedEnv`: the batch interface of `BaseEnv` over shards that run elsewhere.

It has what learners, evaluations and policies use: spaces, `reset`, `step`, `rand`, the structure
of observations and actions, the state. The simulation itself is in the shards.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from embodichain.lab.gym.envs.closed import require_open
from embodichain.lab.gym.envs.describing import describe
from embodichain.lab.gym.envs.managers.action_manager import ActionCheck
from embodichain.lab.gym.envs.observation import Observation
from embodichain.lab.gym.envs.step.episodes import add_finals, seed_globals
from embodichain.lab.gym.envs.step.judging import reset_ids
from embodichain.lab.gym.shards.shard_pool import ShardPool
from embodichain.lab.gym.shards.step_tables import Path as Entry
from embodichain.lab.gym.shards.step_tables import StepTable, join_rows
from embodichain.lab.sim.types import EnvAction, EnvObs
from embodichain.utils.arrays import as_env_ids, to_tensor
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.random import RandomStreams

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.envs.observers import StepObserver

__all__ = ["ShardedEnv"]

_FINAL_ARRAYS = ("final", "final other")
"""First names of the paths of arrays with final observations."""
Step = tuple[EnvObs, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]
_SHARED_ATTRIBUTES = (
    "active_joint_ids",
    "arrays",
    "control_frequency",
    "device",
    "judges_success",
    "max_episode_steps",
    "observation_paths",
    "physics_dt",
    "seed_value",
    "sim_steps_per_control",
    "single_observation_space",
    "step_dt",
)
"""Attributes of the template that are the same for every environment of the task."""


class ShardedSim:
    """What learners and runs read of the simulation of a batch in shards.

    Attributes:
        physics_seconds: Wall time of physics; of shards that run at the same time, the longest.
        is_window_open: Always False: windows show a simulation of this process.
    """

    is_window_open = False

    def __init__(self) -> None:
        self.physics_seconds = 0.0

    def __getattr__(self, name: str) -> Any:
        """Refuse everything else by name."""
        raise AttributeError(_explain_absence(f"sim.{name}"))


class ShardedActions:
    """The actions of a batch in shards: their structure, without their state.

    Args:
        manager: The action manager of an environment of the same task.
    """

    def __init__(self, manager: Any) -> None:
        self.home: Callable[[], NDArray[np.float64]] = manager.home
        self.names: list[str] = manager.names
        self.terms: Mapping[str, Any] = manager.terms

    def __len__(self) -> int:
        """Number of terms."""
        return len(self.terms)

    def __getattr__(self, name: str) -> Any:
        """Refuse everything else by name."""
        raise AttributeError(_explain_absence(f"action_manager.{name}"))


def _explain_absence(name: str) -> str:
    """Why an attribute of `BaseEnv` does not exist here."""
    return (
        f"{name} is not on this machine: the environments run in shards (sim.backend=ray). "
        "Here are spaces, observations, rand() and what step() returns"
    )


class ShardedEnv(gym.Env[EnvObs, EnvAction]):
    """N environments in shards, stepped together; results are those of one `BaseEnv`, to the bit.

    Args:
        template: One environment of the task, which describes it and is never stepped; `close`
            closes it.
        pool: The shards.
        run_dir: Folder for the states of environments that diverge; None writes none.

    Attributes:
        template: The environment that describes the task.
        pool: The shards.
        num_envs: N.
        streams: The random streams that policies draw from here.
        control_step: Control steps since the environments were built.
        at_close: Called by `close` when the shards are closed.
    """

    def __init__(self, template: BaseEnv, pool: ShardPool, run_dir: Path | None = None) -> None:
        self.template = template
        self.pool = pool
        self.metadata = template.metadata
        self.num_envs = sum(pool.counts)
        self.cfg = copy.copy(template.cfg)
        self.cfg.num_envs = self.num_envs
        self.single_action_space = template.single_action_space
        self.action_space = batch_space(template.single_action_space, self.num_envs)
        self.observation_space = batch_space(template.single_observation_space, self.num_envs)
        self.streams = RandomStreams(template.streams.seed, self.num_envs, template.cfg.first_env)
        self.sim = ShardedSim()
        self.action_manager = ShardedActions(template.action_manager)
        self._layout = copy.copy(template.observation_buffer.layout)
        self._layout.num_envs = self.num_envs
        self.observation_manager = copy.copy(template.observation_manager)
        self.observation_manager.num_envs = self.num_envs
        self.observation_manager.use(self._layout)
        self.termination_manager = SimpleNamespace(values={})
        self.curriculum_manager = SimpleNamespace(values={}, held=False)
        self.managers = template.managers
        self.control_step = 0
        self._check = ActionCheck(template.single_action_space, self.num_envs, template.arrays)
        self._rows = [
            slice(first, first + count)
            for first, count in zip(pool.firsts, pool.counts, strict=True)
        ]
        self._others_reset = [False] * len(pool.counts)
        self.at_close: list[Callable[[], None]] = []
        self._has_begun = False
        self._closed = False
        self._run_dir: Path | None = None
        self.run_dir = run_dir

    def __getattr__(self, name: str) -> Any:
        """Attributes of the template that all environments share; others are refused by name."""
        if name in _SHARED_ATTRIBUTES and "template" in self.__dict__:
            return getattr(self.template, name)
        raise AttributeError(_explain_absence(name))

    @property
    def run_dir(self) -> Path | None:
        """Folder for the states of environments that diverge, with a folder for each shard."""
        return self._run_dir

    @run_dir.setter
    def run_dir(self, folder: Path | None) -> None:
        if folder == self._run_dir:
            return
        self._run_dir = folder
        args: list[tuple[Path | None]] = []
        for k in range(len(self.pool.counts)):
            args.append((None if folder is None else folder / f"shard{k}",))
        self._call("set_run_dir", args)

    def _call(self, method: str, args: Sequence[tuple[Any, ...]], steps: int = 0) -> list[Any]:
        """Call a method of every shard, see `ShardPool.call`; refuse it after `close`."""
        require_open(self._closed)
        return self.pool.call(method, args, steps=steps)

    # -- stepping ------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[EnvObs, dict[str, Any]]:
        """Start new episodes; see `BaseEnv.reset`."""
        require_open(self._closed)
        shard_options = dict(options or {})
        ids = reset_ids(shard_options, self.num_envs)  # taken out of the options
        if seed is not None:
            self.streams.reseed(seed)
            seed_globals(self, self.streams.seed)
        resets_everything = len(ids) == self.num_envs
        args: list[tuple[Any, ...]] = []
        for k, rows in enumerate(self._rows):
            shard_ids = ids[(ids >= rows.start) & (ids < rows.stop)] - rows.start
            self._others_reset[k] |= bool(len(ids)) and not len(shard_ids)
            resets_shard = len(shard_ids) == self.pool.counts[k]
            args.append(
                (seed, None if resets_shard else shard_ids, shard_options, resets_everything)
            )
        tables = self._call("reset", args)
        self._has_begun = True
        arrays = self._join(tables, reset_shards=range(len(tables)))
        return self._observation(arrays), self._info(arrays, tables[0].values["info"])

    def step(self, action: EnvAction, **kwargs: Any) -> Step:  # type: ignore[override]
        """Advance all environments by one control step; see `BaseEnv.step`.

        Raises:
            TypeError: If the action is not a tensor or array, or there are keyword arguments.
            ValueError: If its shape is wrong or it is not finite; no state has changed.
            gymnasium.error.ResetNeeded: If `reset` has not been called.
        """
        require_open(self._closed)
        if not self._has_begun:
            raise gym.error.ResetNeeded("call reset() before the first step()")
        checked, _ = self._check(action)
        if kwargs or not isinstance(checked, torch.Tensor):
            raise TypeError("environments in shards take a tensor (N, A) and no other arguments")
        # A copy: the pool stores calls, for shards that are lost.
        actions = np.array(checked.numpy())
        args = [
            (actions[rows], others_reset)
            for rows, others_reset in zip(self._rows, self._others_reset, strict=True)
        ]
        tables = self._call("step", args, steps=1)
        self.control_step += 1

        has_final = [self._has_final(table) for table in tables]
        any_final = any(has_final)
        self._others_reset = [any_final and not shard_has_final for shard_has_final in has_final]
        arrays = self._join(tables, reset_shards=np.flatnonzero(has_final).tolist())
        reward = torch.from_numpy(arrays.pop(("reward",)))
        terminated = torch.from_numpy(arrays.pop(("terminated",)))
        truncated = torch.from_numpy(arrays.pop(("truncated",)))
        self.termination_manager.values = {
            path[1]: torch.from_numpy(arrays.pop(path))
            for path in list(arrays)
            if path[0] == "ends"
        }
        obs = self._observation(arrays)
        info = self._info(arrays, tables[0].values["info"])
        if any_final:
            done = (terminated | truncated).numpy()
            add_finals(info, self._final_observation(obs, tables, done), done)
        return obs, reward, terminated, truncated, info

    @staticmethod
    def _has_final(table: StepTable) -> bool:
        """Whether an episode ended in a shard."""
        return any(path == ("final",) for path, _, _ in table.entries)

    def _final_observation(
        self, obs: Observation, tables: Sequence[StepTable], done: NDArray[np.bool_]
    ) -> Observation:
        """A copy of an observation with the final rows of environments that are done, (N,)."""
        final = obs.with_rows(obs.rows.copy())
        final.others.update({path: value.clone() for path, value in obs.others.items()})
        parts = [
            {path: array for path, array in table.arrays().items() if path[0] in _FINAL_ARRAYS}
            for table in tables
            if self._has_final(table)
        ]
        for path, rows in join_rows(parts).items():
            target = final.rows if path == ("final",) else final.others[path[1:]].numpy()
            target[done] = rows
        return final

    def _join(
        self, tables: Sequence[StepTable], reset_shards: Sequence[int]
    ) -> dict[Entry, NDArray[Any]]:
        """The rows of all environments, but final ones; also takes over the shards' other values.

        Args:
            tables: Those of all shards.
            reset_shards: Shards in which environments were reset: their curricula have acted.
        """
        seconds = max(table.values["physics_seconds"] for table in tables)
        self.sim.physics_seconds = max(self.sim.physics_seconds, seconds)
        curriculum_shard = next(iter(reset_shards), 0)
        self.curriculum_manager.values = tables[curriculum_shard].values["curriculum"]
        return join_rows(
            [
                {path: a for path, a in table.arrays().items() if path[0] not in _FINAL_ARRAYS}
                for table in tables
            ]
        )

    def _observation(self, arrays: dict[Entry, NDArray[Any]]) -> Observation:
        """The observation, which is taken out of the arrays."""
        obs = Observation(self._layout, arrays.pop(("obs",)))
        for path in [path for path in arrays if path[0] == "other"]:
            obs.others[path[1:]] = torch.from_numpy(arrays.pop(path))
        return obs

    @staticmethod
    def _info(
        arrays: Mapping[Entry, NDArray[Any]], shared_info: Mapping[Entry, Any]
    ) -> dict[str, Any]:
        """Info from the arrays that are left, and from what all shards share."""
        values = dict(shared_info)
        for path, array in arrays.items():
            values[path[1:]] = torch.from_numpy(array)
        info: dict[str, Any] = {}
        for path, value in values.items():
            parent = info
            for name in path[:-1]:
                parent = parent.setdefault(name, {})
            parent[path[-1]] = value
        return info

    # -- work in the shards ----------------------------------------------------------------------

    def advance(self, work: Callable[..., Any], args: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Call ``work(env, *args)`` in every shard, without communication in between.

        Args:
            work: An importable function; it gets the `BaseEnv` of the shard.
            args: Further arguments for each shard.
        """
        return self._call("advance", [(work, *mine) for mine in args])

    def passed(self, steps: int) -> None:
        """Count control steps that were taken by `advance`; shards may then be saved."""
        self.control_step += steps
        self.pool.passed(steps)

    # -- curriculum ------------------------------------------------------------------------------

    def curriculum_stage(self) -> dict[str, Any]:
        """The stage that the curriculum has reached, the same in all shards."""
        stages = self._call("advance", [(_curriculum_stage,)] * len(self._rows))
        return stages[0]

    def hold_curriculum(self, stage: Mapping[str, Any] | None = None) -> None:
        """Keep the curriculum at a stage; see `BaseEnv.hold_curriculum`."""
        self._call("advance", [(_hold_curriculum, stage)] * len(self._rows))
        self.curriculum_manager.values = self.curriculum_stage()["values"]
        self.curriculum_manager.held = True

    def release_curriculum(self) -> None:
        """Let the curriculum go on."""
        self._call("advance", [(_release_curriculum,)] * len(self._rows))
        self.curriculum_manager.held = False

    # -- random numbers --------------------------------------------------------------------------

    def rand(
        self,
        name: str,
        shape: Sequence[int] = (),
        low: Any = 0.0,
        high: Any = 1.0,
        env_ids: Any = None,
    ) -> torch.Tensor:
        """Draw uniformly from [low, high); see `BaseEnv.rand`."""
        ids = as_env_ids(env_ids, self.num_envs)
        return to_tensor(self.streams.uniform(name, shape, low, high, ids))

    def randn(self, name: str, shape: Sequence[int] = (), env_ids: Any = None) -> torch.Tensor:
        """Draw standard normal numbers; see `BaseEnv.randn`."""
        return to_tensor(self.streams.normal(name, shape, as_env_ids(env_ids, self.num_envs)))

    # -- the rest --------------------------------------------------------------------------------

    def add_observer(self, observer: StepObserver) -> None:
        """Refuse observers, such as viewers: they see a simulation of this process.

        Raises:
            ConfigError: Always.
        """
        message = f"{type(observer).__name__} follows environments of one process, not shards"
        raise ConfigError([Problem("sim.backend", message)])

    def state_dict(self) -> dict[str, Any]:
        """Return the state from which the run continues bit for bit, with as many shards."""
        states = self._call("state", [()] * len(self._rows))
        return {
            "num_envs": self.num_envs,
            "shards": {str(k): state for k, state in enumerate(states)},
            "streams": self.streams.state_dict(),
            "control_step": self.control_step,
            "others_reset": list(self._others_reset),
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken.

        Raises:
            ConfigError: If the numbers of environments or shards differ.
        """
        require_open(self._closed)
        states = list(saved.get("shards", {}).values())
        counts = [state["num_envs"] for state in states]
        if tuple(counts) != self.pool.counts:
            origin = f"shards of {counts} environments" if counts else "one process"
            message = f"the saved state is from {origin}, not from shards of {self.pool.counts}"
            raise ConfigError([Problem("sim.shards", message)])
        self.pool.load(states)
        self.streams.load_state_dict(saved["streams"])
        self.control_step = saved["control_step"]
        self._has_begun = True
        self._others_reset = list(saved["others_reset"])

    def render(self) -> None:
        """Return None: pictures are drawn from a shard's log."""
        require_open(self._closed)

    def __repr__(self) -> str:
        """Return task, size and spaces in one line."""
        return describe(
            type(self).__name__,
            self.template.task_name,
            f"num_envs={self.num_envs}",
            f"shards={len(self.pool.counts)}",
            action=self.single_action_space,
            observation=self.single_observation_space,
        )

    __str__ = __repr__

    @property
    def is_closed(self) -> bool:
        """Whether `close` was called."""
        return self._closed

    def close(self) -> None:
        """Close the shards, then the template."""
        if not self._closed:
            self._closed = True
            with ExitStack() as stack:  # the last callback first
                stack.callback(self.template.close)
                for callback in self.at_close:
                    stack.callback(callback)
                self.pool.close()


# Functions that `advance` sends to the shards, where they are imported by their names.


def _curriculum_stage(env: BaseEnv) -> dict[str, Any]:
    return env.curriculum_stage()


def _hold_curriculum(env: BaseEnv, stage: Mapping[str, Any] | None) -> None:
    env.hold_curriculum(stage)


def _release_curriculum(env: BaseEnv) -> None:
    env.release_curriculum()
