"""`EnvBasics`: what everything around an environment may read - counters, clock, random numbers.

Observers attach here as well. What happens in a step or a reset is in `base_env.py`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.gym.envs.hooks import EnvHooks, overrides
from embodichain.lab.gym.envs.observers import EventRecord, StepObserver
from embodichain.lab.gym.utils.spaces import flat_space
from embodichain.lab.sim.objects._arrays import as_env_ids, to_tensor
from embodichain.lab.sim.types import EnvAction, EnvObs
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
    from embodichain.lab.sim.engine.base import EnvIndex, PhysicsEvent, Write
    from embodichain.utils.random import RandomStreams

__all__ = ["EnvBasics"]


class _EngineTap:
    """Hears the engine for an environment's observers."""

    def __init__(self, env: EnvBasics) -> None:
        self._env = env

    def on_write(self, write: Write) -> None:
        for observer in self._env.observers:
            observer.on_write(self._env, write)  # type: ignore[arg-type]

    def on_physics(self, event: PhysicsEvent) -> None:
        for observer in self._env.observers:
            observer.on_physics(self._env, event)  # type: ignore[arg-type]


class EnvBasics(EnvHooks, gym.Env[EnvObs, EnvAction]):
    """Counters, clock, random numbers and observers of N environments.

    Attributes:
        cfg: The environment's own copy of its config, what follows from other fields filled in.
        streams: The random numbers; `rand` and `randn` are the door to them.
        sim_steps_per_control: K, physics steps a control step.
        control_step: Control steps since the environment was built.
        observers: Who watches.
        run_dir: Where states of environments that diverge are written; None is nowhere.
        affordance_datas: What a task's own code hands around; no part of `state_dict` but for the
            entries that event terms write.
        rollout_buffer, action_bank: Always None, `current_rollout_step` 0: learners keep their own
            buffers here, and there are no action banks. EmbodiChain's tasks ask for them.
        single_action_space: Action space of one environment.
        single_observation_space: Observation space of one environment.
        action_space: Of all N; its samples are numpy arrays (N, A).
        observation_space: Of all N.
    """

    streams: RandomStreams
    sim_steps_per_control: int
    control_step: int
    observers: list[StepObserver]
    run_dir: Path | None
    affordance_datas: dict[str, Any]
    rollout_buffer: None = None
    current_rollout_step: int = 0
    action_bank: None = None
    single_action_space: gym.Space[Any]
    single_observation_space: gym.Space[Any]
    action_space: gym.Space[Any]
    observation_space: gym.Space[Any]
    _elapsed: NDArray[np.int32]
    _episode_ids: NDArray[np.int64]
    _last_action: NDArray[np.float64]
    _limit: int
    _limits: NDArray[np.int32]
    _senses: bool = False
    _detached_uids_for_reset: list[str]
    _camera_group_ids: list[int]
    _tap: _EngineTap | None = None

    # -- size and clock ------------------------------------------------------------------------

    @property
    def num_envs(self) -> int:
        """N."""
        return self.cfg.num_envs

    @property
    def device(self) -> torch.device:
        """Where tensors live."""
        return self.sim.device

    @property
    def physics_dt(self) -> float:
        """Seconds a physics step."""
        return self.cfg.sim_cfg.physics_dt

    @property
    def step_dt(self) -> float:
        """Seconds a control step."""
        return self.physics_dt * self.sim_steps_per_control

    @property
    def physics_frequency(self) -> float:
        """Physics steps a second."""
        return 1.0 / self.physics_dt

    @property
    def control_frequency(self) -> float:
        """Control steps a second."""
        return 1.0 / self.step_dt

    @property
    def sim_freq(self) -> float:
        """EmbodiChain's older name of `physics_frequency`."""
        return self.physics_frequency

    @property
    def control_freq(self) -> float:
        """EmbodiChain's older name of `control_frequency`."""
        return self.control_frequency

    # -- counters ------------------------------------------------------------------------------

    @property
    def max_episode_steps(self) -> int:
        """Control steps after which an episode is truncated; 2**31 - 1 is never."""
        return self._limit

    @max_episode_steps.setter
    def max_episode_steps(self, steps: int) -> None:
        if steps < 1 and steps != -1:
            raise ValueError(f"max_episode_steps must be at least 1, or -1 for never, got {steps}")
        self._limit = self.cfg.max_episode_steps = 2**31 - 1 if steps == -1 else int(steps)
        self._limits = np.asarray(min(self._limit, 2**31 - 1), np.int32)  # compared in every step

    @property
    def elapsed_steps(self) -> torch.Tensor:
        """(N,) int32 finished control steps of the current episodes; a copy."""
        return torch.from_numpy(self._elapsed.copy())

    @property
    def episode_ids(self) -> torch.Tensor:
        """(N,) int64 number of the current episode, from 0; -1 before the first reset. A copy."""
        return torch.from_numpy(self._episode_ids.copy())

    @property
    def last_action(self) -> torch.Tensor:
        """(N, A) float32 action as last given to `step`; zeros after a reset. A copy."""
        return to_tensor(self._last_action)

    @property
    def _elapsed_steps(self) -> torch.Tensor:
        """EmbodiChain's name of `elapsed_steps`, which its task classes read."""
        return self.elapsed_steps

    _cut: NDArray[np.bool_] | None = None

    def truncate(self, env_ids: EnvIndex) -> None:
        """Let environments' episodes end with the next step, as truncated: as time-outs do.

        Args:
            env_ids: (n,) which of the N.
        """
        if self._cut is None:
            self._cut = np.zeros(self.cfg.num_envs, np.bool_)
        self._cut[env_ids] = True

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

        What environment *i* draws depends on the seed, *i*, the name and how often it drew, and on
        nothing else.

        Args:
            name: The stream: one name for one purpose.
            shape: Shape of one environment's draw.
            low: Scalar, or an array that broadcasts to ``shape``.
            high: Likewise.
            env_ids: The n environments that draw (sorted unique, or a mask); None is all N.

        Returns:
            (n, *shape) float32.
        """
        ids = as_env_ids(env_ids, self.cfg.num_envs)
        return to_tensor(self.streams.uniform(name, shape, low, high, ids))

    def randn(self, name: str, shape: Sequence[int] = (), env_ids: Any = None) -> torch.Tensor:
        """Draw standard normal numbers, (n, *shape) float32; see `rand`."""
        return to_tensor(self.streams.normal(name, shape, as_env_ids(env_ids, self.cfg.num_envs)))

    # -- the scene -----------------------------------------------------------------------------

    def scene_entity(self, cfg: Any) -> ResolvedEntity:
        """Look up what a `SceneEntityCfg` (or a mapping with its keys) points at.

        Raises:
            ConfigError: If the entity, a joint or a link does not exist; lists what does.
        """
        from embodichain.lab.gym.envs.managers.scene_entity import resolve_entity

        return resolve_entity(self.sim, cfg)

    @property
    def has_sensors(self) -> bool:
        """Whether there are sensors."""
        return bool(self.sensors)

    @property
    def observes_sensors(self) -> bool:
        """Whether ``obs["sensor"]`` exists: a sensor or an overriding hook says so."""
        if overrides(self, ["_get_sensor_obs"])["_get_sensor_obs"]:
            return self.has_sensors
        return any(getattr(sensor, "observe", True) for sensor in self.sensors.values())

    def get_sensor(self, name: str) -> Any:
        """Return a sensor by uid.

        Raises:
            ConfigError: If there is none; lists the sensors.
        """
        if name not in self.sensors:
            message = f"no sensor {name!r}; there are: {', '.join(self.sensors) or 'none'}"
            raise ConfigError([Problem("", message, did_you_mean(name, self.sensors).strip())])
        return self.sensors[name]

    def add_camera_group_id(self, group_id: int) -> None:
        """Remember a camera group (EmbodiChain's renderer needs it, MuJoCo's does not)."""
        self._camera_group_ids.append(group_id)

    def add_detached_uids_for_reset(self, uids: Sequence[str]) -> None:
        """Name entities that resets leave where they are.

        Raises:
            ValueError: If an entity does not exist; lists those that do.
        """
        unknown = [uid for uid in uids if uid not in self.sim.asset_uids]
        if unknown:
            raise ValueError(f"no entities {unknown}; there are: {self.sim.asset_uids}")
        known = self._detached_uids_for_reset
        known += [uid for uid in dict.fromkeys(uids) if uid not in known]

    @property
    def flattened_observation_space(self) -> gym.spaces.Box:
        """Box of all N observations, each as one vector (N, W)."""
        return flat_space(self.observation_space, self.cfg.num_envs)

    def set_affordance(self, key: str, value: Any) -> None:
        """Keep a value in ``affordance_datas``, EmbodiChain's place for what tasks hand around."""
        self.affordance_datas[key] = value

    def get_affordance(self, key: str, default: Any = None) -> Any:
        """Return a value of ``affordance_datas``."""
        return self.affordance_datas.get(key, default)

    # -- observers -----------------------------------------------------------------------------

    def add_observer(self, observer: StepObserver) -> None:
        """Let an observer watch from now on."""
        if self._tap is None:
            self._tap = _EngineTap(self)
            self.sim.engine.listeners.append(self._tap)
        self.observers.append(observer)

    def remove_observer(self, observer: StepObserver) -> None:
        """Let an observer go; it is an error if it does not watch."""
        self.observers.remove(observer)
        if not self.observers and self._tap is not None:
            self.sim.engine.listeners.remove(self._tap)
            self._tap = None

    def log_event(
        self,
        term: str,
        mode: str,
        env_ids: EnvIndex | None,
        drawn: Mapping[str, NDArray[Any]] | None = None,
    ) -> None:
        """Tell observers that an event term fired, and what it drew."""
        if self.observers:
            record = EventRecord(term, mode, env_ids, drawn if drawn is not None else {})
            for observer in self.observers:
                observer.on_event(self, record)  # type: ignore[arg-type]
