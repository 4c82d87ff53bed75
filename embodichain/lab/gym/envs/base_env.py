"""`BaseEnv`: N environments of one task, stepped together. The step contract is in `BaseEnv.step`.

The class reads from top to bottom: how it is built, reset and stepped; the hooks that a subclass
may override, each with its default; recorded moments; then what users, terms and observers read.

Its parts: `Episodes` (counters), `ObservationLayout` (columns of the observation), `judging`
(success and the end of episodes), `StepResult` (what a step computes), `scene_setup` (config to
entities), `restoring` (recorded moments), `StateDump` (environments that diverged), and the
managers of terms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, nullcontext
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import NO_LIMIT, EnvCfg
from embodichain.lab.gym.envs.closed import require_open
from embodichain.lab.gym.envs.describing import describe, warn_undrawn
from embodichain.lab.gym.envs.managers.action_manager import (
    ActionCheck,
    ActionManager,
    action_space,
    default_actions,
    drive_robot,
    is_passive,
    no_action,
)
from embodichain.lab.gym.envs.managers.manager import CurriculumManager, Manager
from embodichain.lab.gym.envs.managers.observation_manager import ObservationManager
from embodichain.lab.gym.envs.managers.random_managers import CommandManager, EventManager
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity, resolve_entity
from embodichain.lab.gym.envs.managers.value_managers import (
    MetricManager,
    RewardManager,
    TerminationManager,
)
from embodichain.lab.gym.envs.observation import Observation, flat_space, observation_space
from embodichain.lab.gym.envs.observers import (
    EngineRelay,
    EventRecord,
    ObservedEnv,
    StepObserver,
    StepRecord,
)
from embodichain.lab.gym.envs.on_device.step_graph import StepGraph
from embodichain.lab.gym.envs.restoring import restored as restoring
from embodichain.lab.gym.envs.restoring.snapshot import Snapshot, SnapshotSource
from embodichain.lab.gym.envs.restoring.startup import StartupChanges
from embodichain.lab.gym.envs.scene_setup.drive_changes import drive_changes
from embodichain.lab.gym.envs.scene_setup.frozen_cfg import frozen_cfg
from embodichain.lab.gym.envs.scene_setup.scene_building import (
    add_declared_robots,
    add_declared_scene,
    add_declared_sensors,
    open_window,
    with_all_problems,
    with_problems_of_other_terms,
)
from embodichain.lab.gym.envs.step.episodes import Episodes, parse_mode, seed_globals
from embodichain.lab.gym.envs.step.judging import (
    JudgingHooks,
    StateDump,
    StepJudge,
    as_mask,
    reset_ids,
    task_state,
)
from embodichain.lab.gym.envs.step.observation_buffer import ObservationBuffer
from embodichain.lab.gym.envs.step.step_observation import StepObservation
from embodichain.lab.gym.envs.step.step_result import StepResult, none_set
from embodichain.lab.sim.sim_manager import SimulationManager
from embodichain.lab.sim.types import EnvAction, EnvObs
from embodichain.utils.array_types import host_ids
from embodichain.utils.arrays import Arrays, as_env_ids, tensor_of, to_tensor
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.random import RandomStreams, first_seed
from embodichain.utils.suggest import did_you_mean
from embodichain.utils.uncopied import Uncopied

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.on_device.step_copies import StepCopies
    from embodichain.lab.sim.compiler.compile_scene import CompiledScene
    from embodichain.lab.sim.objects.robot import Robot
    from embodichain.utils.array_types import EnvIds, EnvIndex, Floats

__all__ = ["BaseEnv", "EmbodiedEnv"]

Step = tuple[EnvObs, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]
Mask = NDArray[np.bool_]
Info = dict[str, Any]
_SUCCESS_HOOKS = frozenset({"compute_task_state", "evaluate", "get_info"})
"""Hooks of a class that may say what success is."""


class BaseEnv(Uncopied, gym.Env[EnvObs, EnvAction]):
    """N environments of one task, declared in an `EnvCfg`, built by overridden hooks, or both.

    Observations are nested mappings of float32 tensors (N, ...), see `TensorMapping`;
    ``obs["robot"]`` has ``qpos``, ``qvel``, ``qf`` (N, A) of the active joints. Returned tensors
    are owned by the caller.

    Args:
        cfg: The task; copied.
        render_mode: ``rgb_array`` or None.
        autoreset_mode: SAME_STEP, NEXT_STEP or DISABLED; also in the instance's `metadata`.
        num_envs: N; overrides the config's.
        run_dir: Folder for the states of environments that diverge; None writes none.
        compiled_scene: The scene, compiled before from the same config (`scene_setup`);
            several environments may share it. None compiles it here, as for a class that adds
            entities in `_setup_robot`, `_prepare_scene` or `_setup_sensors`.
        **kwargs: Passed to the hooks that build the scene.

    Managers and declared entities do not depend on hooks: an override need not call ``super()``.

    Attributes:
        cfg: The environment's copy of its config, with derived values filled in.
        task_name: Name of the task in YAML that it was made of, or None.
        sim: The simulation of all N environments.
        robot: The robot, or None.
        active_joint_ids: Its joints that ``obs["robot"]`` contains and actions move.
        sensors: Sensors by uid.
        episodes: Counters of the episodes.
        observation_buffer: Makes observations.
        overridden: Names of those optional hooks that the class overrides.
        drives_robot: Whether actions are joint targets of the declared robot, without action terms.
        sim_steps_per_control: K, physics steps a control step.
        control_step: Control steps since the environment was built.
        arrays_moved: Whether code outside of steps may have replaced arrays (see `StepGraph`).
        managers: All managers by section of the config.
        single_action_space: Actions of one environment, as `single_observation_space` has its
            observations; those of all N are `action_space` and `observation_space`.
        copies: Copies what observers see of each step, with arrays on a device; None without
            observers.
        affordance_datas: Values shared by a task's code; `state_dict` contains only the entries
            that event terms write.
        rollout_buffer, action_bank: Always None, and `current_rollout_step` 0: names of EmbodiChain
            without a function here (learners have their own buffers).

    Raises:
        ConfigError: If the task is wrong; lists every mistake that can be found. Where values are
            of a wrong type, those that only the compiled scene shows come later; where these are
            values of entities, all others.
        DeviceError: If the device is unknown or has no engine.
        ValueError: If `compiled_scene` is that of another config.
    """

    metadata: dict[str, Any] = {
        "render_modes": ["rgb_array"],
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }
    task_name: str | None = None
    active_joint_ids: list[int] = []
    sensors: dict[str, Any] = {}
    drives_robot: bool = False
    copies: StepCopies | None = None
    rollout_buffer: None = None
    current_rollout_step: int = 0
    action_bank: None = None
    # Set while it is built. Events may store attributes of the environment, but under none of these
    # names.
    cfg: EnvCfg
    sim: SimulationManager
    streams: RandomStreams
    episodes: Episodes
    observers: list[StepObserver]
    overridden: frozenset[str]
    affordance_datas: dict[str, Any]
    run_dir: Path | None
    sim_steps_per_control: int
    control_step: int
    arrays_moved: bool
    robot: Robot | None
    single_action_space: gym.Space[Any]
    single_observation_space: gym.Space[Any]
    managers: dict[str, Manager[Any]]
    command_manager: CommandManager
    observation_manager: ObservationManager
    event_manager: EventManager
    action_manager: ActionManager
    reward_manager: RewardManager
    termination_manager: TerminationManager
    metric_manager: MetricManager
    curriculum_manager: CurriculumManager
    observation_buffer: ObservationBuffer

    def __init__(
        self,
        cfg: EnvCfg | None = None,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        num_envs: int | None = None,
        run_dir: Path | None = None,
        *,
        compiled_scene: CompiledScene | None = None,
        **kwargs: Any,
    ) -> None:
        self.affordance_datas = {}
        built_by_hooks = any(
            getattr(type(self), hook) is not getattr(BaseEnv, hook)
            for hook in ("_setup_robot", "_prepare_scene")
        )
        try:
            self.cfg = frozen_cfg(cfg, num_envs)
        except ConfigError as error:
            if not isinstance(cfg, EnvCfg):
                raise
            raise with_problems_of_other_terms(error, cfg, built_by_hooks) from error
        cfg = self.cfg
        if render_mode not in (None, "rgb_array"):
            hint = ""
            if render_mode == "human":
                hint = '. A window is overrides=["viewer=native"], or embodichain run viewer=web'
            raise ValueError(f"unknown render_mode {render_mode!r}; one of: rgb_array, None{hint}")
        self.render_mode = render_mode
        self.run_dir = run_dir
        self.control_step = 0
        self.sim_steps_per_control = cfg.sim_steps_per_control
        self.metadata = {**type(self).metadata, "autoreset_mode": parse_mode(autoreset_mode)}
        self.metadata["render_fps"] = self.control_frequency
        # A config from a file was checked, which has reported its values without effect.
        is_checked = cfg.key_sources is not None
        self.sim = SimulationManager(
            cfg.sim_cfg, compiled_scene=compiled_scene, checked=is_checked, types_checked=True
        )
        self.streams = self.arrays.streams(first_seed(cfg.seed), cfg.num_envs, cfg.first_env)
        if cfg.seed is not None:
            seed_globals(self, self.streams.seed)
        self.episodes = Episodes(cfg.num_envs, cfg.max_episode_steps, self.arrays)
        self.observers = []
        # EmbodiChain shares one class-level list between all environments of a process.
        self.active_joint_ids = list(type(self).active_joint_ids)
        self.sensors = {}
        self._detached_uids: list[str] = []
        self.overridden = overridden_hooks(self)
        # EmbodiChain's name: overrides of `reset` read it; nothing here does.
        self._task_success = torch.zeros(cfg.num_envs, dtype=torch.bool, device=self.device)
        self._closed = False
        self.arrays_moved = False
        self._startup_due = False
        self.sim.physics_steps_per_control = cfg.sim_steps_per_control
        try:
            if compiled_scene is None:
                self.sim.drive_changes = drive_changes(cfg.events)
            self._build_scene(kwargs)
            self._build_managers()
            self._start(kwargs)
        except ConfigError as error:
            self.sim.destroy()
            raise with_all_problems(error, cfg, built_by_hooks) from error
        except BaseException:
            self.sim.destroy()
            raise

    # -- building ------------------------------------------------------------------------------

    def _build_scene(self, kwargs: dict[str, Any]) -> None:
        """Declare robot, scene, sensors, in this order, and compile them."""
        cfg = self.cfg
        self.drives_robot = not cfg.actions and bool(cfg.robot or cfg.robots)
        # After each hook, add the declared entities that an override did not add.
        robot_of_hook = self._setup_robot(**kwargs)
        declared_robot = add_declared_robots(self.sim, cfg)
        self.robot = declared_robot if robot_of_hook is None else robot_of_hook
        self._choose_actions()
        self._prepare_scene(**kwargs)
        add_declared_scene(self.sim, cfg)
        sensors_of_hook = self._setup_sensors(**kwargs) or {}
        declared_sensors = add_declared_sensors(self.sim, cfg)
        self.sensors = {**declared_sensors, **sensors_of_hook}
        set_extensions(self, cfg.extensions)
        self.sim.compile()
        open_window(self.sim, cfg.sim_cfg)

    def _choose_actions(self) -> None:
        """Give the declared robot its default actions, if neither config nor class defines any."""
        class_defines_actions = (
            self._has_action_space()
            or bool(self.active_joint_ids)
            or "_step_action" in self.overridden
        )
        if self.drives_robot and not class_defines_actions:
            self.cfg.actions = default_actions(self.robot)
            self.drives_robot = not self.cfg.actions and not is_passive(self.robot)
            if not self.cfg.actions and not self.drives_robot:
                self.single_action_space = no_action()
        if self.robot is not None and not self.active_joint_ids:
            self.active_joint_ids = list(self.robot.active_joint_ids)

    def _has_action_space(self) -> bool:
        """Whether the class has set its action space, itself or in `_setup_robot`."""
        return getattr(self, "single_action_space", None) is not None

    def _build_managers(self) -> None:
        """Build the terms of each section."""
        cfg = self.cfg
        # Commands first: other terms look them up when built. Curricula last: they look up all.
        self.managers = {}
        problems: list[Problem] = []
        makers: dict[str, Callable[[], Manager[Any]]] = {
            "command_manager": lambda: CommandManager(self, cfg.commands),
            "observation_manager": lambda: ObservationManager(self, cfg.observations),
            "event_manager": lambda: EventManager(self, cfg.events),
            "action_manager": lambda: ActionManager(self, cfg.actions),
            "reward_manager": lambda: RewardManager(self, cfg.rewards, cfg.reward_floor),
            "termination_manager": lambda: TerminationManager(self, cfg.terminations),
            "metric_manager": lambda: MetricManager(self, cfg.metrics),
        }
        for name, make in makers.items():
            try:
                manager = make()
            except ConfigError as error:
                # A mistake in one section does not hide those in the next.
                problems += error.problems
            except Exception as error:
                if problems:  # it may have looked up what could not be built
                    raise ConfigError(problems) from error
                raise
            else:
                setattr(self, name, manager)
                self.managers[manager.section] = manager
        if problems:
            raise ConfigError(problems)
        if self.command_manager.terms and not self.arrays.on_device:
            from embodichain.lab.gym.envs.shown_commands import (
                commands_in_force,  # few tasks have any
            )

            self.sim.engine.commands = commands_in_force(
                self.command_manager, cfg, self.sim.scene.model
            )
        self._prepare_events()
        self.curriculum_manager = CurriculumManager(self, cfg.curriculum)
        self.managers["curriculum"] = self.curriculum_manager

    def _prepare_events(self) -> None:
        """Let events look at the actions, which are built after them."""
        for name, term in self.event_manager.terms.items():
            prepare = getattr(term.instance, "prepare", None)
            if prepare is None:
                continue
            try:
                prepare(self)
            except ConfigError as error:
                path = f"events.{name}.params"
                raise ConfigError([problem.below(path) for problem in error.problems]) from error

    def _start(self, kwargs: dict[str, Any]) -> None:
        """Make spaces, run startup events, and observe once."""
        num_envs = self.cfg.num_envs
        robot = self.robot
        joint_ids = self.active_joint_ids
        if not self._has_action_space() or len(self.action_manager):
            self.single_action_space = action_space(robot, joint_ids, self.action_manager)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._check_action = ActionCheck(self.single_action_space, num_envs, self.arrays)
        action_width = gym.spaces.utils.flatdim(self.single_action_space)
        self.episodes.last_action = self.arrays.full((num_envs, action_width), 0.0)

        self.sim.reset_objects_state()
        self._init_sim_state(**kwargs)
        self._startup: StartupChanges | None = None
        if self.event_manager.has("startup"):
            self._startup = StartupChanges(self.sim)
        self.event_manager.apply("startup", None)
        if self._startup is not None:
            self._startup.note()
        self.sim.engine.forward()

        self._dump = None if self.arrays.on_device else StateDump(self.sim.engine)
        self._judge = self._make_judge()
        observing_hooks = {"get_obs", "_extend_obs"}
        hooks_observe = not self.overridden.isdisjoint((*observing_hooks, "_get_sensor_obs"))
        self.observation_buffer = ObservationBuffer(
            robot,
            joint_ids,
            self.observation_manager,
            plain=self.overridden.isdisjoint(observing_hooks),
            episodes=self.episodes,
            sensors=self.sensors,
        )
        self._step_observation = StepObservation(
            self,
            self.get_obs,
            self.observation_buffer,
            hooks_observe=hooks_observe,
            episodes=self.episodes,
            observations=self.observation_manager,
            events=self.event_manager,
            commands=self.command_manager,
        )
        first_observation = self._observe_once(kwargs)
        self.single_observation_space = observation_space(first_observation)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._graph = StepGraph(self) if self.device.type == "cuda" else None
        if self.cfg.sim_cfg.visualization is not None:
            self.cfg.sim_cfg.visualization.attach(self)

    def _observe_once(self, kwargs: dict[str, Any]) -> Observation:
        """Return an observation, whose shapes make the space, and check terms by it."""
        # The first reset must draw as if this had not happened.
        streams = self.streams.state_dict()
        buffer = self.observation_buffer
        observation = buffer.store(buffer.build(self.get_obs(**kwargs)))
        self._judge.check_terms(observation)
        self.streams.load_state_dict(streams)
        return observation

    def _make_judge(self) -> StepJudge:
        """Return the judge of steps, with the hooks that the class overrides."""
        makes_reward = "get_reward" in self.overridden
        extends_reward = "_extend_reward" in self.overridden
        hooks = JudgingHooks(
            overridden=self.overridden,
            get_info=self.get_info,
            get_reward=self.get_reward if makes_reward else None,
            extend_reward=self._extend_reward if extends_reward else None,
        )
        return StepJudge(
            self,
            hooks,
            episodes=self.episodes,
            actions=self.action_manager,
            commands=self.command_manager,
            observations=self.observation_manager,
            terminations=self.termination_manager,
            metrics=self.metric_manager,
            rewards=self.reward_manager,
            curriculum=self.curriculum_manager,
        )

    # -- reset ---------------------------------------------------------------------------------

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[EnvObs, Info]:
        """Start new episodes.

        Curricula run first, on the state of the episodes that end. Then follow MuJoCo's reset
        (velocities, warm start, controls, applied forces, time), every entity's configured state,
        `_initialize_episode`, reset events, commands, and `mj_forward`.

        Args:
            seed: Reseeds the random streams of all N environments, Gymnasium's ``np_random`` and
                torch's global generator. If all environments are reset, startup events run again
                before it, on the values that they found.
            options: The environments to reset, as ``reset_ids``, ``env_ids`` or ``env_idx`` (as in
                ManiSkill): sorted unique indices, or a mask (N,); or as ``reset_mask``, a mask;
                without them, all. All other options are passed to `_initialize_episode`.

        Returns:
            The observation and info of all N environments; rows that were not reset are unchanged.

        Raises:
            ValueError: If the indices or the mask are invalid.
        """
        require_open(self._closed)
        options = dict(options or {})
        ids = self.arrays.environments(reset_ids(options, self.num_envs), self.num_envs)
        if seed is not None:
            self.reseed(seed, startup=self.arrays.are_all(ids, self.num_envs))
        self.arrays_moved = True
        self._reset_rows(ids, options)
        self.episodes.settle(ids)
        obs = self._observe_reset(ids, options)
        info = dict(self.get_info(**options).items())
        return obs, info

    def reseed(self, seed: int, *, startup: bool) -> None:
        """Begin all random numbers anew.

        Args:
            seed: The seed.
            startup: Whether the next reset, of all environments, runs startup events again.
        """
        require_open(self._closed)
        self.streams.reseed(seed)
        seed_globals(self, self.streams.seed)
        self._startup_due = startup and self._startup is not None

    def _start_again(self) -> None:
        """Run startup events again, from the values that they found."""
        self._startup_due = False
        if self._startup is not None:
            self.sim.reset_objects_state(None, excluded_uids=self._detached_uids)
            self._startup.undo()
            self.event_manager.apply("startup", None, again=True)
            self.sim.engine.forward()

    def _none_for_all(self, ids: EnvIndex) -> EnvIndex | None:
        """Return environments, or None for all: much then needs no selection of rows."""
        return None if self.arrays.are_all(ids, self.num_envs) else ids

    def _reset_rows(self, ids: EnvIndex, options: dict[str, Any]) -> None:
        """Reset environments in place, without observing them."""
        if not len(ids):
            return
        where = self._none_for_all(ids)
        self._task_success = self.is_task_success()
        self.curriculum_manager.compute(where)
        if self._startup_due:
            self._start_again()
        self.sim.reset_objects_state(where, excluded_uids=self._detached_uids)
        for manager in self.managers.values():
            manager.reset(where)
        self.episodes.set_last_action(ids, 0.0)
        if "_initialize_episode" in self.overridden:
            self._initialize_episode(torch.from_numpy(host_ids(ids).copy()), **options)
        self.event_manager.apply("reset", where)
        self.command_manager.resample(where)
        self.sim.engine.forward(where)
        self.episodes.begin(ids)
        for observer in self.observers:
            # On a device the only observer is `StepCopies`, which takes masks.
            observer.on_reset(self, cast("EnvIds", ids))

    def _observe_reset(self, ids: EnvIndex, options: dict[str, Any]) -> Observation:
        """Observe after a reset; the other rows keep their last observation, bit for bit."""
        others = self.arrays.full(self.num_envs, True, np.bool_)
        others[ids] = False
        where = self._none_for_all(ids)
        if where is None:
            obs = self._step_observation.after_reset(options, None)
        else:
            # Observing draws noise in all environments; the others must not have drawn.
            counters = self.streams.save_counters()
            obs = self._step_observation.after_reset(options, where)
            self.streams.rewind(counters, others)
        return self.observation_buffer.store_first(obs, others)

    # -- step ----------------------------------------------------------------------------------

    # Values of a diverging environment may overflow float32; `diverged` finds the infinities.
    @np.errstate(over="ignore", invalid="ignore")
    def step(self, action: EnvAction, **kwargs: Any) -> Step:  # type: ignore[override]
        """Advance all environments by one control step (K physics steps).

        In this order: `_preprocess_action`; action terms, then `_step_action`; physics;
        `_update_sim_state`; counters; info (`compute_task_state`, `evaluate`, terminations,
        metrics); rewards (`get_reward`, reward terms, `_extend_reward`); `_postprocess_action`;
        terminated and truncated; interval events and commands, in environments that do not end; the
        observation (robot, sensors, `_extend_obs`, observation terms); divergence;
        `_hook_after_sim_step`. With SAME_STEP, environments that are done are then reset in place,
        and the returned observation is that of the new episode. With NEXT_STEP they are reset in
        the next step, with reward 0. With DISABLED the caller resets them.

        So a step is judged by the command that was acted on; a new command, or a push, is observed
        before anything is judged by it. Where a hook (`get_reward`, `_extend_reward`,
        `check_truncated`) or a term takes the observation, it is made before judging; where an
        event or a command has then changed something, it is made once more, with the same noise,
        and delays and histories advance once. ``elapsed_steps`` counts this step wherever a term
        reads it; the hooks that observe and judge see it without this step, as in EmbodiChain.

        Poses, velocities and sensors are those after the last physics step and all writes; efforts
        and contact forces (``qf``) are those within the last physics step.

        An environment that diverges (a MuJoCo warning counter rises, or its observation or reward
        is not finite) is terminated with ``info["diverged"]``, reward 0 and the numbers of its last
        finite observation in the final one; images and integers stay as just observed, because a
        copy of them in each step would be slow. The other environments are not affected. A warning
        says whether its physics diverged, or names the terms that are not finite although physics
        is.

        Args:
            action: (N, A) finite floating tensor on the environment's device, or a numpy array, or
                a mapping of tensors (such as a TensorDict) if `_step_action` takes one.
            **kwargs: Passed to the hooks.

        Returns:
            Observation; reward (N,) float32; terminated (N,) bool; truncated (N,) bool; info: a
            dict with ``elapsed_steps``, ``success``, ``success_terminated``, ``fail``,
            ``diverged``, ``rewards``, ``episode_sums``, ``metrics`` (all as before any reset) and
            the entries of `evaluate`. ``rewards`` has the value of each term in this step without
            its weight, ``episode_sums`` the sum of value x weight over the episode. ``success`` is
            the metric of that name above 0, in a task that has one, and else
            ``success_terminated``, the success that ends episodes.
            If an environment was reset in place, also ``final_obs`` (``final_observation``) and
            ``final_info``, valid in the rows where ``_final_obs`` and ``_final_info`` are True.

        Raises:
            TypeError: If the action has the wrong type.
            ValueError: If its shape or device is wrong or it is not finite; no state has changed.
            gymnasium.error.ResetNeeded: If `reset` has not been called.
            TermError: If a term raised an exception; names the term and where it is declared.
            gymnasium.error.ClosedEnvironmentError: After `close`, as all that needs the simulation.
        """
        checked_action, action_values = self._begin_step(action)
        with self.copies or nullcontext():
            if self._graph is None or kwargs or not isinstance(checked_action, torch.Tensor):
                return _as_tensors(self._step(checked_action, action_values, kwargs))
            return self._step_by_graph(self._graph, checked_action)

    @np.errstate(over="ignore", invalid="ignore")
    def step_arrays(self, action: EnvAction | NDArray[Any]) -> StepResult:
        """`step` for code of this package that reads arrays: makes no tensors and no ``info``.

        Args:
            action: As of `step`.

        Returns:
            The same step as arrays of the host; do not write to them.
        """
        return self._step(*self._begin_step(action), {})

    @property
    def steps_in_arrays(self) -> bool:
        """Whether `step_arrays` does all that `step` does.

        It does not where arrays are on a device, where the class overrides `step`, or where one of
        its hooks may change what ``info`` says.
        """
        is_plain = type(self).step is BaseEnv.step and not self._judge.hooks_share_info
        return is_plain and not self.arrays.on_device

    def _begin_step(self, action: EnvAction | NDArray[Any]) -> tuple[EnvAction, Floats]:
        """Check that a step can be taken by an action; return it and its numbers (N, A)."""
        require_open(self._closed)
        if not self.episodes.begun:
            raise gym.error.ResetNeeded("call reset() before the first step()")
        self.curriculum_manager.before_step()
        return self._check_action(action)

    def _step_by_graph(self, graph: StepGraph, action: torch.Tensor) -> Step:
        """Take a step by a CUDA graph, once one is captured; a replay runs no Python."""
        steps_before = self.control_step
        arrays_moved = self.arrays_moved
        self.arrays_moved = False

        def run(action: torch.Tensor) -> Step:
            checked_action, action_values = self._check_action(action)
            return _as_tensors(self._step(checked_action, action_values, {}))

        def forget() -> None:
            self.control_step = steps_before
            if self.copies is not None:
                self.copies.restart()

        result = graph.step(run, action, arrays_moved=arrays_moved, forget=forget)
        # A replayed graph runs no Python, which would have counted the step.
        self.control_step = steps_before + 1
        return result

    def _step(self, action: EnvAction, action_values: Floats, kwargs: dict[str, Any]) -> StepResult:
        """Take a step by a checked action and its numbers (N, A); see `step` for the order."""
        # Some of the N environments, in three forms:
        # - masks (N,): `pending` (reset after this step, as NEXT_STEP does), `over` and `cut` (the
        #   episode is truncated), and those of `result`; None is no environment;
        # - sorted indices (n,), or None for all: `stepped` (all but the pending ones), `going_on`
        #   (neither pending nor at the end of their episode); with arrays on a device, masks;
        # - a list of such indices, one for each event or command that changed something: `changed`.
        episodes = self.episodes
        judge = self._judge
        episodes.last_action = action_values
        # With NEXT_STEP, pending environments are reset after this step; what it does to them does
        # not count, and its draws are taken back.
        pending = episodes.pending
        counters = None
        stepped = None
        if pending is not None:
            counters = self.streams.save_counters()
            stepped = self.arrays.where(~pending)

        action = self._act(self._preprocess_action(action))
        if self.run_dir is not None and self._dump is not None:
            self._dump.keep()
        self._step_physics()
        self._update_sim_state(**kwargs)
        episodes.advance()
        self.control_step += 1

        judged_obs = None
        if judge.obs_is_needed:
            judged_obs = self._step_observation.to_judge(kwargs, stepped)
        self.command_manager.measure(stepped)
        result = judge.judge(judged_obs, action, kwargs)
        if "_postprocess_action" in self.overridden:
            with episodes.counting(present=False):
                action = self._postprocess_action(action)
        over = episodes.take_truncated()
        if "check_truncated" in self.overridden:
            cut = self.check_truncated(cast("Observation", judged_obs), result.class_info or {})
            over |= as_mask(cut, self.num_envs, "check_truncated", self.arrays)
        result.end(over, self.cfg.ignore_terminations)

        going_on = self._going_on(result, pending)
        changed = self.event_manager.step(going_on, stepped)
        if self.command_manager.acts_in_steps:
            changed += self.command_manager.step(going_on)
        result.obs = self._step_observation.to_return(judged_obs, changed, kwargs, stepped)
        self._end_diverged(result, action_values)
        self.observation_buffer.store(result.obs)
        result.elapsed_steps = episodes.count
        if pending is not None and counters is not None:
            self.streams.rewind(counters, pending)
            result.exclude_step(pending)
        if "_hook_after_sim_step" in self.overridden:
            self._call_hook_after_step(result, action, kwargs)

        # Observers may keep the ids of the episodes that end, which the reset counts on.
        episode_ids = episodes.ids.copy() if self.observers else episodes.ids
        self._autoreset(result)
        if self.observers:
            record = StepRecord(
                control_step=self.control_step,
                action=action_values,
                reward=result.reward,
                terminated=result.terminated,
                truncated=result.truncated,
                info=result.info(),
                obs=result.obs,
                episode_ids=episode_ids,
            )
            for observer in self.observers:
                observer.on_step(self, record)
        return result

    def _step_physics(self) -> None:
        """Take the K physics steps of a control step, at once unless action terms act in each."""
        if not self.action_manager.acts_in_physics:
            self.sim.update(step=self.sim_steps_per_control)
            return
        for _ in range(self.sim_steps_per_control):
            self.action_manager.act_in_physics()
            self.sim.update(step=1)

    def _going_on(self, result: StepResult, pending: Mask | None) -> EnvIndex | None:
        """Return the environments whose episode goes on after this step, None for all."""
        ended = result.done
        if pending is not None:
            ended = pending if ended is None else ended | pending
        if ended is None or none_set(ended):
            return None
        return self.arrays.where(~ended)

    def _end_diverged(self, result: StepResult, action_values: Floats) -> None:
        """End the episodes of environments that diverged, with what was observed before."""
        diverged = self._judge.diverged(result)
        if diverged is None:
            result.diverged = self._judge.nowhere
            return
        result.diverged = diverged
        self._judge.explain(diverged, result)
        self._judge.exclude(diverged, result)
        result.obs = self.observation_buffer.without(result.obs, diverged)
        result.set_ends(result.terminated | diverged, result.truncated & ~diverged)
        if self._dump is not None:
            self._dump.write(self.run_dir, diverged, self.control_step - 1, action_values)

    def _call_hook_after_step(
        self, result: StepResult, action: EnvAction, kwargs: dict[str, Any]
    ) -> None:
        """Call `_hook_after_sim_step`."""
        self._hook_after_sim_step(
            result.obs,
            action,
            tensor_of(result.reward),
            tensor_of(result.terminated | result.truncated),
            result.info(),
            terminateds=tensor_of(result.terminated.copy()),
            truncateds=tensor_of(result.truncated.copy()),
            **kwargs,
        )

    def _act(self, action: EnvAction) -> EnvAction:
        """Apply an action; return the one that rewards receive."""
        if self.action_manager.terms:
            if not isinstance(action, torch.Tensor):
                raise TypeError(f"action terms take a tensor (N, A), got {type(action).__name__}")
            self.action_manager.apply(action)
        rewarded_action = self._step_action(action)
        return action if rewarded_action is None else rewarded_action

    def _autoreset(self, result: StepResult) -> None:
        """Reset environments as the autoreset mode says."""
        mode = self.metadata["autoreset_mode"]
        to_reset: Mask | None = None
        if mode is AutoresetMode.SAME_STEP and result.done is not None:
            result.final_obs = result.obs
            to_reset = result.done
        elif mode is AutoresetMode.NEXT_STEP:
            # Those that ended in the step before are reset now, the present ones in the next.
            to_reset = self.episodes.pending
            self.episodes.pending = result.done
        if to_reset is None or none_set(to_reset):
            return
        ids = self.arrays.where(to_reset)
        self._reset_rows(ids, {})
        result.obs = self._observe_reset(ids, {})

    # -- hooks of a subclass: building ---------------------------------------------------------

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

    # -- hooks of a subclass: resetting --------------------------------------------------------

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

    # -- hooks of a subclass: stepping ---------------------------------------------------------

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

    # -- hooks of a subclass: observing --------------------------------------------------------

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
        require_open(self._closed)
        sensors: Mapping[str, Any] = {}
        if self.observes_sensors:
            sensors = self._get_sensor_obs(**kwargs)
        extend = None
        if "_extend_obs" in self.overridden:
            extend = partial(self._extend_obs, **kwargs)
        return self.observation_buffer.observe(sensors, extend)

    def _get_sensor_obs(self, **kwargs: Any) -> Mapping[str, Any]:
        """Return ``obs["sensor"]``: each sensor's data by uid.

        Called only if there are sensors. The default leaves out those whose `observe` is False.
        """
        return {
            uid: sensor.get_data()
            for uid, sensor in self.sensors.items()
            if getattr(sensor, "observe", True)
        }

    def _extend_obs(self, obs: EnvObs, **kwargs: Any) -> EnvObs:
        """Return the observation with entries added; observation terms run after this."""
        return obs

    # -- hooks of a subclass: judging ----------------------------------------------------------

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
        no_flags = torch.zeros(self.cfg.num_envs, dtype=torch.bool, device=self.sim.device)
        return no_flags, no_flags.clone(), {}

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

    # -- pictures, recorded moments, the end ---------------------------------------------------

    def render(self, view: str = "default") -> NDArray[np.uint8] | None:
        """Draw environment 0 as (480, 640, 3) RGB.

        Without a `render_mode` it returns None, with a warning.

        Raises:
            RenderError: If no OpenGL library works; names the package to install.
            ValueError: If there is no such view or camera.
        """
        require_open(self._closed)
        if self.render_mode != "rgb_array":
            warn_undrawn(self.task_name)
            return None
        return self.sim.render(camera=view)

    def restore(
        self,
        log: SnapshotSource | Snapshot,
        env: int = 0,
        episode: int | None = None,
        step: int | None = None,
        env_ids: Any = None,
    ) -> tuple[EnvObs, Info]:
        """Continue from a recorded moment: restore its state, model fields and counters.

        The recorded actions then reproduce the recorded states bit for bit until a random draw.
        Random streams and states of terms (``info["not_restored"]``) begin as at a reset.

        Args:
            log: An open log (`embodichain.recording.open`), or a snapshot taken from one.
            env: The recorded environment.
            episode: One of its episodes; None counts `step` from the start of the recording.
            step: Finished control steps of the episode, or of the recording; None is 0.
            env_ids: The environments to restore (sorted unique, or a mask); None is all.

        Returns:
            The observation and info of all N environments; rows not in `env_ids` are unchanged.

        Raises:
            ConfigError: If the log has no such moment, or it is of another scene.
        """
        require_open(self._closed)
        snapshot = restoring.snapshot_of(log, env, episode, step)
        self.arrays.require_host("recorded states")
        selection = as_env_ids(env_ids, self.num_envs)
        ids = np.arange(self.num_envs) if selection is None else host_ids(selection)
        restoring.put(snapshot, self.sim, self.managers, self.episodes, ids)
        self._task_success = self.is_task_success()
        for observer in self.observers:
            observer.on_reset(self, ids)
        obs = self._observe_reset(ids, {})
        missing = restoring.not_restored(snapshot, self.sim, self.managers)
        return obs, {**self.get_info(), "not_restored": missing}

    def state_dict(self) -> dict[str, Any]:
        """Return the state from which the run continues bit for bit (copies).

        Subclasses that add state extend it.
        """
        require_open(self._closed)
        state = {
            "num_envs": self.num_envs,
            "control_step": self.control_step,
            "np_random": self.np_random.bit_generator.state,
            "observation": self.observation_buffer.last.copy(),
            "managers": {name: manager.state_dict() for name, manager in self.managers.items()},
            "sim": self.sim.state_dict(),
            "streams": self.streams.state_dict(),
            "episodes": self.episodes.state_dict(),
        }
        return dict(self.arrays.saved(state))

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue exactly where `state_dict` was taken, in an environment of the same config.

        Raises:
            ValueError: If the number of environments differs.
        """
        require_open(self._closed)
        if saved["num_envs"] != self.num_envs:
            raise ValueError(
                f"this state has {saved['num_envs']} environments, "
                f"the environment has {self.num_envs}"
            )
        state = self.arrays.loaded(saved)
        self.sim.load_state_dict(state["sim"])
        self.streams.load_state_dict(state["streams"])
        self.episodes.load_state_dict(state["episodes"])
        self.np_random.bit_generator.state = state["np_random"]
        for name, manager in self.managers.items():
            manager.load_state_dict(state["managers"][name])
        self.control_step = state["control_step"]
        self.observation_buffer.last = state["observation"].copy()
        self.arrays_moved = True

    def close(self) -> None:
        """Call the observers' `on_close` and free the simulation, even if an observer raises."""
        if self._closed:
            return
        self._closed = True
        with ExitStack() as stack:  # the last callback first
            # The last references to the engine: without them, memory is freed at once.
            stack.callback(self.sim.destroy)
            for name in ("_dump", "_graph"):
                stack.callback(self.__dict__.pop, name, None)
            for observer in reversed(self.observers):
                stack.callback(observer.on_close, self)

    @property
    def not_finite_terms(self) -> dict[str, int]:
        """Terms that were NaN or infinite although physics was finite -> in how many steps.

        ``{"rewards.energy": 12}``; the environments in which a term was so ended as diverged.
        """
        return self._judge.not_finite_terms

    @property
    def is_closed(self) -> bool:
        """Whether `close` was called: what needs the simulation then raises Gymnasium's error."""
        return self._closed

    def __repr__(self) -> str:
        """Return class, task, size and spaces in one line."""
        return describe(
            type(self).__name__,
            self.task_name,
            f"num_envs={self.num_envs}",
            f"device='{self.device}'",
            action=self.single_action_space,
            observation=self.single_observation_space,
        )

    __str__ = __repr__  # Gymnasium's names an instance alone

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
        require_open(self._closed)
        return (
            self.episodes.limit,
            getattr(self.sim.engine, "revision", 0),
            len(self.observers),
            *(manager.revision for manager in self.managers.values()),
        )

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
        """Control steps after which an episode is truncated; 2**31 - 1 means no limit."""
        return self.episodes.limit

    @max_episode_steps.setter
    def max_episode_steps(self, steps: int) -> None:
        require_open(self._closed)
        if steps < 1 and steps != -1:
            raise ValueError(f"max_episode_steps must be at least 1, or -1 for never, got {steps}")
        limit = NO_LIMIT if steps == -1 else min(int(steps), NO_LIMIT)
        self.episodes.limit = limit
        self.cfg.max_episode_steps = limit

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
        require_open(self._closed)
        values = torch.as_tensor(steps)
        elapsed = self.episodes.elapsed
        if values.shape != elapsed.shape:
            raise ValueError(f"elapsed_steps must be {tuple(elapsed.shape)}, got {values.shape}")
        if not self.arrays.on_device and (values < 0).any():
            raise ValueError("elapsed_steps must not be negative")
        elapsed[:] = self.arrays.of(values.to(torch.int32))

    @property
    def episode_ids(self) -> torch.Tensor:
        """(N,) int64 number of the current episode, from 0; -1 before the first reset. A copy."""
        return tensor_of(self.episodes.ids.copy())

    @property
    def last_action(self) -> torch.Tensor:
        """(N, A) float32 action as last given to `step`; zeros after a reset. A copy."""
        return to_tensor(self.episodes.last_action)

    def read_last_action(self) -> Floats:
        """(N, A) action as last given to `step`; do not write to it."""
        return self.episodes.last_action

    def read_elapsed_steps(self) -> NDArray[np.int32]:
        """`elapsed_steps` as an array (N,); do not write to it."""
        return self.episodes.count

    def truncate(self, env_ids: Any) -> None:
        """Truncate the episodes of environments at the next step.

        Args:
            env_ids: (n,) which of the N.
        """
        require_open(self._closed)
        self.episodes.truncate(env_ids)

    # -- random numbers ------------------------------------------------------------------------

    @property
    def startup_draws(self) -> dict[str, dict[str, NDArray[Any]]]:
        """Startup event -> what it drew last: (N, ...) by name, on the host.

        Observers are attached after startup events; a recorder reads their draws here.
        """
        host = self.arrays.host
        return {
            term: {name: host(values) for name, values in drawn.items()}
            for term, drawn in self.event_manager.startup_draws.items()
        }

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
            message = f"no sensor {name!r}; there are: {', '.join(self.sensors) or 'none'}."
            raise ConfigError([Problem("", message, did_you_mean(name, self.sensors).strip())])
        return self.sensors[name]

    def add_detached_uids_for_reset(self, uids: Sequence[str]) -> None:
        """Exclude entities from the reset of states.

        Raises:
            ValueError: If an entity does not exist; lists those that do.
        """
        require_open(self._closed)
        unknown = [uid for uid in uids if uid not in self.sim.asset_uids]
        if unknown:
            raise ValueError(f"no entities {unknown}; there are: {self.sim.asset_uids}")
        for uid in uids:
            if uid not in self._detached_uids:
                self._detached_uids.append(uid)

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
        """Keep the curriculum at a stage: its terms are not called any more.

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
        return self.copies.copied_env

    def remove_observer(self, observer: StepObserver) -> None:
        """Detach an observer; ValueError if it is not attached."""
        require_open(self._closed)
        attached: StepObserver = observer
        if self.copies is not None:
            self.copies.flush()
            self.copies.copied_env.observers.remove(observer)
            if self.copies.copied_env.observers:
                return
            # Without observers of the copy, steps need not be copied.
            attached = self.copies
            self.copies = None
        self.observers.remove(attached)
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
        require_open(self._closed)
        if self.observers:
            # On a device the only observer is `StepCopies`, which takes masks.
            ids = cast("EnvIds | None", env_ids)
            record = EventRecord(term=term, mode=mode, env_ids=ids, drawn=drawn or {})
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


def _as_tensors(result: StepResult) -> Step:
    """Return what `BaseEnv.step` returns."""
    return (
        result.obs,
        tensor_of(result.reward),
        tensor_of(result.terminated),
        tensor_of(result.truncated),
        result.info(),
    )


EmbodiedEnv = BaseEnv
"""EmbodiChain's name for an environment built from its config."""


