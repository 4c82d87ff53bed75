"""`EnvAssembly`: building an environment - scene, managers, spaces, first observation.

What the config declares is added by `declared.py`; what happens afterwards is in `base_env.py`.
"""

from __future__ import annotations

import logging
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from embodichain.lab.gym.envs.actions import ActionCheck
from embodichain.lab.gym.envs.basics import EnvBasics
from embodichain.lab.gym.envs.cfg import ActionTermCfg, SceneEntityCfg
from embodichain.lab.gym.envs.declared import (
    add_declared_robots,
    add_declared_scene,
    add_declared_sensors,
    set_extensions,
)
from embodichain.lab.gym.envs.divergence import StateDump
from embodichain.lab.gym.envs.hooks import overrides
from embodichain.lab.gym.envs.managers.action_manager import ActionManager
from embodichain.lab.gym.envs.managers.base import Manager
from embodichain.lab.gym.envs.managers.command_manager import CommandManager
from embodichain.lab.gym.envs.managers.curriculum_manager import CurriculumManager
from embodichain.lab.gym.envs.managers.event_manager import EventManager
from embodichain.lab.gym.envs.managers.metric_manager import MetricManager
from embodichain.lab.gym.envs.managers.observation_manager import ObservationManager
from embodichain.lab.gym.envs.managers.reward_manager import RewardManager
from embodichain.lab.gym.envs.managers.termination_manager import TerminationManager
from embodichain.lab.gym.envs.observation_memory import (
    ObservationMemory,
    as_float32,
    leaves_of,
)
from embodichain.lab.gym.utils.spaces import joint_space, observation_space
from embodichain.lab.gym.utils.tensordicts import unchecked
from embodichain.lab.sim.types import EnvObs
from embodichain.lab.sim.viewer import has_display

__all__ = ["EnvAssembly"]

logger = logging.getLogger(__name__)

# Hooks that `step` does not call unless they are overridden.
_OPTIONAL = (
    "_step_action",
    "get_reward",
    "_extend_reward",
    "check_truncated",
    "_hook_after_sim_step",
    "compute_task_state",
    "evaluate",
)


