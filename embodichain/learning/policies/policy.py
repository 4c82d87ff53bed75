"""`load_policy`, and `LearnedPolicy`: a model of Stable-Baselines3 as a policy."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm

from embodichain.learning.checkpoints.checkpoint import (
    find_checkpoint,
    has_script,
    read_digest,
    read_note,
)
from embodichain.learning.checkpoints.curriculum_stage import read_stage
from embodichain.learning.checkpoints.trust import NeedsTrust, say_trusted
from embodichain.learning.cloning.chunk_policy import ChunkPolicy
from embodichain.learning.policies.configured_model import load_configured, run_config
from embodichain.learning.policies.exported import SUFFIXES, ExportedPolicy, load_exported
from embodichain.learning.policies.trained_policy import TrainedPolicy
from embodichain.learning.sb3.algorithms import algorithm_class
from embodichain.learning.sb3.asymmetric import actor_space
from embodichain.learning.sb3.normalization import (
    NormalizeStatistics,
    load_statistics,
    number_keys,
    statistics_path,
)
from embodichain.learning.sb3.plain_model import UNUSED, load_plain, pickled_names
from embodichain.learning.spaces import UNBOUNDED, ActionScale, LearnerView
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.types import EnvObs
    from embodichain.utils.array_types import EnvIds

__all__ = ["LearnedPolicy", "load_checkpoint", "load_model", "load_policy"]

_OBS_NORMALIZED = ("obs", "both", True)
F32 = NDArray[np.float32]
_log = logging.getLogger(__name__)


def load_policy(
    path: str | Path,
    env: BaseEnv | None = None,
    *,
    deterministic: bool = True,
    allow_changed: bool = False,
    trust: bool = False,
) -> LearnedPolicy | ExportedPolicy:
    """Load a policy saved by `embodichain train` or `export`, or by Stable-Baselines3 itself.

    No code of the file is run: weights are read as weights, spaces and arguments as data, and
    classes of networks are those of Stable-Baselines3 and of this package, by their names. Where
    that cannot be, in the folder of a run and with `env`, spaces and arguments are those of the
    run's config. Any other file, and TorchScript that does more than compute, needs `trust`.

    Args:
        path: A zip file, with ``NAME.normalize.npz`` beside it if observations were normalized; an
            ``.onnx``, ``.pt`` or ``.ts`` file; or a run folder with ``checkpoints/final.zip``.
        env: The environment that it will act in; if given, the policy is checked against it now
            instead of at the first action.
        deterministic: The mean action; otherwise actions are drawn from torch's global generator.
        allow_changed: Whether to accept, with a warning, a task that differs from that of training
            by the file's `TaskDigest`. A file without a digest (of Stable-Baselines3 itself or
            another program) is not compared, with a warning.
        trust: Whether to run code of the file where it cannot be read without: only for a file
            whose maker you trust as that of a program.

    Returns:
        The policy: ``policy(obs, env) -> (N, A)``.

    Raises:
        ConfigError: If the file does not exist or is not a policy, if its statistics are missing,
            if it does not fit, if it was trained in another task (names the differences), or if it
            can only be read by running code of it (`NeedsTrust`: names what that would run).
    """
    file = find_checkpoint(path)
    policy: LearnedPolicy | ExportedPolicy
    if file.suffix in SUFFIXES:
        policy = _load_mean_actions(file, deterministic=deterministic, trust=trust)
    else:
        policy = load_checkpoint(file, env, deterministic=deterministic, trust=trust)
    policy.allow_changed = allow_changed
    policy.stage = read_stage(file)
    if policy.trained_in is None:
        _log.warning("%s does not say what it was trained in: the task is not compared", file)
    if env is not None:
        policy.check(env)
    return policy


def load_checkpoint(
    file: Path, env: BaseEnv | None = None, *, deterministic: bool = True, trust: bool = False
) -> LearnedPolicy | ExportedPolicy:
    """Load a zip of any algorithm; arguments as of `load_policy`.

    Raises:
        ConfigError: If the file is not a policy, needs `trust`, or its statistics are missing.
    """
    if has_script(file):
        return _load_mean_actions(file, deterministic=deterministic, trust=trust)
    return load_model(file, env, deterministic=deterministic, trust=trust)


def _load_mean_actions(file: Path, *, deterministic: bool, trust: bool) -> ExportedPolicy:
    """Load a file that has no distribution of actions, only their means."""
    if not deterministic:
        message = f"{file} gives mean actions only: leave deterministic=false out"
        raise ConfigError([Problem("policy", message)])
    return load_exported(file, trust=trust)


def load_model(
    file: Path, env: BaseEnv | None = None, *, deterministic: bool = True, trust: bool = False
) -> LearnedPolicy:
    """Load a zip of Stable-Baselines3 with its statistics; arguments as of `load_policy`.

    Raises:
        ConfigError: If the file is not a policy, needs `trust`, or its statistics are missing.
    """
    note = read_note(file)
    algo = str(note.get("algo"))
    algorithm = algorithm_class(algo)
    statistics = _load_statistics(file)
    group = str(note.get("group", "policy"))
    # In a fork of the generators, whose state here does not change.
    with torch.random.fork_rng(devices=()):
        try:
            model = load_plain(file, algorithm)
        except NeedsTrust:
            configured_model = None
            if env is not None:
                configured_model = load_configured(file, algo, group, env)
            if configured_model is not None:
                model = configured_model
            elif trust:
                model = _load_trusted(file, algorithm)
            else:
                raise
    return LearnedPolicy(
        model,
        group,
        name=str(file),
        deterministic=deterministic,
        statistics=statistics,
        note=note,
    )


def _load_trusted(file: Path, algorithm: type[BaseAlgorithm]) -> BaseAlgorithm:
    """Load a model as Stable-Baselines3 does, which runs code of the file."""
    say_trusted(file, pickled_names(file))
    try:
        return algorithm.load(file, device="cpu", custom_objects=dict(UNUSED))
    except Exception as error:  # a damaged pickle may raise anything
        message = f"{file} cannot be loaded: {type(error).__name__}: {error}"
        raise ConfigError([Problem("policy", message)]) from error


class LearnedPolicy(TrainedPolicy):
    """A model of Stable-Baselines3 that acts in batched environments.

    Args:
        model: The model, trained on an `SB3VecEnv`.
        group: The observation group it was trained on.
        name: Its name in messages.
        deterministic: Whether it returns the mean action.
        statistics: Statistics to normalize observations; None if training did not normalize.
        note: Metadata of its checkpoint: ``algo``, ``task`` and the digest of the task.

    Raises:
        ConfigError: If the model's spaces are not those of an `SB3VecEnv`.
    """

    def __init__(
        self,
        model: BaseAlgorithm,
        group: str,
        name: str = "policy",
        deterministic: bool = True,
        statistics: NormalizeStatistics | None = None,
        note: Mapping[str, Any] | None = None,
    ) -> None:
        note = note or {}
        super().__init__(name, group, read_digest(note, Path(name)))
        self.model = model
        self.deterministic = deterministic
        self.statistics = statistics
        self.algo: str | None = note.get("algo")
        self.task: str | None = note.get("task")
        self._scale: ActionScale | None = None
        self._state: tuple[NDArray[Any], ...] | None = None
        self._starts: NDArray[np.bool_] | None = None
        self._last_view: LearnerView | None = None
        self._viewed_env: BaseEnv | None = None
        self._check_spaces()

    def observed(self, obs: EnvObs, env: BaseEnv) -> Any:
        """Return the policy's part of an observation, as its `SB3VecEnv` did in training."""
        return self._view(env)(obs)

    def _view(self, env: BaseEnv) -> LearnerView:
        """Return the view of an environment; the one of the last call is reused."""
        if self._last_view is None or self._viewed_env is not env:
            is_dict = isinstance(self.model.observation_space, spaces.Dict)
            self._last_view = LearnerView(env, self.group, flatten=not is_dict)
            self._viewed_env = env
        return self._last_view

    def predict(self, obs: Any) -> F32:
        """Return (N, A) actions in [-1, 1] for unnormalized observations: an array, or a dict."""
        actions, self._state = self.model.predict(
            self._normalized(obs),
            state=self._state,
            episode_start=self._starts,
            deterministic=self.deterministic,
        )
        if self._starts is not None:
            self._starts[:] = False
        return np.asarray(actions, np.float32)

    def plan(self, obs: Any) -> F32:
        """Return (N, H, A) what a `ChunkPolicy` predicts, in units of the task last checked.

        Raises:
            RuntimeError: If the policy is another one, or was checked against no environment.
        """
        network = self.model.policy
        if self._scale is None or not isinstance(network, ChunkPolicy):
            raise RuntimeError("only a checked policy with chunks of actions has a plan")
        chunks = network.plan(self._normalized(obs))
        return self._scale(chunks.reshape(-1, chunks.shape[-1])).reshape(chunks.shape)

    def _normalized(self, obs: Any) -> Any:
        statistics = self.statistics
        if statistics is None or not statistics.norm_obs:
            return obs
        return statistics.normalize(obs)

    def act(self, obs: Any) -> F32:
        """Return (N, A) actions for observations (N, ...), in units of the task last checked.

        Raises:
            RuntimeError: If the policy was not checked against an environment.
        """
        if self._scale is None:
            raise RuntimeError("the policy was checked against no environment yet")
        return self._scale(self.predict(obs))

    def reset(self, env_ids: EnvIds | None) -> None:
        """Reset the state of a policy with memory for these environments; None is all."""
        if self._starts is not None:
            self._starts[... if env_ids is None else env_ids] = True

    def _fit(self, env: BaseEnv) -> None:
        scale = ActionScale(env.single_action_space)
        action_space: Any = self.model.action_space
        differences: list[str] = []
        obs_shape = _shape(actor_space(self.model.policy))
        task_obs_shape = _shape(self._view(env).space)
        if obs_shape != task_obs_shape:
            differences.append(f"has observations {obs_shape}, this task has {task_obs_shape}")
        action_shape = _shape(action_space)
        task_action_shape = _shape(scale.space)
        if action_shape != task_action_shape:
            differences.append(f"has actions {action_shape}, this task has {task_action_shape}")
        if not differences and not np.array_equal(action_space.high, scale.space.high):
            differences.append("has other columns with bounds of actions than this task")
        if differences:
            raise ConfigError([Problem("policy", f"{self.name} {'; '.join(differences)}")])
        self._scale = scale
        self._state = None
        self._starts = np.ones(env.num_envs, np.bool_)

    def _check_spaces(self) -> None:
        """Check that the model's spaces are those of an `SB3VecEnv`, and fit the statistics."""
        observation_space: Any = self.model.observation_space
        action_space: Any = self.model.action_space
        normalizes = self.statistics is not None and self.statistics.norm_obs
        problems: list[str] = []
        if not isinstance(observation_space, (spaces.Box, spaces.Dict)):
            problems.append(f"sees {observation_space}, not an array or a dict of arrays")
        elif self.statistics is not None and normalizes:
            shape = _normalized_shape(observation_space)
            if self.statistics.shape != shape:
                problems.append(
                    f"reads observations {shape}, its statistics are for {self.statistics.shape}"
                )
        if not _is_of_vec_env(action_space):
            problems.append(f"acts in {action_space}, not in [-1, 1] as on an SB3VecEnv")
        if problems:
            raise ConfigError([Problem("policy", f"{self.name} {text}") for text in problems])


