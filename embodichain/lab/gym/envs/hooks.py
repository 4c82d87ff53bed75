"""`EnvHooks`: the methods that a subclass of `BaseEnv` may override, each with its default.

`BaseEnv.step` and `BaseEnv.reset` document when each is called. Managers and declared entities do
not depend on hooks: an override need not call ``super()``.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import torch
from gymnasium.vector import AutoresetMode

from embodichain.lab.gym.envs.managers.action_manager import drive_robot
from embodichain.lab.gym.envs.scene_setup import (
    add_declared_robots,
    add_declared_scene,
    add_declared_sensors,
)
from embodichain.lab.gym.envs.step.judging import task_state
from embodichain.utils.arrays import tensor_of
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.cfg import EnvCfg
    from embodichain.lab.gym.envs.step.episodes import Episodes
    from embodichain.lab.gym.envs.step.observation_buffer import ObservationBuffer
    from embodichain.lab.sim.objects.robot import Robot
    from embodichain.lab.sim.sim_manager import SimulationManager
    from embodichain.lab.sim.types import EnvAction, EnvObs

__all__ = ["EnvHooks", "overridden_hooks", "set_extensions"]


class EnvHooks:
    """The overridable part of `BaseEnv`. N is the number of environments.

    Attributes:
        cfg: The environment's copy of its config, with derived values filled in.
        sim: The simulation of all N environments.
        robot: The robot, or None.
        active_joint_ids: Its joints that ``obs["robot"]`` contains and actions move.
        sensors: Sensors by uid.
        episodes: Counters of the episodes.
        observation_buffer: Makes observations.
        overridden: Names of those optional hooks that the class overrides.
        drives_robot: Whether actions are joint targets of the declared robot, without action terms.
    """

    cfg: EnvCfg
    metadata: dict[str, Any]
    sim: SimulationManager
    robot: Robot | None
    active_joint_ids: list[int] = []
    sensors: dict[str, Any] = {}
    episodes: Episodes
    observation_buffer: ObservationBuffer
    overridden: frozenset[str]
    drives_robot: bool = False

    # -- building ------------------------------------------------------------------------------

    def _setup_robot(self, **kwargs: Any) -> Robot | None:
        """Add the robot to ``self.sim`` and return it, or None without one.

        An override may set ``self.single_action_space``. The default adds what the config declares
        under ``robot`` and ``robots``; declared robots that an override does not add are added
        after it.
        """
        return add_declared_robots(self.sim, self.cfg)

    def _prepare_scene(self, **kwargs: Any) -> None:
        """Add all other entities, after `_setup_robot`. The default adds the declared ones."""
        add_declared_scene(self.sim, self.cfg)

    def _setup_sensors(self, **kwargs: Any) -> dict[str, Any]:
        """Return sensors by uid, each with ``get_data()``; called after `_prepare_scene`.

        The default adds what the config declares. Declared sensors that an override does not add
        are added after it.
        """
        return dict(add_declared_sensors(self.sim, self.cfg))

    def _init_sim_state(self, **kwargs: Any) -> None:
        """Prepare the compiled scene once, before startup events."""

    # -- resetting -----------------------------------------------------------------------------

    def _initialize_episode(self, env_ids: torch.Tensor, **kwargs: Any) -> None:
        """Set the initial state of environments; entities have their configured state before.

        Args:
            env_ids: (n,) int64, sorted.
            **kwargs: All other options of `reset`.
        """

    def is_task_success(self, **kwargs: Any) -> torch.Tensor:
        """(N,) bool: whether the episode ended by a reset was a success.

        The default is ``info["success"]`` of the last step.
        """
        return tensor_of(self.episodes.success.copy())

    # -- stepping ------------------------------------------------------------------------------

    def _preprocess_action(self, action: EnvAction) -> EnvAction:
        """Return the action to apply, from the one given to `step`."""
        return action

    def _step_action(self, action: EnvAction) -> EnvAction | None:
        """Apply an action; return the action that rewards receive (None: the same one).

        The default moves a declared robot that has no action terms: a tensor (N, A) is absolute
        joint targets, a mapping has any of ``qpos``, ``qvel``, ``qf``. With action terms, they run
        first and an override runs after them.
        """
        if self.drives_robot:
            period = self.sim.sim_config.physics_dt * self.cfg.sim_steps_per_control
            drive_robot(self.robot, self.active_joint_ids, action, period)
        return action

    def _postprocess_action(self, action: EnvAction) -> EnvAction:
        """Return the action that `_hook_after_sim_step` receives; called after the rewards."""
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
        """Process a finished step before environments that are done are reset.

        Args:
            obs: The observation, final for environments that are done.
            action: From `_postprocess_action`.
            rewards: (N,) float32.
            dones: (N,) bool, terminated or truncated.
            info: As `step` returns it, without the final entries.
            **kwargs: ``terminateds`` and ``truncateds`` (N,) bool, and the kwargs of `step`.
        """

    # -- observing -----------------------------------------------------------------------------

    @cached_property
    def observes_sensors(self) -> bool:
        """Whether ``obs["sensor"]`` exists: there is a sensor or an overriding hook."""
        if "_get_sensor_obs" in self.overridden:
            return bool(self.sensors)
        return any(getattr(sensor, "observe", True) for sensor in self.sensors.values())

    def get_obs(self, **kwargs: Any) -> EnvObs:
        """Observe all environments: robot, sensors, `_extend_obs`, observation terms.

        Returns:
            Batch size N; ``obs["robot"]`` has ``qpos``, ``qvel``, ``qf``, (N, A) float32 each.
        """
        sensors = self._get_sensor_obs(**kwargs) if self.observes_sensors else {}
        extends = "_extend_obs" in self.overridden
        extend = partial(self._extend_obs, **kwargs) if extends else None
        return self.observation_buffer.observe(sensors, extend)

    def _get_sensor_obs(self, **kwargs: Any) -> Mapping[str, Any]:
        """Return ``obs["sensor"]``: each sensor's data by uid.

        Called only if there are sensors. The default leaves out those whose `observe` is False.
        """
        return {u: s.get_data() for u, s in self.sensors.items() if getattr(s, "observe", True)}

    def _extend_obs(self, obs: EnvObs, **kwargs: Any) -> EnvObs:
        """Return the observation with entries added; observation terms run after this."""
        return obs

    # -- judging -------------------------------------------------------------------------------

    def get_info(self, **kwargs: Any) -> dict[str, Any]:
        """Return ``elapsed_steps`` (N,) int32 and the entries of the class's hooks."""
        info = {"elapsed_steps": tensor_of(self.episodes.count)}
        if "compute_task_state" in self.overridden:
            name = f"{type(self).__name__}.compute_task_state"
            info |= task_state(self.compute_task_state(**kwargs), self.cfg.num_envs, name)
        info.update(self.evaluate(**kwargs))
        return info

    def compute_task_state(
        self, **kwargs: Any
    ) -> tuple[torch.Tensor, torch.Tensor, dict[str, torch.Tensor]]:
        """Return success (N,) bool, failure (N,) bool, and metrics, (N,) each, by name.

        Either ends the episode. Declared terminations and metrics are added to them.
        """
        none = torch.zeros(self.cfg.num_envs, dtype=torch.bool, device=self.sim.device)
        return none, none.clone(), {}

    def evaluate(self, **kwargs: Any) -> Mapping[str, Any]:
        """Return entries of ``info``; ``success`` and ``fail``, (N,) bool, end the episode.

        They override those of `compute_task_state`.
        """
        return {}

    def get_reward(self, obs: EnvObs, action: EnvAction, info: dict[str, Any]) -> torch.Tensor:
        """Return (N,) rewards; those of reward terms are added to them."""
        return torch.zeros(self.cfg.num_envs, device=self.sim.device)

    def _extend_reward(
        self, rewards: torch.Tensor, obs: EnvObs, action: EnvAction, info: dict[str, Any]
    ) -> torch.Tensor:
        """Return the final rewards, from the sum that includes reward terms."""
        return rewards

    def check_truncated(self, obs: EnvObs, info: dict[str, Any]) -> torch.Tensor:
        """Return (N,) bool: episodes to truncate besides those at `max_episode_steps`."""
        return torch.zeros(self.cfg.num_envs, dtype=torch.bool, device=self.sim.device)


