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

Step = tuple[EnvObs, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]
_OF_TEMPLATE = (
    *("single_observation_space", "device", "arrays"),
    *("step_dt", "physics_dt", "control_frequency", "sim_steps_per_control", "judges_success"),
    *("active_joint_ids", "seed_value", "observation_paths", "max_episode_steps"),
)
"""Attributes that are the same for every environment of the task."""


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
        raise AttributeError(_elsewhere(f"sim.{name}"))


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
        raise AttributeError(_elsewhere(f"action_manager.{name}"))


def _elsewhere(name: str) -> str:
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
        self.template, self.pool = template, pool
        self.metadata = template.metadata
        self.num_envs = sum(pool.counts)
        self.cfg = copy.copy(template.cfg)
        self.cfg.num_envs = self.num_envs
        self.single_action_space = template.single_action_space
        self.action_space = batch_space(template.single_action_space, self.num_envs)
        self.observation_space = batch_space(template.single_observation_space, self.num_envs)
        self.streams = RandomStreams(template.streams.seed, self.num_envs, template.cfg.first_env)
        self.sim, self.action_manager = ShardedSim(), ShardedActions(template.action_manager)
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
        self._begun = self._closed = False
        self._run_dir: Path | None = None
        self.run_dir = run_dir

    def __getattr__(self, name: str) -> Any:
        """Attributes of the template that all environments share; others are refused by name."""
        if name in _OF_TEMPLATE and "template" in self.__dict__:
            return getattr(self.template, name)
        raise AttributeError(_elsewhere(name))

    @property
    def run_dir(self) -> Path | None:
        """Folder for the states of environments that diverge, with a folder for each shard."""
        return self._run_dir

    @run_dir.setter
    def run_dir(self, folder: Path | None) -> None:
        if folder != self._run_dir:
            self._run_dir = folder
            folders = [None if folder is None else folder / f"shard{k}" for k in self._shards]
            self._call("set_run_dir", [(one,) for one in folders])

    @property
    def _shards(self) -> range:
        return range(len(self.pool.counts))

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
        rest = dict(options or {})
        ids = reset_ids(rest, self.num_envs)
        if seed is not None:
            self.streams.reseed(seed)
            seed_globals(self, self.streams.seed)
        args: list[tuple[Any, ...]] = []
        for k, rows in enumerate(self._rows):
            mine = ids[(ids >= rows.start) & (ids < rows.stop)] - rows.start
            self._others_reset[k] |= bool(len(ids)) and not len(mine)
            whole = len(mine) == self.pool.counts[k]
            everything = len(ids) == self.num_envs
            args.append((seed, None if whole else mine, rest, everything))
        tables = self._call("reset", args)
        self._begun = True
        joined = self._joined(tables, range(len(tables)))
        return self._observation(joined), self._info(joined, tables[0].values["info"])

    def step(self, action: EnvAction, **kwargs: Any) -> Step:  # type: ignore[override]
        """Advance all environments by one control step; see `BaseEnv.step`.

        Raises:
            TypeError: If the action is no tensor or array, or there are keyword arguments.
            ValueError: If its shape is wrong or it is not finite; no state has changed.
            gymnasium.error.ResetNeeded: If `reset` has not been called.
        """
        require_open(self._closed)
        if not self._begun:
            raise gym.error.ResetNeeded("call reset() before the first step()")
        checked, _ = self._check(action)
        if kwargs or not isinstance(checked, torch.Tensor):
            raise TypeError("environments in shards take a tensor (N, A) and no other arguments")
        numbers = np.array(checked.numpy())  # a copy: calls are kept, for shards that are lost
        args = [
            (numbers[rows], others)
            for rows, others in zip(self._rows, self._others_reset, strict=True)
        ]
        tables = self._call("step", args, steps=1)
        self.control_step += 1
        done = [self._ends(table) for table in tables]
        self._others_reset = [any(done) and not mine for mine in done]
        joined = self._joined(tables, [k for k, mine in enumerate(done) if mine])
        reward, terminated, truncated = (
            torch.from_numpy(joined.pop((name,))) for name in ("reward", "terminated", "truncated")
        )
        self.termination_manager.values = {
            path[1]: torch.from_numpy(joined.pop(path))
            for path in list(joined)
            if path[0] == "ends"
        }
        finals = self._finals(tables, done)
        obs, info = self._observation(joined), self._info(joined, tables[0].values["info"])
        if any(done):
            final = obs.with_rows(obs.rows.copy())
            final.others.update({path: value.clone() for path, value in obs.others.items()})
            over = (terminated | truncated).numpy()
            for path, values in finals.items():
                target = final.rows if path == ("final",) else final.others[path[1:]].numpy()
                target[over] = values
            add_finals(info, final, over)
        return obs, reward, terminated, truncated, info

    @staticmethod
    def _ends(table: StepTable) -> bool:
        return any(path == ("final",) for path, _, _ in table.entries)

    @staticmethod
    def _finals(tables: Sequence[StepTable], done: Sequence[bool]) -> dict[Entry, NDArray[Any]]:
        """The final observations of the environments that ended, in their order."""
        parts = []
        for table, mine in zip(tables, done, strict=True):
            if mine:
                arrays = table.arrays().items()
                parts.append({p: a for p, a in arrays if p[0] in ("final", "final other")})
        return join_rows(parts) if parts else {}

    def _joined(self, tables: Sequence[StepTable], reset: Sequence[int]) -> dict[Entry, Any]:
        """The rows of all environments; also takes over what shards report besides them."""
        parts = []
        for table in tables:
            arrays = table.arrays().items()
            parts.append({p: a for p, a in arrays if p[0] not in ("final", "final other")})
        seconds = max(table.values["physics_seconds"] for table in tables)
        self.sim.physics_seconds = max(self.sim.physics_seconds, seconds)
        self.curriculum_manager.values = tables[next(iter(reset), 0)].values["curriculum"]
        return join_rows(parts)

    def _observation(self, joined: dict[Entry, Any]) -> Observation:
        obs = Observation(self._layout, joined.pop(("obs",)))
        for path in [path for path in joined if path[0] == "other"]:
            obs.others[path[1:]] = torch.from_numpy(joined.pop(path))
        return obs

    @staticmethod
    def _info(joined: Mapping[Entry, Any], same: Mapping[Entry, Any]) -> dict[str, Any]:
        info: dict[str, Any] = {}
        values = {path[1:]: torch.from_numpy(array) for path, array in joined.items()}
        for path, value in {**same, **values}.items():
            inner = info
            for name in path[:-1]:
                inner = inner.setdefault(name, {})
            inner[path[-1]] = value
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
        stages = self._call("advance", [(_stage,)] * len(self._rows))
        return stages[0]

    def hold_curriculum(self, stage: Mapping[str, Any] | None = None) -> None:
        """Keep the curriculum at a stage; see `BaseEnv.hold_curriculum`."""
        self._call("advance", [(_hold, stage)] * len(self._rows))
        self.curriculum_manager.values = self.curriculum_stage()["values"]
        self.curriculum_manager.held = True

    def release_curriculum(self) -> None:
        """Let the curriculum go on."""
        self._call("advance", [(_release,)] * len(self._rows))
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
            found = f"{len(counts)} shards of {counts}" if counts else "one process"
            message = f"the saved state is of {found} environments, not of {self.pool.counts}"
            raise ConfigError([Problem("sim.shards", message)])
        self.pool.load(states)
        self.streams.load_state_dict(saved["streams"])
        self.control_step, self._begun = saved["control_step"], True
        self._others_reset = list(saved["others_reset"])

    def render(self) -> None:
        """Return None: pictures are drawn from a shard's log."""
        require_open(self._closed)

    def close(self) -> None:
        """Close the shards, then the template."""
        if not self._closed:
            self._closed = True
            with ExitStack() as stack:  # the last callback first
                stack.callback(self.template.close)
                for callback in self.at_close:
                    stack.callback(callback)
                self.pool.close()


def _stage(env: BaseEnv) -> dict[str, Any]:
    return env.curriculum_stage()


def _hold(env: BaseEnv, stage: Mapping[str, Any] | None) -> None:
    env.hold_curriculum(stage)


def _release(env: BaseEnv) -> None:
    env.release_curriculum()
