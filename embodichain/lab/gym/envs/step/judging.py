"""Results of a step: success and failure, rewards, divergence, and which episodes end.

`StepJudge` calls the hooks and managers of an environment; the functions work on arrays (N,).
`StateDump` writes the states of environments that diverged to files.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.terms.term_errors import (
    finite_physics,
    kind_of_values,
    listed,
    present_step,
    warn_not_finite,
)
from embodichain.lab.gym.envs.managers.value_managers import check_values
from embodichain.lab.gym.envs.step.step_result import StepResult, none_set
from embodichain.utils.array_types import EnvIds, host_ids
from embodichain.utils.arrays import all_finite, as_env_ids, is_host, tensor_of
from embodichain.utils.system.atomic import atomic_file

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.action_manager import ActionManager
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.gym.envs.managers.manager import CurriculumManager
    from embodichain.lab.gym.envs.managers.observation_manager import ObservationManager
    from embodichain.lab.gym.envs.managers.random_managers import CommandManager
    from embodichain.lab.gym.envs.managers.value_managers import (
        MetricManager,
        RewardManager,
        TerminationManager,
    )
    from embodichain.lab.gym.envs.step.episodes import Episodes
    from embodichain.lab.sim.engine.api import Engine
    from embodichain.lab.sim.types import EnvObs
    from embodichain.utils.array_types import Floats
    from embodichain.utils.arrays import Arrays

__all__ = [
    "JudgingHooks",
    "StateDump",
    "StepJudge",
    "as_mask",
    "bad_rows",
    "reset_ids",
    "task_state",
]

Mask = NDArray[np.bool_]
F32 = NDArray[np.float32]
Info = dict[str, Any]
_TAKE_OBS = ("get_reward", "_extend_reward", "check_truncated")
_MAKE_INFO = ("compute_task_state", "evaluate", "get_info")
_TAKE_INFO = ("get_reward", "_extend_reward", "check_truncated", "_hook_after_sim_step")
_OBSERVE = ("get_obs", "_extend_obs", "_get_sensor_obs")
_ZERO = np.float32(0.0)
_ID_KEYS = ("reset_ids", "env_ids", "env_idx", "reset_mask")


def task_state(state: Any, num_envs: int, name: str) -> dict[str, Any]:
    """Return entries of ``info`` from the result of `compute_task_state`.

    Args:
        state: Success (N,), failure (N,) and metrics by name.
        num_envs: N.
        name: The method, for messages.

    Raises:
        TypeError: If it is not three values.
        ValueError: If a metric is not (N,).
    """
    if not isinstance(state, tuple) or len(state) != 3:
        raise TypeError(f"{name} must return (success, fail, metrics), got {state!r}")
    success, fail, metrics = state
    copies = {name: torch.as_tensor(value).detach().clone() for name, value in metrics.items()}
    for metric, value in copies.items():
        if value.shape != (num_envs,):
            raise ValueError(f"metric {metric!r} must be ({num_envs},), got {tuple(value.shape)}")
    return {"success": success, "fail": fail, "metrics": copies}


def checked_reward(reward: Any, num_envs: int, hook: str, arrays: Arrays) -> NDArray[np.float32]:
    """Return a copy of a hook's result as (N,) float32.

    Raises:
        ValueError: If it is not a tensor (N,); names the hook.
    """
    if not isinstance(reward, torch.Tensor) or reward.shape != (num_envs,):
        kind = tuple(reward.shape) if hasattr(reward, "shape") else type(reward).__name__
        raise ValueError(f"{hook} must return a tensor of shape ({num_envs},), got {kind}")
    return arrays.of(reward).astype(np.float32)


def as_mask(value: Any, num_envs: int, what: str, arrays: Arrays) -> Mask:
    """Return a mask (N,) as a new array; None is all False.

    Raises:
        ValueError: If it is not (N,); (N, 1) is refused too, because it would broadcast.
    """
    if value is None:
        return arrays.full(num_envs, False, np.bool_)
    array = arrays.of(value)
    if array.shape != (num_envs,):
        raise ValueError(f"{what} must have shape ({num_envs},), got {array.shape}")
    return array.astype(np.bool_)


def reset_ids(options: dict[str, Any], num_envs: int) -> EnvIds:
    """Remove the environments to reset from the options of `reset`, and return them.

    Args:
        options: ``reset_ids``, ``env_ids``, ``env_idx`` and ``reset_mask`` are removed from it.
        num_envs: N.

    Returns:
        (n,); all of them if none is named.

    Raises:
        ValueError: If two of these options are given, or the indices or the mask are invalid.
    """
    selections = {key: options.pop(key) for key in _ID_KEYS if key in options}
    if len(selections) > 1:
        raise ValueError(f"give one of {', '.join(selections)}, not several")
    for key, value in selections.items():
        try:
            ids = as_env_ids(value, num_envs)
        except ValueError as error:
            raise ValueError(f"options[{key!r}]: {error}") from error
        if ids is not None:
            return host_ids(ids)
    return np.arange(num_envs)


def bad_rows(values: NDArray[np.floating[Any]]) -> Mask | None:
    """(N,) rows of (N,) or (N, W) with a number that is not finite; None if there is none.

    On a device it is always a mask.
    """
    if is_host(values):
        if all_finite(values):
            return None
        return ~np.isfinite(values).reshape(len(values), -1).all(axis=1)
    largest = np.abs(values) if values.ndim == 1 else np.abs(values).max(axis=1)
    # The largest of NaN and others is NaN.
    return ~(largest < np.inf)


@dataclass(frozen=True)
class JudgingHooks:
    """The hooks of an environment's class that judge a step.

    Attributes:
        overridden: Names of the optional hooks that the class overrides.
        get_info: Returns the entries of ``info`` that the class makes.
        get_reward: Returns (N,) rewards; None if the class does not override it.
        extend_reward: Returns (N,) rewards from those of `get_reward` and of the terms; likewise.
    """

    overridden: frozenset[str]
    get_info: Callable[..., dict[str, Any]]
    get_reward: Callable[..., torch.Tensor] | None
    extend_reward: Callable[..., torch.Tensor] | None

    @property
    def any_makes_info(self) -> bool:
        """Whether the class may put entries into ``info`` that terms read."""
        return not self.overridden.isdisjoint(_MAKE_INFO)

    @property
    def any_shares_info(self) -> bool:
        """Whether a hook makes entries of ``info``, or receives it."""
        return self.any_makes_info or not self.overridden.isdisjoint(_TAKE_INFO)

    @property
    def any_takes_obs(self) -> bool:
        """Whether the observation is made before judging, for these hooks.

        It is made before judging too where a class has both hooks that observe and hooks that
        judge: the latter may read what the former have stored, as in EmbodiChain.
        """
        if not self.overridden.isdisjoint(_TAKE_OBS):
            return True
        return self.any_makes_info and not self.overridden.isdisjoint(_OBSERVE)


class StepJudge:
    """Evaluates a step after its physics.

    Args:
        env: The environment.
        hooks: The hooks of its class.
        episodes: Its counters.
        actions: Its action manager; the others are its managers likewise.
        commands: Commands.
        observations: Observations.
        terminations: Terminations.
        metrics: Metrics.
        rewards: Rewards.
        curriculum: Curricula.

    Attributes:
        hooks_share_info: Whether a hook makes entries of ``info``, or receives it.
        nowhere: (N,) a mask without a flag; on the host nothing can be written to it.
    """

    def __init__(
        self,
        env: TermContext,
        hooks: JudgingHooks,
        *,
        episodes: Episodes,
        actions: ActionManager,
        commands: CommandManager,
        observations: ObservationManager,
        terminations: TerminationManager,
        metrics: MetricManager,
        rewards: RewardManager,
        curriculum: CurriculumManager,
    ) -> None:
        self._env = env
        self._arrays = env.arrays
        self._num_envs = env.num_envs
        self._is_on_host = not env.arrays.on_device
        self._never_ends = self._is_on_host and not terminations.terms
        self.nowhere = self._no_flags()
        if self._is_on_host:
            self.nowhere.setflags(write=False)  # several results have it
        self._hooks = hooks
        self._episodes = episodes
        self._actions = actions
        self._commands = commands
        self._observations = observations
        self._terminations = terminations
        self._metrics = metrics
        self._rewards = rewards
        self._curriculum = curriculum
        # Environments whose physics diverged in the last step.
        self._physics_diverged: Mask | None = None
        self._warning_counts: dict[str, int] = {}
        self._hooks_take_obs = hooks.any_takes_obs
        self.hooks_share_info = hooks.any_shares_info

    @property
    def not_finite_terms(self) -> dict[str, int]:
        """Terms that were NaN or infinite beside finite physics -> in how many steps."""
        return dict(self._warning_counts)

    @property
    def obs_is_needed(self) -> bool:
        """Whether a hook or a term takes the observation, which is then made before judging."""
        return (
            self._hooks_take_obs
            or self._terminations.takes_obs
            or self._metrics.takes_obs
            or self._rewards.takes_obs
        )

    @property
    def info_is_needed(self) -> bool:
        """Whether a hook or a term reads ``info`` within the step: only then it is made there."""
        return (
            self.hooks_share_info
            or self._terminations.takes_info
            or self._metrics.takes_info
            or self._rewards.takes_info
        )

    def check_terms(self, obs: EnvObs) -> None:
        """Call every term once and check its shape, unless terms may read info of a class's hooks.

        Raises:
            ConfigError: If a term's value is not (N,); names the term.
        """
        if not self._hooks.any_makes_info:
            check_values(self._env, obs)

    def judge(self, obs: Any, action: Any, kwargs: dict[str, Any]) -> StepResult:
        """Judge the step: by the class's hooks, then terminations, metrics and rewards.

        `success` is the metric `success` of a task that has one, above 0, and else what
        `success_terminated` is: a termination of kind success, or the class's success. Only the
        latter ends episodes.

        Args:
            obs: The observation, or None if nothing takes it (`obs_is_needed`).
            action: The action that rewards receive.
            kwargs: Those of `step`.
        """
        info = self._class_info(kwargs) if self.info_is_needed else None
        result = self._outcome(obs, action, info)
        self._episodes.success = result.success
        result.reward = self._reward(obs, action, info)
        result.rewards = self._rewards.values
        result.episode_sums = self._rewards.episode_sums
        return result

    def _class_info(self, kwargs: dict[str, Any]) -> Info:
        """Return the entries of ``info`` that the class makes."""
        with self._episodes.counting(present=False):
            class_info = self._hooks.get_info(**kwargs)
        # EmbodiChain's is not a dict.
        info = class_info if type(class_info) is dict else dict(class_info.items())
        info["elapsed_steps"] = self._env.elapsed_steps
        return info

    def _outcome(self, obs: Any, action: Any, info: Info | None) -> StepResult:
        """Return the result with terminations and metrics, added to ``info`` where it is made."""
        if info is None and self._never_ends:
            result = self._without_ends()
        else:
            result = self._ends(obs, action, info)
        result.metrics = self._metrics.compute(obs, action, info)
        if self._actions.has_metrics:
            self._actions.report(result.metrics)
        if self._commands.has_metrics:
            self._commands.report(result.metrics)
        if self._curriculum.terms:
            result.curriculum = dict(self._curriculum.values)
        if info is not None:
            self._complete(info, result)
            # The metric `success`, declared or of the class, has replaced it.
            result.success = self._arrays.of(info["success"]).copy()
        elif "success" in result.metrics:
            result.success = result.metrics["success"] > _ZERO
        return result

    def _without_ends(self) -> StepResult:
        """Return the result of a task without terminations and hooks."""
        return StepResult(
            success_terminated=self.nowhere,
            fail=self.nowhere,
            time_out=None,
            success=self.nowhere,
            metrics={},
            curriculum={},
            class_info=None,
            terminations=self._terminations.values,
        )

    def _ends(self, obs: Any, action: Any, info: Info | None) -> StepResult:
        """Return the result with what ends episodes: the class's success and terminations."""
        env = self._env
        class_masks: dict[str, Mask] = {}
        if info is not None:
            for kind in ("success", "fail"):
                class_masks[kind] = as_mask(info.get(kind), env.num_envs, kind, env.arrays)
        masks = self._terminations.compute(obs, action, info)
        success = self._either(masks.get("success"), class_masks.get("success"))
        fail = self._either(masks.get("fail"), class_masks.get("fail"))
        if info is not None:
            info["success"] = tensor_of(success.copy())
            info["fail"] = tensor_of(fail.copy())
            info["success_terminated"] = tensor_of(success.copy())
        return StepResult(
            success_terminated=success,
            fail=fail,
            time_out=masks.get("time_out"),
            success=success,
            metrics={},
            curriculum={},
            class_info=info,
            terminations=self._terminations.values,
        )

    def _either(self, mask: Mask | None, other: Mask | None) -> Mask:
        """(N,) where either of two masks is set; None is a mask without a flag."""
        if mask is None:
            return self._no_flags() if other is None else other
        return mask if other is None else mask | other

    def _no_flags(self) -> Mask:
        return self._arrays.full(self._num_envs, False, np.bool_)

    def _complete(self, info: Info, result: StepResult) -> None:
        """Add what is judged beside the terms to ``info``."""
        metrics = info["metrics"]
        for name, values in result.metrics.items():
            if name not in metrics:
                metrics[name] = tensor_of(values)
        if result.curriculum:
            info["curriculum"] = result.curriculum

    def _reward(self, obs: Any, action: Any, info: Info | None) -> F32:
        """(N,) rewards of `get_reward`, plus those of the terms, after `_extend_reward`."""
        env = self._env
        hooks = self._hooks
        class_reward = None
        if hooks.get_reward is not None and info is not None:
            with self._as_class_counts(info):
                value = hooks.get_reward(obs, action, info)
            class_reward = checked_reward(value, env.num_envs, "get_reward", env.arrays)
        reward = self._rewards.compute(class_reward, obs, action, info)
        if hooks.extend_reward is not None and info is not None:
            with self._as_class_counts(info):
                value = hooks.extend_reward(tensor_of(reward), obs, action, info)
            reward = checked_reward(value, env.num_envs, "_extend_reward", env.arrays)
        return reward

    @contextmanager
    def _as_class_counts(self, info: Info) -> Iterator[None]:
        """Let ``elapsed_steps`` be without the present step, as EmbodiChain's hooks count."""
        elapsed_steps = info["elapsed_steps"]
        with self._episodes.counting(present=False):
            info["elapsed_steps"] = self._env.elapsed_steps
            yield
        info["elapsed_steps"] = elapsed_steps

    def diverged(self, result: StepResult) -> Mask | None:
        """(N,) environments that diverged in this step, or None; without those pending a reset."""
        self._physics_diverged = self._env.sim.engine.take_diverged()
        mask = self._physics_diverged
        may_be_none = mask is None and self._is_on_host
        if may_be_none and all_finite(result.obs.rows) and all_finite(result.reward):
            return None  # as almost always
        for bad in (bad_rows(result.obs.rows), bad_rows(result.reward)):
            if bad is not None:
                mask = bad if mask is None else mask | bad
        if mask is None:
            return None
        if self._episodes.pending is not None:
            mask = mask & ~self._episodes.pending
        return None if none_set(mask) else mask

    def explain(self, mask: Mask, result: StepResult) -> None:
        """Log why environments (N,) of `diverged` are: their physics, or which terms.

        A term is only named where the physics is finite. With arrays on a device nothing is logged:
        it is not known there whether an environment is in the mask.
        """
        env = self._env
        if not is_host(mask):
            return
        is_physics_finite = finite_physics(env)
        if self._physics_diverged is not None:
            is_physics_finite = is_physics_finite & ~self._physics_diverged
        diverged_physics = mask & ~is_physics_finite
        rest = mask & is_physics_finite
        if diverged_physics.any():
            ids = np.flatnonzero(diverged_physics)
            text = "%s: %d of %d environments diverged (%s); they end and are reset"
            logger.warning(text, present_step(env), len(ids), len(mask), listed(ids))
        if not rest.any():
            return
        # Name of a term -> what its values are, and in which environments.
        causes = self._commands.not_finite(rest)
        causes |= self._observations.not_finite(result.obs, rest)
        causes |= self._rewards.not_finite(rest)
        for _, explained in causes.values():
            rest = rest & ~explained
        if rest.any():
            causes["the sum of the rewards"] = (kind_of_values(result.reward[rest]), rest)
        what = "their physics is finite; they end and are reset"
        warn_not_finite(env, causes, what, self._warning_counts)

    def exclude(self, mask: Mask, result: StepResult) -> None:
        """Remove environments (N,) that diverged from a result, and their step from the sums."""
        result.exclude(mask)
        self._rewards.take_back(mask)
        result.episode_sums = self._rewards.episode_sums
        if result.class_info is not None:
            result.class_info["episode_sums"] = result.episode_sums
        self._episodes.success = self._episodes.success & ~mask


