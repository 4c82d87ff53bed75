"""`BaseEnv`: N environments of one task, stepped together. The step contract is in `BaseEnv.step`.

What a subclass may override is in `hooks.py`, counters and random numbers in `basics.py`, building
in `assembly.py`, observing and judging in `outcome.py`. What a term computes, how physics steps and
how anything is recorded is no business of this file.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.gym.envs import restoring, seeding, state
from embodichain.lab.gym.envs.autoreset import (
    AutoresetMode,
    add_finals,
    blanked,
    instance_metadata,
    parse_mode,
)
from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.gym.envs.declared import explained, frozen_cfg
from embodichain.lab.gym.envs.drive_changes import drive_changes
from embodichain.lab.gym.envs.flags import Mask, nobody, reset_ids
from embodichain.lab.gym.envs.observers import StepRecord
from embodichain.lab.gym.envs.outcome import EnvOutcome
from embodichain.lab.gym.envs.snapshot import Snapshot, SnapshotSource
from embodichain.lab.sim.engine.base import F64
from embodichain.lab.sim.sim_manager import SimulationManager
from embodichain.lab.sim.types import EnvAction, EnvObs
from embodichain.utils.errors import ConfigError
from embodichain.utils.random import RandomStreams

__all__ = ["BaseEnv", "EmbodiedEnv"]

Step = tuple[EnvObs, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]
_ONE = np.ones((), np.int32)  # an array: a Python number is converted anew in every step


class BaseEnv(EnvOutcome):
    """N environments of one task: declared in an `EnvCfg`, or built by overriding hooks, or both.

    Observations are a `TensorDict` with batch size N and float32 entries; ``obs["robot"]`` holds
    ``qpos``, ``qvel``, ``qf`` (N, A) of the active joints. Tensors handed out belong to the caller.

    Args:
        cfg: The task; copied, so that nobody else's changes reach this environment.
        render_mode: ``rgb_array`` or None.
        autoreset_mode: SAME_STEP (the default), NEXT_STEP or DISABLED. It stands in
            ``metadata["autoreset_mode"]`` of the instance.
        num_envs: N; wins over the config's.
        run_dir: Where states of environments that diverge are written.
        **kwargs: Handed to the hooks that build.

    Raises:
        ConfigError: If the task is wrong; holds every mistake that can be found.
        DeviceError: If the device is unknown or has no engine.
    """

    metadata: dict[str, Any] = {
        "render_modes": ["rgb_array"],
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        cfg: EnvCfg | None = None,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        num_envs: int | None = None,
        run_dir: Path | None = None,
        **kwargs: Any,
    ) -> None:
        self.cfg = frozen_cfg(cfg, num_envs)
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"unknown render_mode {render_mode!r}; one of: rgb_array, None")
        self.render_mode = render_mode
        self.run_dir = run_dir
        self.sim_steps_per_control = self.cfg.sim_steps_per_control
        self.metadata = instance_metadata(self, parse_mode(autoreset_mode))
        self.metadata["render_fps"] = self.control_frequency
        self.streams = RandomStreams(seeding.first_seed(self.cfg.seed), self.cfg.num_envs)
        if self.cfg.seed is not None:
            seeding.seed_globals(self, self.streams.seed)
        self._init_counters()
        self.sim = SimulationManager(self.cfg.sim_cfg)
        self.sim.drive_changes = drive_changes(self.cfg.events)
        try:
            self._build(kwargs)
        except ConfigError as error:
            self.sim.destroy()
            raise explained(error, self) from error
        except BaseException:
            self.sim.destroy()
            raise

    # -- reset ---------------------------------------------------------------------------------

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[EnvObs, dict[str, Any]]:
        """Start new episodes.

        Curricula come first, and see the episodes that end. A reset is MuJoCo's own (velocities,
        warm start, controls, applied forces, time), then every entity's configured state,
        `_initialize_episode`, reset events, commands, and `mj_forward`.

        Args:
            seed: Starts every random stream anew, those of all N environments; also Gymnasium's
                ``np_random`` and torch's global generator.
            options: ``reset_ids`` or ``env_ids`` (sorted unique indices, or a mask (N,)), or
                ``reset_mask`` (a mask): which environments; absent is all. Everything else goes to
                `_initialize_episode`.

        Returns:
            The observation and info of all N environments; rows that were not reset are as before.

        Raises:
            ValueError: If the environments to reset are given wrongly.
        """
        options = dict(options or {})
        ids = reset_ids(options, self.cfg.num_envs)
        if seed is not None:
            seeding.reseed(self, seed)
        self._reset_rows(ids, options)
        if self._pending is not None:
            self._pending[ids] = False
        return self._observe_reset(ids, options), dict(self.get_info(**options).items())

    def _reset_rows(self, ids: NDArray[np.int64], options: dict[str, Any]) -> None:
        if not len(ids):
            return
        where = None if len(ids) == self.cfg.num_envs else ids
        self._task_success = self.is_task_success()
        if self._has_curriculum:
            self.curriculum_manager.compute(where)
        self.sim.reset_objects_state(where, excluded_uids=self._detached_uids_for_reset)
        for manager in self._resetting:
            manager.reset(where)
        self._last_action = self._last_action.copy()  # observers may keep the one of the step
        self._last_action[ids] = 0.0
        self._initialize_episode(torch.from_numpy(ids.copy()), **options)
        if self._has_events:
            self.event_manager.apply("reset", where)
        if self._has_commands:
            self.command_manager.resample(where)
        self.sim.engine.forward(where)
        self._elapsed[ids] = 0
        self._success[ids] = False
        if self._cut is not None:  # that episode has ended
            self._cut[ids] = False
        self._episode_ids[ids] += 1
        for observer in self.observers:
            observer.on_reset(self, ids)

    def _observe_reset(self, ids: NDArray[np.int64], options: dict[str, Any]) -> EnvObs:
        """The observation after a reset; other rows stay as they were last observed, to the bit."""
        memory, count = self._memory, self.cfg.num_envs
        stay = np.ones(count, np.bool_)
        stay[ids] = False
        partial = len(ids) < count
        saved = self.streams.state_dict() if partial else None
        obs = self._observe(options, ids if partial else None)
        if saved is not None:
            seeding.rewind(self.streams, saved, stay)
            obs = memory.with_rows(obs, memory.flat, stay)
        return memory.made_finite(obs, self._proprioception)

    # -- step ----------------------------------------------------------------------------------

    # A diverging environment's numbers may not fit float32: they become infinite, and are found.
    @np.errstate(over="ignore")
    def step(self, action: EnvAction, **kwargs: Any) -> Step:  # type: ignore[override]
        """Advance all environments by one control step (K physics steps).

        In this order: `_preprocess_action`; action terms, then `_step_action`; physics;
        `_update_sim_state`, interval events, commands; the observation (robot, sensors,
        `_extend_obs`, observation terms); info (`compute_task_state`, `evaluate`, terminations,
        metrics); rewards (`get_reward`, reward terms, `_extend_reward`); `_postprocess_action`;
        counters; who is terminated or truncated; `_hook_after_sim_step`. With SAME_STEP,
        environments that are done are then reset in place, and the observation returned is their
        new one. With NEXT_STEP that happens in the next step, which gives them reward 0. With
        DISABLED it is the caller's business.

        Poses, velocities and sensors are those after the last physics step and all writes; efforts
        and contact forces (``qf``) are those within the last physics step.

        An environment that diverges (a counter of MuJoCo's rises, or its observation or reward is
        not finite) is terminated with ``info["diverged"]``, reward 0 and its last finite
        observation as the final one; it touches no other.

        Args:
            action: (N, A) finite floating tensor on the environment's device, or a numpy array, or
                a TensorDict if `_step_action` takes one.
            **kwargs: Handed to the hooks.

        Returns:
            Observation; reward (N,) float32; terminated (N,) bool; truncated (N,) bool; info: a
            dict with ``elapsed_steps``, ``success``, ``fail``, ``diverged``, ``rewards``,
            ``episode_sums``, ``metrics`` (all of the step, before any reset) and what `evaluate`
            gave. If an environment was reset in place: ``final_obs`` (also ``final_observation``)
            and ``final_info``, valid in the rows where ``_final_obs`` and ``_final_info`` are True.

        Raises:
            TypeError: If the action has the wrong type.
            ValueError: If its shape or device is wrong or it is not finite; nothing was changed.
            gymnasium.error.ResetNeeded: If there was no reset yet.
        """
        action, given = self._receive(action)
        saved = None if self._pending is None else self.streams.state_dict()
        seen = self._act(self._preprocess_action(action))
        if self.run_dir is not None:
            self._dump.keep()
        self.sim.update(step=self.sim_steps_per_control)
        self._update_sim_state(**kwargs)
        stepped = None if self._pending is None else np.flatnonzero(~self._pending)
        if self._has_events:
            self.event_manager.step(stepped)
        if self._has_commands:
            self.command_manager.step(stepped)
        obs = self._observe(kwargs, stepped)
        info, flags = self._judge(obs, seen, kwargs)
        reward = self._reward(obs, seen, info)
        seen = self._postprocess_action(seen)
        obs, reward, info = self._contain(obs, reward, info, flags, given)
        self._elapsed += _ONE
        self.control_step += 1
        info["elapsed_steps"] = torch.from_numpy(self._elapsed.copy())
        terminated, truncated = self._ends(obs, info, flags)
        if saved is not None:
            reward, info = self._disregard(reward, terminated, truncated, info, saved)
        if self._hooks_steps:
            self._after_step(obs, seen, reward, terminated, truncated, info, kwargs)
        episodes = self._episode_ids.copy() if self.observers else self._episode_ids
        obs = self._autoreset(obs, info, terminated, truncated)
        if self.observers:
            flat = given, reward.numpy(), terminated, truncated, info, obs, episodes
            record = StepRecord(self.control_step, *flat)
            for observer in self.observers:
                observer.on_step(self, record)
        return obs, reward, torch.from_numpy(terminated), torch.from_numpy(truncated), info

    def _receive(self, action: EnvAction) -> tuple[EnvAction, F64]:
        if not self._begun:
            if self._episode_ids[0] < 0:
                raise gym.error.ResetNeeded("call reset() before the first step()")
            self._begun = True
        action, given = self._check_action(action)
        self._last_action = given
        return action, given

    def _act(self, action: EnvAction) -> EnvAction:
        """Apply an action; returns the one that rewards see."""
        if self._acts:
            self.action_manager.apply(action)
        if self._steps_actions or self._drives_declared:
            seen = self._step_action(action)
            return action if seen is None else seen
        return action

    def _after_step(
        self,
        obs: EnvObs,
        action: EnvAction,
        reward: torch.Tensor,
        terminated: Mask,
        truncated: Mask,
        info: dict[str, Any],
        kwargs: dict[str, Any],
    ) -> None:
        masks = {
            "terminateds": torch.from_numpy(terminated.copy()),
            "truncateds": torch.from_numpy(truncated.copy()),
        }
        dones = torch.from_numpy(terminated | truncated)
        self._hook_after_sim_step(obs, action, reward, dones, info, **masks, **kwargs)

    # -- automatic resets ----------------------------------------------------------------------

    def _disregard(
        self,
        reward: torch.Tensor,
        terminated: Mask,
        truncated: Mask,
        info: dict[str, Any],
        saved: dict[str, Any],
    ) -> tuple[torch.Tensor, dict[str, Any]]:
        """NEXT_STEP: this step does not count for environments that are to be reset in it."""
        pending = self._pending
        if pending is None:
            return reward, info
        seeding.rewind(self.streams, saved, pending)
        rows = torch.from_numpy(pending)
        terminated &= ~pending
        truncated &= ~pending
        return torch.where(rows, torch.zeros(()), reward), blanked(info, rows)

    def _autoreset(
        self, obs: EnvObs, info: dict[str, Any], terminated: Mask, truncated: Mask
    ) -> EnvObs:
        """Reset what the mode says; returns the observation with its rows replaced."""
        mode = self.metadata["autoreset_mode"]
        done = None if nobody(terminated) and nobody(truncated) else terminated | truncated
        if mode is AutoresetMode.SAME_STEP:
            if done is None:
                return obs
            add_finals(info, obs, done)
            ids = np.flatnonzero(done)
        elif mode is AutoresetMode.NEXT_STEP:
            before, self._pending = self._pending, done
            if before is None or nobody(before):
                return obs
            ids = np.flatnonzero(before)
        else:
            return obs
        self._reset_rows(ids, {})
        return self._observe_reset(ids, {})

    # -- the rest ------------------------------------------------------------------------------

    def render(self) -> NDArray[np.uint8] | None:
        """Draw environment 0 as (480, 640, 3) RGB; None unless `render_mode` is ``rgb_array``.

        Raises:
            RenderError: If no OpenGL library works here; names the package.
        """
        return self.sim.render() if self.render_mode == "rgb_array" else None

    def restore(
        self,
        log: SnapshotSource | Snapshot,
        env: int = 0,
        episode: int | None = None,
        step: int | None = None,
        env_ids: Any = None,
    ) -> tuple[EnvObs, dict[str, Any]]:
        """Go on from a recorded moment: state, model fields and counters are as they were.

        With the recorded actions the recorded states follow, to the bit, until something random
        happens: a log does not hold how far random streams have come, nor what terms remember.
        ``info["not_restored"]`` names both, as far as this task has them; they begin as at a reset.

        Args:
            log: An open log (`embodichain.recording.open`), or a snapshot that was taken of one.
            env: The recorded environment.
            episode: One of its episodes; None counts `step` from the start of the recording.
            step: Finished control steps of the episode, or of the recording; None is 0.
            env_ids: The environments here that go on from there (sorted unique, or a mask); None
                is all of them.

        Returns:
            The observation and info of all N environments; rows of others are as before.

        Raises:
            ConfigError: If there is no such moment, or it is of another scene.
        """
        return restoring.restore(self, restoring.snapshot_of(log, env, episode, step), env_ids)

    def state_dict(self) -> dict[str, Any]:
        """Return everything needed to continue to the bit (copies)."""
        return state.save(self)

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue exactly where `state_dict` was taken, in an environment of the same config.

        Raises:
            ValueError: If the number of environments differs.
        """
        state.load(self, saved)

    def close(self) -> None:
        """Tell observers, and free the simulation; does nothing the second time.

        Every observer is told and the simulation is freed, also if one of them raises.
        """
        if self._closed:
            return
        self._closed = True
        with ExitStack() as stack:  # runs all of it, last first
            # Nothing holds the engine then: its memory is free at once, not when cycles are.
            stack.callback(self.sim.destroy)
            stack.callback(self.__dict__.pop, "_dump", None)
            for observer in reversed(self.observers):
                stack.callback(observer.on_close, self)


EmbodiedEnv = BaseEnv
"""EmbodiChain's name for an environment built from its config; here every environment can be."""
