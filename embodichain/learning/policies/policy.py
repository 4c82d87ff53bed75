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
        policy = _only_means(file, deterministic, trust)
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
        return _only_means(file, deterministic, trust)
    return load_model(file, env, deterministic=deterministic, trust=trust)


def _only_means(file: Path, deterministic: bool, trust: bool) -> ExportedPolicy:
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
    algorithm = algorithm_class(str(note.get("algo")))
    statistics = _statistics(file)
    group = str(note.get("group", "policy"))
    # In a fork of the generators, whose state here does not change.
    with torch.random.fork_rng(devices=()):
        try:
            model = load_plain(file, algorithm)
        except NeedsTrust:
            found = None
            if env is not None:
                found = load_configured(file, str(note.get("algo")), group, env)
            if found is None and not trust:
                raise
            model = found or _load_trusted(file, algorithm)
    return LearnedPolicy(model, group, str(file), deterministic, statistics, note)


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
        self._views: tuple[BaseEnv, LearnerView] | None = None
        self._check_spaces()

    def observed(self, obs: EnvObs, env: BaseEnv) -> Any:
        """Return the policy's part of an observation, as its `SB3VecEnv` did in training."""
        return self._view(env)(obs)

    def _view(self, env: BaseEnv) -> LearnerView:
        if self._views is None or self._views[0] is not env:
            named = isinstance(self.model.observation_space, spaces.Dict)
            self._views = env, LearnerView(env, self.group, flatten=not named)
        return self._views[1]

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
        result: F32 = np.asarray(actions, np.float32)
        return result

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
        pairs = (
            ("observations", actor_space(self.model.policy), self._view(env).space),
            ("actions", self.model.action_space, scale.space),
        )
        differences = [
            f"has {what} {_shape(have)}, this task has {_shape(want)}"
            for what, have, want in pairs
            if _shape(have) != _shape(want)
        ]
        learned: Any = self.model.action_space
        if not differences and not np.array_equal(learned.high, scale.space.high):
            differences = ["has other columns with bounds of actions than this task"]
        if differences:
            raise ConfigError([Problem("policy", f"{self.name} {'; '.join(differences)}")])
        self._scale = scale
        self._state, self._starts = None, np.ones(env.num_envs, np.bool_)

    def _check_spaces(self) -> None:
        seen: Any = self.model.observation_space
        done: Any = self.model.action_space
        problems = []
        if not isinstance(seen, (spaces.Box, spaces.Dict)):
            problems.append(f"sees {seen}, not an array or a dict of arrays")
        elif self.statistics is not None and not self.statistics.norm_obs:
            pass  # of rewards only
        elif self.statistics is not None and self.statistics.shape != _numbers(seen):
            have, want = self.statistics.shape, _numbers(seen)
            problems.append(f"sees observations {want}, its statistics are of {have}")
        whole = isinstance(done, spaces.Box) and np.isin(done.high, (1.0, UNBOUNDED)).all()
        if not whole or not (done.low == -done.high).all():
            problems.append(f"acts in {done}, not in [-1, 1] as on an SB3VecEnv")
        if problems:
            raise ConfigError([Problem("policy", f"{self.name} {what}") for what in problems])


def _numbers(space: Any) -> Any:
    """The shape of the part of an observation that is normalized; name -> shape for a dict."""
    if isinstance(space, spaces.Dict):
        return {name: space[name].shape for name in number_keys(space)}
    return space.shape


def _shape(space: Any) -> Any:
    """The shape of a space's values; name -> shape for a dict."""
    if isinstance(space, spaces.Dict):
        return {name: part.shape for name, part in space.items()}
    return space.shape


def _statistics(file: Path) -> NormalizeStatistics | None:
    """The statistics beside a checkpoint; required if its run normalized observations."""
    path, config = statistics_path(file), run_config(file)
    algo = config.get("algo") if isinstance(config, dict) else None
    normalized = isinstance(algo, dict) and algo.get("normalize") in _OBS_NORMALIZED
    return load_statistics(path) if path.exists() or normalized else None
