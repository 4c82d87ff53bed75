"""`EnvOutcome`: what a step yields - observation, info, reward, who diverged, who is done.

The order in which this is asked for is in `BaseEnv.step`.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import torch

from embodichain.lab.gym.envs.assembly import EnvAssembly
from embodichain.lab.gym.envs.autoreset import blanked
from embodichain.lab.gym.envs.flags import Flags, Mask, mask_of
from embodichain.lab.gym.envs.managers.dry_run import check_shapes
from embodichain.lab.gym.envs.observation_memory import Known, as_float32
from embodichain.lab.gym.utils.tensordicts import alike
from embodichain.lab.sim.engine.base import F64, EnvIndex
from embodichain.lab.sim.objects._arrays import all_finite
from embodichain.lab.sim.types import EnvAction, EnvObs

__all__ = ["EnvOutcome"]

Info = dict[str, Any]


class EnvOutcome(EnvAssembly):
    """Observes and judges; changes nothing of the simulation."""

    _proprioception: Known | None = None

    # -- observation ---------------------------------------------------------------------------

    def get_obs(self, **kwargs: Any) -> EnvObs:
        """Observe all environments: robot, sensors, `_extend_obs`, observation terms.

        Returns:
            Batch size N; ``obs["robot"]`` holds ``qpos``, ``qvel``, ``qf``, (N, A) float32 each.
        """
        empty = self._empty_obs
        entries: dict[str, Any] = {}
        if self.robot is not None:
            self._proprioception = self.robot.proprioception(self._joints)
            qpos, qvel, qf = self._proprioception[0]
            entries["robot"] = alike(empty, {"qpos": qpos, "qvel": qvel, "qf": qf})
        obs: EnvObs = alike(empty, entries)
        if self._senses:
            obs["sensor"] = self._get_sensor_obs(**kwargs)
        extended: EnvObs | None = self._extend_obs(obs, **kwargs)
        if extended is None:
            raise TypeError(f"{type(self).__name__}._extend_obs must return the observation")
        obs = extended
        if self._observes:
            obs = self.observation_manager.compute(obs)
        self._terms_observed = True
        return obs

    def _observed(self, kwargs: dict[str, Any]) -> EnvObs:
        """`get_obs`, with observation terms even if an override left them out."""
        self._terms_observed = False
        obs = self.get_obs(**kwargs)
        if self._observes and not self._terms_observed:
            obs = self.observation_manager.compute(obs)
        return obs

    def _observe(self, kwargs: dict[str, Any], stepped: EnvIndex | None) -> EnvObs:
        """The observation as it is handed out, float32, of environments that stepped or reset."""
        self.observation_manager.stepped = stepped
        obs = self._observed(kwargs)
        return as_float32(obs) if self._wide_obs else obs

    @property
    def observation_paths(self) -> list[tuple[str, ...]]:
        """Paths of the floating point entries of an observation, in its order."""
        return list(self._memory.paths)

    # -- info ----------------------------------------------------------------------------------

    def get_info(self, **kwargs: Any) -> Info:
        """Return ``elapsed_steps`` (N,) int32, and what the class's own hooks give."""
        return {"elapsed_steps": torch.from_numpy(self._elapsed.copy()), **self._own_info(kwargs)}

    def _own_info(self, kwargs: dict[str, Any]) -> Info:
        """What the class itself says of the step."""
        if not self._has_task_state:
            return dict(self.evaluate(**kwargs))
        state: Any = self.compute_task_state(**kwargs)
        if not isinstance(state, tuple) or len(state) != 3:
            name = f"{type(self).__name__}.compute_task_state"
            raise TypeError(f"{name} must return (success, fail, metrics), got {state!r}")
        success, fail, metrics = state
        kept = {name: torch.as_tensor(value).detach().clone() for name, value in metrics.items()}
        for name, value in kept.items():
            if value.shape != (self.cfg.num_envs,):
                found = tuple(value.shape)
                raise ValueError(f"metric {name!r} must be ({self.cfg.num_envs},), got {found}")
        return {"success": success, "fail": fail, "metrics": kept, **self.evaluate(**kwargs)}

    @cached_property
    def _shows_info(self) -> bool:
        """Whether a hook or a term gets to see ``info`` before a step is over."""
        if getattr(self.get_info, "__func__", None) is not EnvOutcome.get_info:
            return True
        managers = self.termination_manager, self.metric_manager, self.reward_manager
        hooks = self._pays or self._repays or self._truncates
        return hooks or any(len(manager) for manager in managers)

    def _judge(self, obs: EnvObs, action: EnvAction, kwargs: dict[str, Any]) -> tuple[Info, Flags]:
        """Info: the class's own, then terminations, then metrics."""
        count = self.cfg.num_envs
        if self._shows_info:
            info = self.get_info(**kwargs)
            if type(info) is not dict:  # EmbodiChain's is a TensorDict
                info = dict(info.items())
        else:  # `step` puts the count of steps there
            info = {"elapsed_steps": None, **self._own_info(kwargs)}
        judged = self._shows_info or "success" in info or "fail" in info
        time_out: Mask | None = None
        if judged:
            success = mask_of(info.get("success"), count, "success")
            fail = mask_of(info.get("fail"), count, "fail")
            masks = self.termination_manager.compute(obs, action, info)
            if "success" in masks:
                success |= masks["success"].numpy()
            if "fail" in masks:
                fail |= masks["fail"].numpy()
            if "time_out" in masks:
                time_out = masks["time_out"].numpy()
        else:
            success, fail = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
        info["success"] = torch.from_numpy(success)
        info["fail"] = torch.from_numpy(fail)
        reached = self.metric_manager.compute(obs, action, info)
        if self._has_commands and self.command_manager.has_metrics:
            self.command_manager.report(info["metrics"])
        if self._has_curriculum:
            info["curriculum"] = dict(self.curriculum_manager.values)
        self._success = success.copy() if reached is None else reached.numpy().copy()
        return info, Flags(success, fail, time_out, judged)

    def _check_terms(self, obs: EnvObs) -> None:
        """Refuse terms of the wrong shape, unless they may rely on a subclass's own ``info``."""
        own = type(self)
        if not self._judges and own.get_info is EnvOutcome.get_info:
            check_shapes(self, obs)

    # -- reward --------------------------------------------------------------------------------

    def _reward(self, obs: EnvObs, action: EnvAction, info: Info) -> torch.Tensor:
        """Rewards of `get_reward`, plus those of the terms, after `_extend_reward`."""
        count = self.cfg.num_envs
        reward = torch.from_numpy(np.zeros(count, np.float32))
        if self._pays:
            reward = self._checked_reward(self.get_reward(obs, action, info), "get_reward")
        reward = self.reward_manager.compute(reward, obs, action, info)
        if self._repays:
            extended = self._extend_reward(reward, obs, action, info)
            reward = self._checked_reward(extended, "_extend_reward")
        return reward

    def _checked_reward(self, reward: Any, hook: str) -> torch.Tensor:
        count = self.cfg.num_envs
        if not isinstance(reward, torch.Tensor) or reward.shape != (count,):
            found = tuple(reward.shape) if hasattr(reward, "shape") else type(reward).__name__
            raise ValueError(f"{hook} must return a tensor of shape ({count},), got {found}")
        # A clone: the caller of `step` may keep it, the hook may reuse its own.
        return reward.detach().to(torch.float32, copy=True)

    # -- divergence ----------------------------------------------------------------------------

    def _contain(
        self, obs: EnvObs, reward: torch.Tensor, info: Info, flags: Flags, given: F64
    ) -> tuple[EnvObs, torch.Tensor, Info]:
        """Find environments that diverged, and keep what they left out of everything handed on."""
        memory = self._memory
        last, flat = memory.flat, memory.flatten(obs, self._proprioception)
        mask = self.sim.engine.take_diverged()
        bad = memory.bad_rows(flat)
        if bad is not None:
            mask = bad if mask is None else mask | bad
        if self._pays or self._repays or self._has_rewards:
            paid = reward.numpy()
            if not all_finite(paid):
                mask = ~np.isfinite(paid) if mask is None else mask | ~np.isfinite(paid)
        if mask is not None and self._pending is not None:
            mask = mask & ~self._pending  # they are being reset anyway
        if mask is not None and mask.any():
            rows = torch.from_numpy(mask)
            obs = memory.with_rows(obs, last, mask)
            flat = memory.flatten(obs)
            reward = torch.where(rows, torch.zeros(()), reward)
            info = self._quarantine(info, flags, mask, rows)
            self._dump.write(self.run_dir, mask, self.control_step, given)
        memory.flat = flat
        diverged = np.zeros(len(given), np.bool_) if flags.diverged is None else flags.diverged
        info["diverged"] = torch.from_numpy(diverged)
        return obs, reward, info

    def _quarantine(self, info: Info, flags: Flags, mask: Mask, rows: torch.Tensor) -> Info:
        """Zero what diverged environments put into ``info``; episode sums go back by one step."""
        info = blanked(info, rows)
        self.reward_manager.take_back(mask)
        info["episode_sums"] = self.reward_manager.episode_sums
        flags.success &= ~mask
        flags.fail &= ~mask
        if flags.time_out is not None:
            flags.time_out = flags.time_out & ~mask
        flags.diverged = mask
        self._success[mask] = False
        return info

    # -- the end of episodes -------------------------------------------------------------------

    def _ends(self, obs: EnvObs, info: Info, flags: Flags) -> tuple[Mask, Mask]:
        """(N,) terminated and truncated."""
        truncated: Mask = self._elapsed >= self._limits
        if flags.time_out is not None:
            truncated |= flags.time_out
        if self._cut is not None:
            truncated |= self._cut
            self._cut = None
        if self._truncates:
            count = self.cfg.num_envs
            truncated |= mask_of(self.check_truncated(obs, info), count, "check_truncated")
        if self.cfg.ignore_terminations or not flags.judged:
            terminated = np.zeros(len(truncated), np.bool_)
        else:
            terminated = flags.success | flags.fail
        if flags.diverged is not None:
            terminated |= flags.diverged
            truncated &= ~flags.diverged
        return terminated, truncated