def _is_of_vec_env(action_space: Any) -> bool:
    """Whether every column of actions is in [-1, 1], or in `UNBOUNDED` ones."""
    if not isinstance(action_space, spaces.Box):
        return False
    if not np.isin(action_space.high, (1.0, UNBOUNDED)).all():
        return False
    return bool((action_space.low == -action_space.high).all())


def _normalized_shape(space: Any) -> Any:
    """Return the shape of an observation's normalized part; name -> shape for a dict."""
    if isinstance(space, spaces.Dict):
        return {name: space[name].shape for name in number_keys(space)}
    return space.shape


def _shape(space: Any) -> Any:
    """Return the shape of a space's values; name -> shape for a dict."""
    if isinstance(space, spaces.Dict):
        return {name: entry.shape for name, entry in space.items()}
    return space.shape


def _load_statistics(file: Path) -> NormalizeStatistics | None:
    """Load the statistics beside a checkpoint; required if its run normalized observations."""
    path = statistics_path(file)
    if path.exists() or _run_normalized(file):
        return load_statistics(path)
    return None


def _run_normalized(file: Path) -> bool:
    """Whether the config of a checkpoint's run normalized observations."""
    config = run_config(file)
    algo = config.get("algo") if isinstance(config, dict) else None
    return isinstance(algo, dict) and algo.get("normalize") in _OBS_NORMALIZED