OPTIONAL_HOOKS = (
    "get_obs",
    "_extend_obs",
    "_get_sensor_obs",
    "_step_action",
    "get_reward",
    "_extend_reward",
    "check_truncated",
    "_postprocess_action",
    "_hook_after_sim_step",
    "compute_task_state",
    "evaluate",
    "get_info",
    "_setup_robot",
    "_prepare_scene",
    "_initialize_episode",
)
"""Hooks with special treatment where a class does not override them: most are not called."""


def overridden_hooks(env: BaseEnv) -> frozenset[str]:
    """Return which of `OPTIONAL_HOOKS` an environment's class overrides.

    Raises:
        ConfigError: If arrays are on the device, where environments are masks, and it takes
            indices of environments, or resets in the next step.
    """
    cls = type(env)
    arrays = env.sim.arrays
    hooks = frozenset(
        name for name in OPTIONAL_HOOKS if getattr(cls, name) is not getattr(BaseEnv, name)
    )
    if "_initialize_episode" in hooks:
        arrays.require_host(
            f"indices of environments, which {cls.__name__}._initialize_episode takes,"
        )
    if env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP:
        arrays.require_host("steps of some environments, as of autoreset mode NEXT_STEP,")
    return hooks


def set_extensions(env: object, extensions: dict[str, Any]) -> None:
    """Set ``extensions`` as attributes of an environment.

    Raises:
        ConfigError: If the environment has an attribute of that name already.
    """
    problems = [
        Problem(f"extensions.{key}", "taken by the environment, or not a name")
        for key in extensions
        if not key.isidentifier() or hasattr(env, key)
    ]
    if problems:
        raise ConfigError(problems)
    for key, value in extensions.items():
        setattr(env, key, value)
