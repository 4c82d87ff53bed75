"""`EnvReads`: the readable attributes of an environment, for users, terms and observers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import torch
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import NO_LIMIT, EnvCfg
from embodichain.lab.gym.envs.closed import require_open
from embodichain.lab.gym.envs.managers.scene_entity import resolve_entity
from embodichain.lab.gym.envs.observation import flat_space
from embodichain.lab.gym.envs.observers import EngineRelay, EventRecord, StepObserver
from embodichain.lab.gym.envs.step.episodes import Episodes
from embodichain.utils.arrays import as_env_ids, tensor_of, to_tensor
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.managers.action_manager import ActionManager
    from embodichain.lab.gym.envs.managers.manager import CurriculumManager, Manager
    from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
    from embodichain.lab.gym.envs.managers.value_managers import (
        MetricManager,
        RewardManager,
        TerminationManager,
    )
    from embodichain.lab.gym.envs.observers import ObservedEnv
    from embodichain.lab.gym.envs.on_device.step_copies import StepCopies
    from embodichain.lab.gym.envs.step.observation_buffer import ObservationBuffer
    from embodichain.lab.sim.engine.api import F64, EnvIndex
    from embodichain.lab.sim.sim_manager import SimulationManager
    from embodichain.utils.arrays import Arrays
    from embodichain.utils.random import RandomStreams

__all__ = ["EnvReads"]

_SUCCESS_HOOKS = frozenset({"compute_task_state", "evaluate", "get_info"})
"""Hooks of a class that may say what success is."""


class EnvReads:
    """Size, clock, counters, random numbers and scene of N environments.

    Attributes:
        affordance_datas: Values shared by a task's code; `state_dict` contains only the entries
            that event terms write.
        rollout_buffer, action_bank: Always None, and `current_rollout_step` 0: names of EmbodiChain
            without a function here (learners have their own buffers).
    """

    affordance_datas: dict[str, Any]
    rollout_buffer: None = None
    current_rollout_step: int = 0
    action_bank: None = None
    cfg: EnvCfg
    sim: SimulationManager
    streams: RandomStreams
    episodes: Episodes
    observers: list[StepObserver]
    observation_buffer: ObservationBuffer
    sensors: dict[str, Any]
    sim_steps_per_control: int
    control_step: int
    observation_space: gym.Space[Any]
    action_manager: ActionManager
    managers: dict[str, Manager[Any]]
    curriculum_manager: CurriculumManager
    metric_manager: MetricManager
    reward_manager: RewardManager
    termination_manager: TerminationManager
    overridden: frozenset[str]
    _detached_uids: list[str]
    _closed: bool
    copies: StepCopies | None = None
    """Copies what observers see of each step, with arrays on a device; None without observers."""

    # -- size and clock ------------------------------------------------------------------------

    @property
    def num_envs(self) -> int:
        """N."""
        return self.cfg.num_envs

    @property
    def device(self) -> torch.device:
        """Device of tensors."""
        return self.sim.device

    @property
    def arrays(self) -> Arrays:
        """Makes the arrays that terms keep, where the simulation has its arrays."""
        return self.sim.arrays

    @property
    def revision(self) -> tuple[int, ...]:
        """Numbers that change when a step is computed in another way: limit, terms, model."""
        managers = (manager.revision for manager in self.managers.values())
        watched = len(self.observers)
        return self.episodes.limit, getattr(self.sim.engine, "revision", 0), watched, *managers

    @property
    def physics_dt(self) -> float:
        """Seconds per physics step."""
        return self.cfg.sim_cfg.physics_dt

    @property
    def step_dt(self) -> float:
        """Seconds per control step."""
        return self.physics_dt * self.sim_steps_per_control

    @property
    def physics_steps_per_call(self) -> int:
        """Physics steps of each physics call of a control step: all, or 1 (`ActionTerm`)."""
        return 1 if self.action_manager.acts_in_physics else self.sim_steps_per_control

    @property
    def physics_frequency(self) -> float:
        """Physics steps per second."""
        return 1.0 / self.physics_dt

    @property
    def control_frequency(self) -> float:
        """Control steps per second."""
        return 1.0 / self.step_dt

    # -- counters ------------------------------------------------------------------------------

    @property
    def max_episode_steps(self) -> int:
        """Control steps after which an episode is truncated; 2**31 - 1 is no limit."""
        return self.episodes.limit

    @max_episode_steps.setter
    def max_episode_steps(self, steps: int) -> None:
        if steps < 1 and steps != -1:
            raise ValueError(f"max_episode_steps must be at least 1, or -1 for never, got {steps}")
        limit = NO_LIMIT if steps == -1 else min(int(steps), NO_LIMIT)
        self.episodes.limit = self.cfg.max_episode_steps = limit

    @property
    def elapsed_steps(self) -> torch.Tensor:
        """(N,) int32 control steps of the current episodes; a copy.

        From the end of physics on the present step counts, wherever a term reads it. The hooks that
        observe, judge and reward (`BaseEnv.step`) see it without the present step, as in
        EmbodiChain.
        """
        return tensor_of(self.episodes.count)

    @elapsed_steps.setter
    def elapsed_steps(self, steps: torch.Tensor) -> None:
        counted, given = self.episodes.elapsed, torch.as_tensor(steps)
        if given.shape != counted.shape:
            raise ValueError(f"elapsed_steps must be {tuple(counted.shape)}, got {given.shape}")
        if not self.arrays.on_device and (given < 0).any():
            raise ValueError("elapsed_steps must not be negative")
        counted[:] = self.arrays.of(given.to(torch.int32))

    @property
    def episode_ids(self) -> torch.Tensor:
        """(N,) int64 number of the current episode, from 0; -1 before the first reset. A copy."""
        return tensor_of(self.episodes.ids.copy())

    @property
    def last_action(self) -> torch.Tensor:
        """(N, A) float32 action as last given to `step`; zeros after a reset. A copy."""
        return to_tensor(self.episodes.last_action)

    def read_last_action(self) -> F64:
        """(N, A) action as last given to `step`; do not write to it."""
        return self.episodes.last_action

    def truncate(self, env_ids: Any) -> None:
        """Truncate the episodes of environments at the next step.

        Args:
            env_ids: (n,) which of the N.
        """
        self.episodes.truncate(env_ids)

    # -- random numbers ------------------------------------------------------------------------

    @property
    def seed_value(self) -> int:
        """The seed in use."""
        return self.streams.seed

    def rand(
        self,
        name: str,
        shape: Sequence[int] = (),
        low: Any = 0.0,
        high: Any = 1.0,
        env_ids: Any = None,
    ) -> torch.Tensor:
        """Draw uniformly from [low, high), each environment from its own stream.

        The numbers of environment *i* depend only on the seed, *i*, the name and the number of its
        earlier draws.

        Args:
            name: The stream: one name for one purpose.
            shape: Shape of one environment's draw.
            low: Scalar, or an array that broadcasts to ``shape``.
            high: Likewise.
            env_ids: The n environments that draw (sorted unique, or a mask); None is all N.

        Returns:
            (n, *shape) float32.
        """
        ids = as_env_ids(env_ids, self.num_envs)
        return to_tensor(self.streams.uniform(name, shape, low, high, ids))

    def randn(self, name: str, shape: Sequence[int] = (), env_ids: Any = None) -> torch.Tensor:
        """Draw standard normal numbers, (n, *shape) float32; see `rand`."""
        return to_tensor(self.streams.normal(name, shape, as_env_ids(env_ids, self.num_envs)))

    # -- the scene -----------------------------------------------------------------------------

    def scene_entity(self, cfg: Any) -> ResolvedEntity:
        """Look up the entity of a `SceneEntityCfg` (or of a mapping with its keys).

        Raises:
            ConfigError: If the entity, a joint or a link does not exist; lists those that do.
        """
        require_open(self._closed)
        return resolve_entity(self.sim, cfg)

    @property
    def has_sensors(self) -> bool:
        """Whether there are sensors."""
        return bool(self.sensors)

    def get_sensor(self, name: str) -> Any:
        """Return a sensor by uid.

        Raises:
            ConfigError: If there is none; lists the sensors.
        """
        if name not in self.sensors:
            message = f"no sensor {name!r}; there are: {', '.join(self.sensors) or 'none'}"
            raise ConfigError([Problem("", message, did_you_mean(name, self.sensors).strip())])
        return self.sensors[name]

    def add_detached_uids_for_reset(self, uids: Sequence[str]) -> None:
        """Exclude entities from the reset of states.

        Raises:
            ValueError: If an entity does not exist; lists those that do.
        """
        unknown = [uid for uid in uids if uid not in self.sim.asset_uids]
        if unknown:
            raise ValueError(f"no entities {unknown}; there are: {self.sim.asset_uids}")
        known = self._detached_uids
        known += [uid for uid in dict.fromkeys(uids) if uid not in known]

    @property
    def observation_paths(self) -> list[tuple[str, ...]]:
        """Paths of the floating point entries of an observation, in its order."""
        return list(self.observation_buffer.layout.paths)

    @property
    def flattened_observation_space(self) -> gym.spaces.Box:
        """Box of all N observations, each as one vector (N, W)."""
        return flat_space(self.observation_space, self.num_envs)

    def curriculum_stage(self) -> dict[str, Any]:
        """The stage that the curriculum has reached (copies), for `hold_curriculum` elsewhere."""
        return self.curriculum_manager.stage_dict()

    def hold_curriculum(self, stage: Mapping[str, Any] | None = None) -> None:
        """Keep the curriculum at a stage: its terms are called no more.

        Evaluations do this, so that what they judge depends neither on their length nor on the
        number of environments. The next resets apply it to environments.

        Args:
            stage: Of `curriculum_stage`, of any number of environments; None is the present one.
        """
        require_open(self._closed)
        self.curriculum_manager.hold(stage)

    def release_curriculum(self) -> None:
        """Let the curriculum go on."""
        require_open(self._closed)
        self.curriculum_manager.release()

    @property
    def judges_success(self) -> bool:
        """Whether the task defines success: by a metric, a termination, or its class."""
        declared = self.metric_manager.has_success or self.termination_manager.has_success
        return declared or not self.overridden.isdisjoint(_SUCCESS_HOOKS)

    # -- observers -----------------------------------------------------------------------------

    def add_observer(self, observer: StepObserver) -> None:
        """Attach an observer; it is called after those attached before.

        Raises:
            ConfigError: If arrays are on the device, and it may not be called late.
        """
        require_open(self._closed)
        if self.arrays.on_device:
            if not observer.may_lag:
                self.arrays.require_host("observers that may not be called late")
            self._copied().observers.append(observer)
            return
        self._attach(observer)

    def _attach(self, observer: StepObserver) -> None:
        if not self.observers:
            self.sim.engine.listeners.append(EngineRelay(self))
        self.observers.append(observer)

    @property
    def observed(self) -> ObservedEnv:
        """What observers are called with: the environment, or with arrays on a device its copy.

        A `CopiedEnv` is made when it is first asked for; from then on each step is copied.
        """
        return self._copied() if self.arrays.on_device else self

    def _copied(self) -> Any:
        if self.copies is None:
            from embodichain.lab.gym.envs.on_device.step_copies import StepCopies

            self.copies = StepCopies(self)
            self._attach(self.copies)
        return self.copies.host

    def remove_observer(self, observer: StepObserver) -> None:
        """Detach an observer; ValueError if it is not attached."""
        found: StepObserver = observer
        if self.copies is not None:
            self.copies.flush()
            self.copies.host.observers.remove(observer)
            if self.copies.host.observers:
                return
            found, self.copies = self.copies, None
        self.observers.remove(found)
        if not self.observers:
            self.sim.engine.listeners.remove(EngineRelay(self))

    def log_event(
        self,
        term: str,
        mode: str,
        env_ids: EnvIndex | None,
        drawn: Mapping[str, NDArray[Any]] | None = None,
    ) -> None:
        """Report to observers that a term fired and what it drew."""
        if self.observers:
            record = EventRecord(term, mode, env_ids, drawn or {})
            for observer in self.observers:
                observer.on_event(self, record)

    # -- names of EmbodiChain 0.2.1 ------------------------------------------------------------

    @property
    def sim_freq(self) -> float:
        """Physics steps per second."""
        return self.physics_frequency

    @property
    def control_freq(self) -> float:
        """Control steps per second."""
        return self.control_frequency

    @property
    def _elapsed_steps(self) -> torch.Tensor:
        return self.elapsed_steps

    def add_camera_group_id(self, group_id: int) -> None:
        """Accept a camera group, which EmbodiChain's renderer needs; no effect here."""

    def set_affordance(self, key: str, value: Any) -> None:
        """Set a value of `affordance_datas`."""
        self.affordance_datas[key] = value

    def get_affordance(self, key: str, default: Any = None) -> Any:
        """Return a value of `affordance_datas`."""
        return self.affordance_datas.get(key, default)