OPTIONAL_HOOKS = (
    *("get_obs", "_extend_obs", "_get_sensor_obs", "_step_action", "get_reward", "_extend_reward"),
    *("check_truncated", "_hook_after_sim_step", "compute_task_state", "evaluate", "get_info"),
    *("_setup_robot", "_prepare_scene", "_initialize_episode"),
)
"""Hooks with special treatment where a class does not override them: most are not called."""


def overridden_hooks(env: EnvHooks) -> frozenset[str]:
    """Return which of `OPTIONAL_HOOKS` an environment's class overrides.

    Raises:
        ConfigError: If arrays are on the device, where environments are masks, and it takes
            indices of environments, or resets in the next step.
    """
    cls, arrays = type(env), env.sim.arrays
    found = frozenset(
        name for name in OPTIONAL_HOOKS if getattr(cls, name) is not getattr(EnvHooks, name)
    )
    if "_initialize_episode" in found:
        arrays.require_host(
            f"indices of environments, which {cls.__name__}._initialize_episode takes,"
        )
    if env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP:
        arrays.require_host("steps of some environments, as of autoreset mode NEXT_STEP,")
    return found


def set_extensions(env: object, extensions: dict[str, Any]) -> None:
    """Set ``extensions`` as attributes of an environment.

    Raises:
        ConfigError: If the environment has an attribute of that name already.
    """
    taken = [key for key in extensions if not key.isidentifier() or hasattr(env, key)]
    if taken:
        raise ConfigError(
            [
                Problem(f"extensions.{key}", "taken by the environment, or not a name")
                for key in taken
            ]
        )
    for key, value in extensions.items():
        setattr(env, key, value)