class EnvAssembly(EnvBasics):
    """Builds itself in EmbodiChain's order: robot, scene, sensors, then what needs physics.

    Attributes:
        command_manager: Command terms.
        observation_manager: Observation terms.
        event_manager: Event terms.
        action_manager: Action terms.
        reward_manager: Reward terms.
        termination_manager: Termination terms.
        metric_manager: Metric terms.
        curriculum_manager: Curriculum terms.
        managers: All of them, by section.
    """

    command_manager: CommandManager
    observation_manager: ObservationManager
    event_manager: EventManager
    action_manager: ActionManager
    reward_manager: RewardManager
    termination_manager: TerminationManager
    metric_manager: MetricManager
    curriculum_manager: CurriculumManager
    managers: dict[str, Manager[Any]]

    def _init_counters(self) -> None:
        count = self.cfg.num_envs
        self.control_step = 0
        self.max_episode_steps = self.cfg.max_episode_steps
        self.observers = []
        # EmbodiChain shares one class-level list between all environments of a process.
        self.active_joint_ids = list(type(self).active_joint_ids)
        self.sensors = {}
        self._detached_uids_for_reset = []
        self._camera_group_ids = []
        self.affordance_datas = {}
        self._elapsed = np.zeros(count, np.int32)
        self._episode_ids = np.full(count, -1, np.int64)
        self._success = np.zeros(count, np.bool_)
        self._task_success = torch.zeros(count, dtype=torch.bool)
        self._pending: NDArray[np.bool_] | None = None
        self._begun = False
        self._closed = False
        hooks = overrides(self, _OPTIONAL)
        self._steps_actions = hooks["_step_action"]
        self._pays = hooks["get_reward"]
        self._repays = hooks["_extend_reward"]
        self._truncates = hooks["check_truncated"]
        self._hooks_steps = hooks["_hook_after_sim_step"]
        self._has_task_state = hooks["compute_task_state"]
        self._judges = self._has_task_state or hooks["evaluate"]

    def _build(self, kwargs: dict[str, Any]) -> None:
        cfg, sim = self.cfg, self.sim
        self._empty_obs = unchecked({}, torch.Size([cfg.num_envs]), sim.device)
        self._drives_declared = not cfg.actions and bool(cfg.robot or cfg.robots)
        self.robot = self._setup_robot(**kwargs)
        # After each hook: what the config declares and an override left out.
        declared = add_declared_robots(sim, cfg)
        self.robot = self.robot if self.robot is not None else declared
        self._declare_actions()
        if self.robot is not None and not self.active_joint_ids:
            self.active_joint_ids = list(self.robot.active_joint_ids)
        self._prepare_scene(**kwargs)
        add_declared_scene(sim, cfg)
        own = self._setup_sensors(**kwargs) or {}
        self.sensors = {**add_declared_sensors(sim, cfg), **own}
        self._senses = self.observes_sensors
        set_extensions(self, cfg.extensions)
        sim.compile()
        self._open_window()
        self._build_managers()
        self._build_actions()
        sim.reset_objects_state()
        self._init_sim_state(**kwargs)
        self.event_manager.apply("startup", None)
        sim.engine.forward()
        self._dump = StateDump(sim.engine)
        self._build_observations(kwargs)
        if cfg.sim_cfg.visualization is not None:
            cfg.sim_cfg.visualization.attach(self)

    def _declare_actions(self) -> None:
        """Let an MJCF robot be acted on through its actuators, if nothing else is said."""
        robot = self.robot
        chosen = self.active_joint_ids or getattr(self, "single_action_space", None) is not None
        if not self._drives_declared or chosen or self._steps_actions or robot is None:
            return
        parsed = robot.parsed
        passive = any(not parsed.drives[i] for i in robot.active_joint_ids)
        if parsed.own_actuators or (passive and parsed.control_names):
            params = {"entity_cfg": SceneEntityCfg(uid=robot.uid)}
            self.cfg.actions = {"ctrl": ActionTermCfg(func="actuator_ctrl", params=params)}
            self._drives_declared = False

    def _build_managers(self) -> None:
        cfg, env = self.cfg, self
        # Commands first: other terms look them up when they are built.
        self.command_manager = CommandManager(env, cfg.commands)
        self.observation_manager = ObservationManager(env, cfg.observations)
        self.event_manager = EventManager(env, cfg.events)
        self.action_manager = ActionManager(env, cfg.actions)
        self.reward_manager = RewardManager(env, cfg.rewards)
        self.termination_manager = TerminationManager(env, cfg.terminations)
        self.metric_manager = MetricManager(env, cfg.metrics)
        self.managers = {
            "commands": self.command_manager,
            "observations": self.observation_manager,
            "events": self.event_manager,
            "actions": self.action_manager,
            "rewards": self.reward_manager,
            "terminations": self.termination_manager,
            "metrics": self.metric_manager,
        }
        # It changes what the others do, so it is built with them at hand.
        self.curriculum_manager = CurriculumManager(env, cfg.curriculum)
        self.managers["curriculum"] = self.curriculum_manager
        self._has_curriculum = len(self.curriculum_manager) > 0
        self._resetting = [manager for manager in self.managers.values() if len(manager)]
        self._observes = len(self.observation_manager) > 0
        self._has_events = len(self.event_manager) > 0
        self._acts = len(self.action_manager) > 0
        self._has_commands = len(self.command_manager) > 0
        self._has_rewards = len(self.reward_manager) > 0

    def _build_actions(self) -> None:
        joints, robot, count = self.active_joint_ids, self.robot, self.cfg.num_envs
        everything = robot is None or joints == list(range(robot.dof))
        self._joints = None if everything else np.asarray(joints, np.int64)
        actions = self.action_manager
        if len(actions):
            self.single_action_space = gym.spaces.Box(actions.low, actions.high, dtype=np.float32)
        elif getattr(self, "single_action_space", None) is None:
            self.single_action_space = (
                gym.spaces.Box(0.0, 0.0, (0,), np.float32)
                if robot is None
                else joint_space(robot, joints)
            )
        space = self.single_action_space
        self.action_space = batch_space(space, count)
        self._check_action = ActionCheck(space, count, self.device)
        self._last_action = np.zeros((count, gym.spaces.utils.flatdim(space)))

    def _build_observations(self, kwargs: dict[str, Any]) -> None:
        count = self.cfg.num_envs
        saved = self.streams.state_dict()
        first = self._observed(kwargs)
        self._wide_obs = any(
            leaf.is_floating_point() and leaf.dtype != torch.float32
            for leaf in leaves_of(first).values()
        )
        as_float32(first)
        self._check_terms(first)
        self.streams.load_state_dict(saved)  # looking once does not count
        self._memory = ObservationMemory(first, count)
        self.single_observation_space = observation_space(first)
        self.observation_space = batch_space(self.single_observation_space, count)

    def _open_window(self) -> None:
        if self.cfg.sim_cfg.headless:
            return
        if has_display():
            self.sim.open_window(self.cfg.sim_cfg.window_env)
            return
        logger.warning("headless is False but there is no display here: running headless")
        self.cfg.sim_cfg.headless = True

    def _observed(self, kwargs: dict[str, Any]) -> EnvObs:
        """Defined in `outcome.py`."""
        raise NotImplementedError

    def _check_terms(self, obs: EnvObs) -> None:
        """Defined in `outcome.py`."""
        raise NotImplementedError
