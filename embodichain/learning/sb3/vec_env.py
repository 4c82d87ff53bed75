"""`SB3VecEnv`: a Stable-Baselines3 `VecEnv` over the batched environment.

Spaces are made in `learning.spaces`, training is in `learning.training.train`.
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.env_util import is_wrapped
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from embodichain.lab.gym.envs.closed import require_open
from embodichain.lab.gym.envs.describing import describe
from embodichain.lab.gym.envs.observation import as_array, on_host
from embodichain.lab.gym.envs.step.step_result import none_set
from embodichain.learning.spaces import (
    ActionScale,
    LearnerView,
    observation_dict,
    require_torch_batch,
)

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["ENDS", "SB3VecEnv"]

ENDS = {
    "diverged": "diverged",
    "success": "success_terminated",
    "fail": "fail",
    "time_out": "",
}
"""Causes of the end of an episode, and the entry of ``info`` that says so; the first that applies
is reported, the last if no entry does."""

F32 = NDArray[np.float32]
Bool = NDArray[np.bool_]
Indices = int | Iterable[int] | None
Infos = list[dict[str, Any]]
Observed = F32 | dict[str, NDArray[Any]]


_FINAL_KEYS = (
    "success",
    "success_terminated",
    "fail",
    "diverged",
    "elapsed_steps",
    "episode_sums",
    "metrics",
)
"""Entries of ``final_info`` that are read; `StepResult` has attributes of these names."""


@dataclass(frozen=True, slots=True, eq=False)
class _Final:
    """What there was when episodes ended.

    Attributes:
        obs: The observation before the reset.
        info: The entries of ``final_info``, at least those of `_FINAL_KEYS`, as tensors or arrays.
    """

    obs: Any
    info: Mapping[str, Any]


class SB3VecEnv(VecEnv):
    """A Stable-Baselines3 vector environment over one batched environment.

    Observations are one group: flat, (N, K) float32, an image, or a dict of its entries. Actions
    are (N, A) in [-1, 1], scaled to the task's bounds. An environment whose episode ends is reset
    in the same step; its info then has

    * ``terminal_observation``: the observation before the reset, (K,) or a dict;
    * ``TimeLimit.truncated``: truncated and not terminated, so that its value may be bootstrapped;
    * ``episode``: return ``r``, length ``l`` and seconds since construction ``t``, as `Monitor`'s;
    * ``is_success``: whether the episode was a success, for tasks that have a success;
    * ``reward_sums``: the sum of each reward term over the episode, by name;
    * ``metrics``: each metric at its end, by name;
    * ``terminations``: whether each termination term was true at its end, by name;
    * ``ended_by``: ``diverged``, ``success``, ``fail``, or ``time_out``.

    The infos of all other environments are empty dicts. Returned arrays and dicts are owned by the
    caller.

    Args:
        env: A batched environment (wrapped or not) with ``autoreset_mode`` SAME_STEP.
        group: The policy's observation group.
        flatten: Whether the observation is one vector, or one image if the group is that image
            alone; otherwise it is a dict, for policies named ``MultiInputPolicy``, with an entry
            for each observation in its shape and type.
        critic_groups: Groups that the critic reads, see `asymmetric`; their entries are in the
            dict too. Empty: the critic reads what the policy reads.

    Attributes:
        actor_keys: Entries of a dict that the actor reads.
        critic_keys: Entries of a dict that the critic reads.

    Raises:
        ConfigError: If a group is empty, if the observation is to be flat and has images or several
            groups, or if the action space has no finite bounds.
        TypeError: If the environment is one of `gymnasium.make` or `make_vec` with numpy arrays.
        ValueError: If the environment does not reset in the same step.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        group: str = "policy",
        *,
        flatten: bool = True,
        critic_groups: Sequence[str] = (),
    ) -> None:
        self._require(env)
        self.env = env
        self.base = cast("BaseEnv", env.unwrapped)
        self.group = group
        self._scale = ActionScale(self.base.single_action_space)
        num_envs = self.base.num_envs
        self._observed = LearnerView(self.base, group, flatten, critic_groups)
        self.actor_keys = tuple(observation_dict(self.base, group))
        self.critic_keys = tuple(observation_dict(self.base, *(critic_groups or (group,))))
        super().__init__(num_envs, self._observed.space, self._scale.space)
        self.metadata = dict(env.metadata)
        self._has_success = self.base.judges_success
        self._start = time.time()
        self._returns = np.zeros(num_envs)
        self._action: F32 | None = None
        # A wrapper, or a class that overrides hooks, changes what `step` returns.
        self._steps_in_arrays = env is self.base and getattr(self.base, "steps_in_arrays", False)
        self._packs = self.base.device.type != "cpu"
        self.step_seconds = 0.0
        """Wall time spent in `step` so far."""

    def __repr__(self) -> str:
        """Return the task, N and the spaces, in one line, as of the batch."""
        return describe(
            type(self).__name__,
            self.base.task_name,
            f"num_envs={self.num_envs}",
            action=self.action_space,
            observation=self.observation_space,
        )

    def _require(self, env: gym.Env[Any, Any]) -> None:
        """Refuse an environment that cannot be stepped as one of Stable-Baselines3."""
        require_torch_batch(env, "SB3VecEnv")

    # -- stepping ------------------------------------------------------------------------------

    def reset(self) -> Observed:
        """Reset every environment; a seed and options set before are used once.

        Returns:
            Observations (N, K), or a dict of (N, ...).

        Raises:
            ValueError: If environments have different options, as they are reset together.
        """
        options = self._options[0]
        if any(other != options for other in self._options[1:]):
            raise ValueError("the batch is reset as one: give all environments the same options")
        obs, _ = self.env.reset(seed=self._seeds[0], options=options or None)
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        return self._observed(obs)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Take (N, A) actions in [-1, 1]; the step happens in `step_wait`.

        Raises:
            ValueError: If the shape is wrong.
        """
        self._action = self._scale(actions)

    def step_wait(self) -> tuple[Observed, F32, Bool, Infos]:
        """Step all environments.

        Returns:
            Observations as of `reset`, from after the reset if an episode ended; rewards (N,);
            dones (N,); N infos.

        Raises:
            RuntimeError: If `step_async` was not called before.
            ValueError: If the shape of the actions is wrong or an action is not finite.
        """
        if self._action is None:
            raise RuntimeError("step_wait needs the actions that step_async takes")
        start = time.perf_counter()
        action = self._action
        self._action = None
        observed, rewards, terminated, truncated, final = self._step(action)
        dones = terminated | truncated
        self._returns[...] = self._returns + rewards  # quicker than in place for one number
        # New dicts: if they shared one, a callback's write to it would appear in all environments
        # and steps. 20 ns each, well below 1 % of a step.
        infos: Infos = [{} for _ in range(self.num_envs)]
        if final is not None:
            self._finish(infos, np.flatnonzero(dones), terminated, final)
        self.step_seconds += time.perf_counter() - start
        return observed, rewards, dones, infos

    def _step(self, action: F32) -> tuple[Observed, F32, Bool, Bool, _Final | None]:
        """Step all environments; what ended is None where no episode did."""
        if self._steps_in_arrays:
            result = self.base.step_arrays(action)
            final = None
            if result.final_obs is not None:
                final = _Final(result.final_obs, {key: getattr(result, key) for key in _FINAL_KEYS})
            # A copy: learners add bootstrapped values to the rewards in place.
            rewards = result.reward.copy()
            return self._observed(result.obs), rewards, result.terminated, result.truncated, final
        obs, reward, terminated, truncated, info = self.env.step(
            torch.from_numpy(action).to(self.base.device)
        )
        arrays = self._on_host(obs, reward, terminated, truncated)
        ended = not none_set(arrays[2]) or not none_set(arrays[3])
        return *arrays, _Final(info["final_obs"], info["final_info"]) if ended else None

    def _on_host(
        self, obs: Any, reward: Any, terminated: Any, truncated: Any
    ) -> tuple[Observed, F32, Bool, Bool]:
        """Return the tensors of a step as arrays; those on another device by one copy."""
        if self._packs:
            # Numbers as keys: no entry of an observation has one.
            tensors = self._observed.tensors(obs) | {0: reward, 1: terminated, 2: truncated}
            arrays = on_host(tensors)
            return self._observed.named(arrays), arrays[0], arrays[1], arrays[2]
        # A copy: learners add bootstrapped values to the rewards in place.
        rewards: F32 = as_array(reward).copy()
        return self._observed(obs), rewards, as_array(terminated), as_array(truncated)

    def _finish(
        self, infos: Infos, ids: NDArray[np.int64], terminated: Bool, final: _Final
    ) -> None:
        """Fill the infos of environments whose episode ended, and begin the next one's counts."""
        final_info = final.info
        observations = _rows(self._observed(final.obs), ids)
        success = as_array(final_info["success"]) if self._has_success else None
        lengths = as_array(final_info["elapsed_steps"])
        seconds = round(time.time() - self._start, 6)
        causes = _ended_by(final_info, ids)
        reward_sums = _by_name(final_info["episode_sums"], ids)
        metrics = _by_name(final_info["metrics"], ids)
        terminations = _by_name(self.base.termination_manager.values, ids)
        for k, (observation, i) in enumerate(zip(observations, ids.tolist(), strict=True)):
            env_info = infos[i]
            env_info["terminal_observation"] = observation
            env_info["TimeLimit.truncated"] = not terminated[i]
            env_info["episode"] = {
                "r": float(self._returns[i]),
                "l": int(lengths[i]),
                "t": seconds,
            }
            env_info["reward_sums"] = reward_sums[k]
            env_info["metrics"] = metrics[k]
            env_info["terminations"] = terminations[k]
            env_info["ended_by"] = causes[k]
            if success is not None:
                env_info["is_success"] = bool(success[i])
        self._returns[ids] = 0.0

    def state_dict(self) -> dict[str, Any]:
        """Return copies of this object's counters; the environment has a separate `state_dict`."""
        return {"returns": self._returns.copy()}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the counters from a `state_dict`."""
        self._returns[:] = saved["returns"]

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Choose the seed of the next `reset`.

        Args:
            seed: The batch's seed: environment *i* draws from streams of (seed, i). None draws one.

        Returns:
            ``[seed, seed + 1, ...]``: one entry per environment, as in other vector environments.
        """
        if seed is None:
            seed = int(np.random.default_rng().integers(2**32))
        return super().seed(seed)

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return a picture (H, W, 3) of each environment; None without ``render_mode``.

        Raises:
            RenderError: If no OpenGL library works; names the package to install.
        """
        if self.render_mode != "rgb_array":
            return [None] * self.num_envs
        require_open(self.base.is_closed)
        return list(self.base.sim.render(None))

    # -- recorded episodes -----------------------------------------------------------------------

    def recorded_view(self, entries: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return recorded observations as this environment gives them, see `LearnerView.recorded`.

        Raises:
            ValueError: If an entry is missing or has another shape.
        """
        return self._observed.recorded(entries)

    def recorded_actions(self, actions: NDArray[Any]) -> F32:
        """Return actions (T, A) of the task in [-1, 1].

        Raises:
            ValueError: If the shape is wrong.
        """
        return self._scale.inverse(actions)

    # -- attributes and methods of the batched environment -------------------------------------

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute for each selected environment.

        Args:
            attr_name: An attribute of the batched environment. Spaces are the learner's, of one
                environment.
            indices: The environments; None is all.

        Returns:
            The rows of an array or tensor (N, ...); any other value, which the environments share,
            repeated.
        """
        owner = self if attr_name in ("observation_space", "action_space") else self.env
        return self._split(_lookup(owner, attr_name), self._ids(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the batched environment.

        Args:
            attr_name: The attribute's name.
            value: The value; with `indices`, that of each row.
            indices: Rows of an existing array (N, ...); None sets the attribute itself.

        Raises:
            ValueError: If `indices` are given for an attribute that environments share.
        """
        ids = self._ids(indices)
        if len(ids) == self.num_envs:
            setattr(self.base, attr_name, value)
            return
        current = getattr(self.base, attr_name)
        if not self._has_rows(current):
            raise ValueError(f"environments share {attr_name!r}: it cannot be set for {ids} alone")
        current[ids] = value

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the batched environment once.

        Args:
            method_name: The method's name.
            *method_args: Positional arguments.
            indices: The environments, for methods with a parameter ``env_ids``; None is all.
            **method_kwargs: Keyword arguments.

        Returns:
            One result for each selected environment, see `get_attr`.

        Raises:
            ValueError: If `indices` are given but the method acts on all environments.
        """
        method = _lookup(self.env, method_name)
        ids = self._ids(indices)
        if len(ids) == self.num_envs:
            return self._split(method(*method_args, **method_kwargs), ids)
        if "env_ids" not in inspect.signature(method).parameters:
            raise ValueError(f"{method_name!r} acts on all environments: it takes no env_ids")
        result = method(*method_args, env_ids=np.asarray(ids), **method_kwargs)
        if isinstance(result, (np.ndarray, torch.Tensor)) and result.shape[:1] == (len(ids),):
            return list(result)
        return [result] * len(ids)

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Indices = None
    ) -> list[bool]:
        """Return whether each environment is wrapped; True for `Monitor`, whose infos are here."""
        wrapped = issubclass(wrapper_class, Monitor) or is_wrapped(self.env, wrapper_class)
        return [wrapped] * len(self._ids(indices))

    def _ids(self, indices: Indices) -> list[int]:
        return [range(self.num_envs)[i] for i in self._get_indices(indices)]

    def _has_rows(self, value: Any) -> bool:
        """Whether a value is an array with one row for each environment."""
        if not isinstance(value, (np.ndarray, torch.Tensor)):
            return False
        return tuple(value.shape[:1]) == (self.num_envs,)

    def _split(self, value: Any, ids: list[int]) -> list[Any]:
        if self._has_rows(value):
            return [value[i] for i in ids]
        return [value] * len(ids)


def _lookup(owner: Any, name: str) -> Any:
    """Return an attribute of an environment or of the environment that it wraps."""
    if isinstance(owner, gym.Env):
        return owner.get_wrapper_attr(name)
    return getattr(owner, name)


def _rows(observed: Observed, ids: NDArray[np.int64]) -> Iterable[Any]:
    """Return the observations of the environments `ids`, one by one."""
    if not isinstance(observed, dict):
        return observed[ids]
    entries = {name: entry[ids] for name, entry in observed.items()}
    return [{name: entry[k] for name, entry in entries.items()} for k in range(len(ids))]


def _by_name(values: Mapping[str, torch.Tensor], ids: NDArray[np.int64]) -> list[dict[str, Any]]:
    """Convert name -> (N,) values to one dict of plain values for each environment of `ids`."""
    columns = {name: as_array(value)[ids].tolist() for name, value in values.items()}
    return [{name: column[k] for name, column in columns.items()} for k in range(len(ids))]


def _ended_by(info: Mapping[str, Any], ids: NDArray[np.int64]) -> list[str]:
    """Return the cause of the end for each environment of `ids`: ``time_out`` without a flag."""
    flags = {cause: as_array(info[key])[ids] for cause, key in ENDS.items() if key}
    return np.select(list(flags.values()), list(flags), "time_out").tolist()
