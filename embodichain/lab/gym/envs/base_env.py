"""`BaseEnv`: N environments of one task, stepped together. The step contract is in `BaseEnv.step`.

Its parts: `Episodes` (counters), `ObservationLayout` (columns of the observation), `judging`
(success and the end of episodes), `scene_setup` (config to entities), `restoring` (recorded
moments), `StateDump` (environments that diverged), and the managers of terms.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from embodichain.lab.gym.envs import scene_setup
from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.gym.envs.closed import require_open
from embodichain.lab.gym.envs.env_reads import EnvReads
from embodichain.lab.gym.envs.hooks import EnvHooks, overridden_hooks, set_extensions
from embodichain.lab.gym.envs.managers.action_manager import (
    ActionCheck,
    ActionManager,
    action_space,
    default_actions,
    is_passive,
    no_action,
)
from embodichain.lab.gym.envs.managers.drawing import CommandManager, EventManager
from embodichain.lab.gym.envs.managers.manager import CurriculumManager, Manager
from embodichain.lab.gym.envs.managers.observation_manager import ObservationManager
from embodichain.lab.gym.envs.managers.value_managers import (
    MetricManager,
    RewardManager,
    TerminationManager,
)
from embodichain.lab.gym.envs.observation import Observation, observation_space
from embodichain.lab.gym.envs.observers import StepObserver, StepRecord
from embodichain.lab.gym.envs.on_device.step_graph import StepGraph
from embodichain.lab.gym.envs.restoring import restored as restoring
from embodichain.lab.gym.envs.restoring.snapshot import Snapshot, SnapshotSource
from embodichain.lab.gym.envs.restoring.startup import StartupChanges
from embodichain.lab.gym.envs.step.episodes import Episodes, add_finals, parse_mode, seed_globals
from embodichain.lab.gym.envs.step.judging import (
    StateDump,
    StepJudge,
    as_mask,
    none_set,
    reset_ids,
    zeroed,
)
from embodichain.lab.gym.envs.step.observation_buffer import ObservationBuffer
from embodichain.lab.gym.envs.step.step_observation import StepObservation, observe
from embodichain.lab.sim.sim_manager import SimulationManager
from embodichain.lab.sim.types import EnvAction, EnvObs
from embodichain.utils.arrays import as_env_ids, tensor_of
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.random import first_seed
from embodichain.utils.uncopied import Uncopied

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.api import F64, EnvIndex

__all__ = ["BaseEnv", "EmbodiedEnv"]

Step = tuple[EnvObs, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]
Mask = NDArray[np.bool_]
Info = dict[str, Any]
_ZERO = np.float32(0.0)


class BaseEnv(Uncopied, EnvHooks, EnvReads, gym.Env[EnvObs, EnvAction]):
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
        **kwargs: Passed to the hooks that build the scene.

    Attributes:
        sim_steps_per_control: K, physics steps a control step.
        control_step: Control steps since the environment was built.
        arrays_moved: Whether code outside of steps may have replaced arrays (see `StepGraph`).
        managers: All managers by section of the config.
        single_action_space: Actions of one environment, as `single_observation_space` has its
            observations; those of all N are `action_space` and `observation_space`.

    Raises:
        ConfigError: If the task is wrong; lists every mistake that can be found.
        DeviceError: If the device is unknown or has no engine.
    """

    metadata: dict[str, Any] = {
        "render_modes": ["rgb_array"],
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }
    single_action_space: gym.Space[Any]
    single_observation_space: gym.Space[Any]
    managers: dict[str, Manager[Any]]
    command_manager: CommandManager
    observation_manager: ObservationManager
    event_manager: EventManager

    def __init__(
        self,
        cfg: EnvCfg | None = None,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        num_envs: int | None = None,
        run_dir: Path | None = None,
        **kwargs: Any,
    ) -> None:
        self.affordance_datas = {}
        self.cfg = cfg = scene_setup.frozen_cfg(cfg, num_envs)
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"unknown render_mode {render_mode!r}; one of: rgb_array, None")
        self.render_mode, self.run_dir, self.control_step = render_mode, run_dir, 0
        self.sim_steps_per_control = cfg.sim_steps_per_control
        self.metadata = {**type(self).metadata, "autoreset_mode": parse_mode(autoreset_mode)}
        self.metadata["render_fps"] = self.control_frequency
        self.sim = SimulationManager(cfg.sim_cfg)
        self.streams = self.arrays.streams(first_seed(cfg.seed), cfg.num_envs, cfg.first_env)
        if cfg.seed is not None:
            seed_globals(self, self.streams.seed)
        self.episodes = Episodes(cfg.num_envs, cfg.max_episode_steps, self.arrays)
        self.observers: list[StepObserver] = []
        # EmbodiChain shares one class-level list between all environments of a process.
        self.active_joint_ids = list(type(self).active_joint_ids)
        self.sensors, self._detached_uids = {}, []
        self.overridden = overridden_hooks(self)
        self._task_success = torch.zeros(cfg.num_envs, dtype=torch.bool, device=self.device)
        self._closed = self.arrays_moved = self._startup_due = False
        self.sim.physics_steps_per_control = cfg.sim_steps_per_control
        self.sim.drive_changes = scene_setup.drive_changes(cfg.events)
        try:
            self._build_scene(kwargs)
            self._build_managers()
            self._start(kwargs)
        except ConfigError as error:
            self.sim.destroy()
            by_hooks = not self.overridden.isdisjoint(("_setup_robot", "_prepare_scene"))
            raise scene_setup.with_all_problems(error, cfg, by_hooks) from error
        except BaseException:
            self.sim.destroy()
            raise

    # -- building ------------------------------------------------------------------------------

    def _build_scene(self, kwargs: dict[str, Any]) -> None:
        """Declare robot, scene, sensors, in this order, and compile them."""
        cfg, sim = self.cfg, self.sim
        self.drives_robot = not cfg.actions and bool(cfg.robot or cfg.robots)
        own = self._setup_robot(**kwargs)
        # After each hook, add the declared entities that an override did not add.
        declared = scene_setup.add_declared_robots(sim, cfg)
        self.robot = own if own is not None else declared
        has_space = getattr(self, "single_action_space", None) is not None
        chosen = has_space or self.active_joint_ids or "_step_action" in self.overridden
        if self.drives_robot and not chosen:
            cfg.actions = default_actions(self.robot)
            self.drives_robot = not cfg.actions and not is_passive(self.robot)
            if not (cfg.actions or self.drives_robot):
                self.single_action_space = no_action()
        if self.robot is not None and not self.active_joint_ids:
            self.active_joint_ids = list(self.robot.active_joint_ids)
        self._prepare_scene(**kwargs)
        scene_setup.add_declared_scene(sim, cfg)
        sensors = self._setup_sensors(**kwargs) or {}
        self.sensors = {**scene_setup.add_declared_sensors(sim, cfg), **sensors}
        set_extensions(self, cfg.extensions)
        sim.compile()
        scene_setup.open_window(sim, cfg.sim_cfg)

    def _build_managers(self) -> None:
        cfg = self.cfg
        # Commands first: other terms look them up when built. Curricula last: they look up all.
        # What is wrong in one section does not hide what is wrong in the next.
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
                problems += error.problems
            except Exception as error:
                if problems:  # it may look up what could not be built
                    raise ConfigError(problems) from error
                raise
            else:
                setattr(self, name, manager)
                self.managers[manager.section] = manager
        if problems:
            raise ConfigError(problems)
        self.curriculum_manager = CurriculumManager(self, cfg.curriculum)
        self.managers["curriculum"] = self.curriculum_manager

    def _start(self, kwargs: dict[str, Any]) -> None:
        """Make spaces, run startup events, and observe once."""
        cfg, sim, robot, joints = self.cfg, self.sim, self.robot, self.active_joint_ids
        if getattr(self, "single_action_space", None) is None or len(self.action_manager):
            self.single_action_space = action_space(robot, joints, self.action_manager)
        space = self.single_action_space
        self.action_space = batch_space(space, cfg.num_envs)
        self._check_action = ActionCheck(space, cfg.num_envs, self.arrays)
        shape = cfg.num_envs, gym.spaces.utils.flatdim(space)
        self.episodes.last_action = self.arrays.full(shape, 0.0)
        sim.reset_objects_state()
        self._init_sim_state(**kwargs)
        has_startup = self.event_manager.has("startup")
        self._startup = StartupChanges(sim) if has_startup else None
        self.event_manager.apply("startup", None)
        if self._startup is not None:
            self._startup.note()
        sim.engine.forward()
        self._dump = None if self.arrays.on_device else StateDump(sim.engine)
        self._judge = StepJudge(self, self.overridden)
        own_code = self.overridden & {"get_obs", "_extend_obs"}
        self.observation_buffer = buffer = ObservationBuffer(
            robot, joints, self.observation_manager, not own_code, self.episodes, self.sensors
        )
        self._step_observation = StepObservation(self)
        saved = self.streams.state_dict()
        first = buffer.store(buffer.build(self.get_obs(**kwargs)))
        self._judge.check_terms(first)
        self.streams.load_state_dict(saved)  # the first reset draws as if this had not happened
        self.single_observation_space = observation_space(first)
        self.observation_space = batch_space(self.single_observation_space, cfg.num_envs)
        self._graph = StepGraph(self) if self.device.type == "cuda" else None
        if cfg.sim_cfg.visualization is not None:
            cfg.sim_cfg.visualization.attach(self)

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
        return self._observe_reset(ids, options), dict(self.get_info(**options).items())

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

    def _reset_rows(self, ids: EnvIndex, options: dict[str, Any]) -> None:
        if not len(ids):
            return
        where = None if self.arrays.are_all(ids, self.num_envs) else ids
        self._task_success = self.is_task_success()
        self.curriculum_manager.compute(where)
        if self._startup_due:
            self._start_again()
        self.sim.reset_objects_state(where, excluded_uids=self._detached_uids)
        for manager in self.managers.values():
            manager.reset(where)
        self.episodes.set_last_action(ids, 0.0)
        if "_initialize_episode" in self.overridden:
            self._initialize_episode(torch.from_numpy(ids.copy()), **options)
        self.event_manager.apply("reset", where)
        self.command_manager.resample(where)
        self.sim.engine.forward(where)
        self.episodes.begin(ids)
        for observer in self.observers:
            observer.on_reset(self, ids)

    def _observe_reset(self, ids: EnvIndex, options: dict[str, Any]) -> Observation:
        """Observe after a reset; the other rows keep their last observation, bit for bit."""
        others = self.arrays.full(self.num_envs, True, np.bool_)
        others[ids] = False
        where = None if self.arrays.are_all(ids, self.num_envs) else ids
        saved = None if where is None else self.streams.save_counters()
        obs = observe(self, options, where)
        if saved is not None:
            self.streams.rewind(saved, others)
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
        is not finite) is terminated with ``info["diverged"]``, reward 0 and its last finite
        observation as the final one. The other environments are not affected. A warning says
        whether its physics diverged, or names the terms that are not finite although physics is.

        Args:
            action: (N, A) finite floating tensor on the environment's device, or a numpy array, or
                a mapping of tensors (such as a TensorDict) if `_step_action` takes one.
            **kwargs: Passed to the hooks.

        Returns:
            Observation; reward (N,) float32; terminated (N,) bool; truncated (N,) bool; info: a
            dict with ``elapsed_steps``, ``success``, ``success_terminated``, ``fail``,
            ``diverged``, ``rewards``, ``episode_sums``, ``metrics`` (all as before any reset) and
            the entries of `evaluate`. ``success`` is the metric of that name above 0, in a task
            that has one, and else ``success_terminated``, the success that ends episodes.
            If an environment was reset in place, also ``final_obs`` (``final_observation``) and
            ``final_info``, valid in the rows where ``_final_obs`` and ``_final_info`` are True.

        Raises:
            TypeError: If the action has the wrong type.
            ValueError: If its shape or device is wrong or it is not finite; no state has changed.
            gymnasium.error.ResetNeeded: If `reset` has not been called.
            TermError: If a term raised an exception; names the term and where it is declared.
            gymnasium.error.ClosedEnvironmentError: After `close`, as all that needs the simulation.
        """
        require_open(self._closed)
        if not self.episodes.begun:
            raise gym.error.ResetNeeded("call reset() before the first step()")
        self.curriculum_manager.before_step()
        checked, given = self._check_action(action)
        with self.copies or nullcontext():
            if self._graph is None or kwargs or not isinstance(checked, torch.Tensor):
                return self._step(checked, given, kwargs)
            return self._graph.step(lambda a: self._step(*self._check_action(a), {}), checked)

    def _step(self, action: EnvAction, given: F64, kwargs: dict[str, Any]) -> Step:
        """Take a step by a checked action and its numbers (N, A)."""
        episodes = self.episodes
        episodes.last_action = given
        judge = self._judge
        pending = episodes.pending  # NEXT_STEP: these are reset instead of stepped
        saved = None if pending is None else self.streams.save_counters()
        stepped = None if pending is None else self.arrays.where(~pending)

        action = self._act(self._preprocess_action(action))
        if self.run_dir is not None and self._dump is not None:
            self._dump.keep()
        self.action_manager.step_physics(self.sim_steps_per_control)
        self._update_sim_state(**kwargs)
        episodes.advance()
        self.control_step += 1

        seen = self._step_observation.to_judge(kwargs, stepped) if judge.takes_obs else None
        self.command_manager.measure(stepped)
        info, outcome = judge.info(seen, action, kwargs)
        reward = judge.reward(seen, action, info)
        with episodes.counting(present=False):
            action = self._postprocess_action(action)
        over = episodes.over()
        if seen is not None and "check_truncated" in self.overridden:
            cut = self.check_truncated(seen, info)
            over |= as_mask(cut, self.num_envs, "check_truncated", self.arrays)
        terminated, truncated = outcome.ends(over, self.cfg.ignore_terminations)

        going = self._going_on(terminated, truncated, pending)
        changed = self.event_manager.step(going, stepped) + self.command_manager.step(going)
        obs = self._step_observation.to_return(seen, changed, kwargs, stepped)
        mask = judge.diverged(obs, reward)
        if mask is not None:
            judge.explain(mask, obs, reward, info)
            info = judge.exclude(mask, info)
            obs, reward = self.observation_buffer.without(obs, mask), np.where(mask, _ZERO, reward)
            terminated, truncated = terminated | mask, truncated & ~mask
            if self._dump is not None:
                self._dump.write(self.run_dir, mask, self.control_step - 1, given)
        self.observation_buffer.store(obs)
        info["diverged"] = tensor_of(np.zeros(len(given), np.bool_) if mask is None else mask)
        info["elapsed_steps"] = self.elapsed_steps
        if pending is not None and saved is not None:
            self.streams.rewind(saved, pending)
            terminated, truncated = terminated & ~pending, truncated & ~pending
            reward = np.where(pending, _ZERO, reward)
            info = zeroed(info, pending)
        flags = tensor_of(terminated), tensor_of(truncated)
        rewards = tensor_of(reward)
        if "_hook_after_sim_step" in self.overridden:
            ended = {"terminateds": flags[0].clone(), "truncateds": flags[1].clone()}
            dones = tensor_of(terminated | truncated)
            self._hook_after_sim_step(obs, action, rewards, dones, info, **ended, **kwargs)

        ids = episodes.ids.copy() if self.observers else episodes.ids
        obs = self._autoreset(obs, info, terminated, truncated)
        if self.observers:
            results = reward, terminated, truncated, info, obs, ids
            record = StepRecord(self.control_step, given, *results)
            for observer in self.observers:
                observer.on_step(self, record)
        return obs, rewards, *flags, info

    def _going_on(self, terminated: Mask, truncated: Mask, pending: Mask | None) -> EnvIndex | None:
        """Environments whose episode goes on after this step, None for all."""
        ended = terminated | truncated
        if pending is not None:
            ended |= pending
        return None if none_set(ended) else self.arrays.where(~ended)

    def _act(self, action: EnvAction) -> EnvAction:
        """Apply an action; return the one that rewards receive."""
        if len(self.action_manager):
            if not isinstance(action, torch.Tensor):
                raise TypeError(f"action terms take a tensor (N, A), got {type(action).__name__}")
            self.action_manager.apply(action)
        seen = self._step_action(action)
        return action if seen is None else seen

    def _autoreset(
        self, obs: Observation, info: Info, terminated: Mask, truncated: Mask
    ) -> Observation:
        """Reset environments as the autoreset mode says; return the observation after it."""
        mode = self.metadata["autoreset_mode"]
        done = None if none_set(terminated) and none_set(truncated) else terminated | truncated
        if mode is AutoresetMode.SAME_STEP and done is not None:
            add_finals(info, obs, done)
        elif mode is AutoresetMode.NEXT_STEP:
            done, self.episodes.pending = self.episodes.pending, done
        else:
            return obs
        if done is None or none_set(done):
            return obs
        ids = self.arrays.where(done)
        self._reset_rows(ids, {})
        return self._observe_reset(ids, {})

    # -- the rest ------------------------------------------------------------------------------

    def render(self, view: str = "default") -> NDArray[np.uint8] | None:
        """Draw environment 0 as (480, 640, 3) RGB; None unless `render_mode` is ``rgb_array``.

        Raises:
            RenderError: If no OpenGL library works; names the package to install.
            ValueError: If there is no such view or camera.
        """
        require_open(self._closed)
        return self.sim.render(camera=view) if self.render_mode == "rgb_array" else None

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
        found = as_env_ids(env_ids, self.num_envs)
        ids = self.arrays.every(self.num_envs) if found is None else found
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
        return restoring.state_of(self)

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue exactly where `state_dict` was taken, in an environment of the same config.

        Raises:
            ValueError: If the number of environments differs.
        """
        require_open(self._closed)
        restoring.load_state(self, saved)
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


EmbodiedEnv = BaseEnv
"""EmbodiChain's name for an environment built from its config."""