MAX_DUMPS = 10
"""Most files of a run: a task that always diverges would fill the disk."""

logger = logging.getLogger(__name__)


class StateDump:
    """Copies the rows before physics, and writes those of environments that diverge to files.

    Args:
        engine: The simulations.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._before: Floats = engine.rows.copy()
        self._written = 0

    def keep(self) -> None:
        """Copy all rows before physics steps."""
        np.copyto(self._before, self._engine.rows)

    def write(self, folder: Path | None, mask: Mask, control_step: int, action: Floats) -> None:
        """Write the first `MAX_DUMPS` environments that diverged to files.

        A file ``diverged/step_S_env_I.npz`` contains the integration state ``before`` and ``after``
        the physics of that control step, the ``action`` (A,) as given, and the ``model.FIELD``
        values of that environment.

        Args:
            folder: The run's folder; None writes nothing.
            mask: (N,) bool, environments that diverged.
            control_step: Number of the step, from 0, as in a log of this run.
            action: (N, A).
        """
        ids = np.flatnonzero(mask)
        if folder is None or self._written >= MAX_DUMPS:
            return
        fields = self._engine.state_dict()["model"]
        target = folder / "diverged"
        target.mkdir(parents=True, exist_ok=True)
        for env_id in ids[: MAX_DUMPS - self._written]:
            path = target / f"step_{control_step}_env_{env_id}.npz"
            values = {
                "before": self._before[env_id],
                "after": self._engine.rows[env_id],
                "action": action[env_id],
                **{f"model.{name}": field[env_id] for name, field in fields.items()},
            }
            with atomic_file(path) as partial:
                np.savez(partial, allow_pickle=False, **values)
            self._written += 1
