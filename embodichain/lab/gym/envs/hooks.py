"""`EnvHooks`: what a subclass of `BaseEnv` may override, each with its default.

`BaseEnv.step` and `BaseEnv.reset` say when each is called. Managers and declared entities are no
part of any hook: a subclass that overrides one without calling ``super()`` loses nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

if TYPE_CHECKING:
    from tensordict import TensorDict

    from embodichain.lab.gym.envs.cfg import EnvCfg
    from embodichain.lab.sim.objects.robot import Robot
    from embodichain.lab.sim.sim_manager import SimulationManager
    from embodichain.lab.sim.types import EnvAction, EnvObs

__all__ = ["EnvHooks", "overrides"]


class EnvHooks:
    """The overridable part of `BaseEnv`. N is the number of environments."""

    cfg: EnvCfg
    sim: SimulationManager
    robot: Robot | None
    active_joint_ids: list[int] = []
    sensors: dict[str, Any] = {}
    _success: np.ndarray[Any, np.dtype[np.bool_]]
    _drives_declared: bool = False

    # -- building ------------------------------------------------------------------------------

    def _setup_robot(self, **kwargs: Any) -> Robot | None:
        """Add the robot to ``self.sim`` and return it, or None without one.

        An override may set ``self.single_action_space``. The default adds what the config declares
        under ``robot`` and ``robots``; what an override leaves out of those is added after it.
        """
        from embodichain.lab.gym.envs.declared import add_declared_robots

        return add_declared_robots(self.sim, self.cfg)

    def _prepare_scene(self, **kwargs: Any) -> None:
        """Add everything else; called after `_setup_robot`. The default adds what is declared."""
        from embodichain.lab.gym.envs.declared import add_declared_scene

        add_declared_scene(self.sim, self.cfg)

    def _setup_sensors(self, **kwargs: Any) -> dict[str, Any]:
        """Return sensors by uid, each with ``get_data()``; called after `_prepare_scene`.

        The default adds what the config declares; so is what an override leaves out of that.
        """
        from embodichain.lab.gym.envs.declared import add_declared_sensors

        return dict(add_declared_sensors(self.sim, self.cfg))

    def _init_sim_state(self, **kwargs: Any) -> None:
        """Prepare the compiled scene once, before startup events."""

    # -- resetting -----------------------------------------------------------------------------

    def _initialize_episode(self, env_ids: torch.Tensor, **kwargs: Any) -> None:
        """Set the initial state of environments; entities are at their configured place already.

        Args:
            env_ids: (n,) int64, sorted.
            **kwargs: The other options given to `reset`.
        """

    def is_task_success(self, **kwargs: Any) -> torch.Tensor:
        """(N,) bool: whether the episode that a reset ends was a success.

        The default is ``info["success"]`` (or the metric called ``success``) of the last step.
        """
        return torch.from_numpy(self._success.copy())

    # -- stepping ------------------------------------------------------------------------------

    def _preprocess_action(self, action: EnvAction) -> EnvAction:
        """Return the action that is applied, from the one given to `step`."""
        return action

    def _step_action(self, action: EnvAction) -> EnvAction | None:
        """Apply an action; what is returned is the action that rewards see (None: as it was).

        The default moves a declared robot that has no action terms: a tensor (N, A) is absolute
        joint targets, a TensorDict holds any of ``qpos``, ``qvel``, ``qf``. With action terms, they
        run first and an override runs after them.
        """
        if self._drives_declared:
            from embodichain.lab.gym.envs.declared import drive_robot

            period = self.sim.sim_config.physics_dt * self.cfg.sim_steps_per_control
            drive_robot(self.robot, self.active_joint_ids, action, period)
        return action

    def _postprocess_action(self, action: EnvAction) -> EnvAction:
        """Return the action that `_hook_after_sim_step` sees; called after the rewards."""
        return action

    def _update_sim_state(self, **kwargs: Any) -> None:
        """Change the scene after physics and before the observation."""

    def _hook_after_sim_step(
        self,
        obs: EnvObs,
        action: EnvAction,
        rewards: torch.Tensor,
        dones: torch.Tensor,
        info: dict[str, Any],
        **kwargs: Any,
    ) -> None:
        """Look at a finished step before environments that are done are reset.

        Args:
            obs: The observation, final for environments that are done.
            action: From `_postprocess_action`.
            rewards: (N,) float32.
            dones: (N,) bool, terminated or truncated.
            info: As `step` returns it, but for the final entries.
            **kwargs: ``terminateds`` and ``truncateds`` (N,) bool, and what `step` was given.
        """

    # -- judging -------------------------------------------------------------------------------

    def _get_sensor_obs(self, **kwargs: Any) -> TensorDict | Mapping[str, Any]:
        """Return ``obs["sensor"]``: each sensor's data by uid.

        Called only if there are sensors. The default leaves out those whose `observe` is False.
        """
        return {u: s.get_data() for u, s in self.sensors.items() if getattr(s, "observe", True)}

    def _extend_obs(self, obs: EnvObs, **kwargs: Any) -> EnvObs:
        """Return the observation with more in it; observation terms run after this."""
        return obs

    def compute_task_state(
        self, **kwargs: Any
    ) -> tuple[torch.Tensor, torch.Tensor, dict[str, torch.Tensor]]:
        """Return success (N,) bool, failure (N,) bool, and metrics, (N,) each, by name.

        Either ends the episode. Declared terminations and metrics are added to them.
        """
        nobody = torch.zeros(len(self._success), dtype=torch.bool)
        return nobody, nobody.clone(), {}

    def evaluate(self, **kwargs: Any) -> Mapping[str, Any]:
        """Return entries of ``info``; ``success`` and ``fail``, (N,) bool, end the episode.

        They go over those of `compute_task_state`.
        """
        return {}

    def get_reward(self, obs: EnvObs, action: EnvAction, info: dict[str, Any]) -> torch.Tensor:
        """Return (N,) rewards; those of reward terms are added to them."""
        return torch.zeros(len(self._success))

    def _extend_reward(
        self, rewards: torch.Tensor, obs: EnvObs, action: EnvAction, info: dict[str, Any]
    ) -> torch.Tensor:
        """Return the rewards after a last change, reward terms included."""
        return rewards

    def check_truncated(self, obs: EnvObs, info: dict[str, Any]) -> torch.Tensor:
        """Return (N,) bool: episodes to cut off, besides those at `max_episode_steps`."""
        return torch.zeros(len(self._success), dtype=torch.bool)


def overrides(env: EnvHooks, names: Sequence[str]) -> dict[str, bool]:
    """Return which hooks a class overrides: `step` skips the defaults that do nothing."""
    return {name: getattr(type(env), name) is not getattr(EnvHooks, name) for name in names}
