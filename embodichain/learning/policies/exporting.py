"""`export_policy`: writes a trained policy as one ONNX or TorchScript file.

Normalization, clipping and scaling to the task's bounds are part of the exported network.
"""

from __future__ import annotations

import math
import os
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray

from embodichain import __version__
from embodichain.learning.checkpoints.curriculum_stage import stage_path
from embodichain.learning.checkpoints.plain_state import write_tree
from embodichain.learning.cloning.chunk_policy import ChunkPolicy
from embodichain.learning.policies.exported import (
    INPUT,
    METADATA,
    OUTPUT,
    ExportedPolicy,
    PolicyMetadata,
    load_exported,
    need_onnx,
    script_bytes,
)
from embodichain.learning.policies.policy import LearnedPolicy
from embodichain.learning.sb3.asymmetric import actor_space
from embodichain.learning.sb3.normalization import number_keys
from embodichain.learning.spaces import observation_columns
from embodichain.learning.tensors.tensor_env import to_bounds
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.system.atomic import atomic_file

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["FORMATS", "TOLERANCE", "Format", "export_policy"]

Format = Literal["onnx", "torchscript"]
FORMATS: dict[Format, str] = {"onnx": ".onnx", "torchscript": ".pt"}
"""Format -> suffix of its files."""
TOLERANCE = 1e-5
"""Largest allowed difference of exported actions, in units of max(1, half the action's range)."""
_EXAMPLES = 256
"""Observations on which the written file is compared with the policy, at least."""
_ONNX_OPSET = 17
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


def export_policy(
    policy: LearnedPolicy | ExportedPolicy,
    env: BaseEnv,
    path: str | Path,
    form: Format,
    *,
    task: str | None = None,
) -> float:
    """Write a policy's deterministic action as a new file, and check the file.

    Args:
        policy: The result of `load_policy` for a zip, with deterministic actions.
        env: An environment of its task, for the observation columns and the action bounds; the
            policy of a checkpoint of rsl_rl or skrl plays in it.
        path: A file that does not exist yet.
        form: ``onnx`` or ``torchscript``.
        task: The task's name in the metadata; None takes it from the checkpoint.

    Returns:
        The largest difference from the policy's actions, in the task's units.

    Raises:
        ConfigError: If the policy does not fit, was trained in another task (and its
            `allow_changed` is not set), is recurrent, or draws its actions; if the file exists or
            cannot be written; or if a package is missing.
        RuntimeError: If the actions of the written file differ; the file is removed.
    """
    path = Path(path)
    if os.path.lexists(path):
        raise _exists(path)
    if isinstance(policy, LearnedPolicy):
        _check_exportable(policy)
    if form == "onnx":
        for package in ("onnx", "onnxruntime"):
            need_onnx(package)
    policy.check(env)
    network = _make_network(policy, env)
    metadata = PolicyMetadata(
        task=task or policy.task or "unknown",
        algo=policy.algo or "unknown",
        group=policy.group,
        columns=observation_columns(env, policy.group),
        action_low=tuple(network.low.tolist()),
        action_high=tuple(network.high.tolist()),
        embodichain=__version__,
        trained_in=policy.trained_in.to_json() if policy.trained_in is not None else None,
        **network.chunking,
    )
    observations = network.examples()
    policy_obs = network.split(observations)
    if isinstance(policy, LearnedPolicy) and network.chunking:
        actions = policy.plan(policy_obs)
    else:
        actions = policy.act(policy_obs)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path, new=True) as temporary:
            _WRITERS[form](network.written, observations[:2], temporary, metadata)
            difference = _compare(load_exported(temporary), observations, actions, network)
        if policy.stage is not None:
            write_tree(stage_path(path), policy.stage)
    except FileExistsError as error:
        raise _exists(path) from error
    except OSError as error:
        raise ConfigError([Problem("output", f"cannot write {path}: {error}")]) from error
    return difference


class _Network(torch.nn.Module, ABC):
    """Maps observations (N, K) of the task to actions of the task.

    Attributes:
        chunking: Metadata of a policy that predicts H actions at once: its result is (N, H, A);
            empty for other policies, with (N, A).
    """

    low: torch.Tensor
    high: torch.Tensor

    def __init__(self, group: str, env: BaseEnv) -> None:
        super().__init__()
        self.chunking: dict[str, Any] = {}
        self.width = len(observation_columns(env, group))
        space: Any = env.single_action_space
        self.register_buffer("low", torch.from_numpy(np.array(space.low, np.float32)))
        self.register_buffer("high", torch.from_numpy(np.array(space.high, np.float32)))

    @property
    def written(self) -> torch.nn.Module:
        """The module that is written to the file."""
        return self

    def split(self, obs: Any) -> Any:
        """Return flat observations (N, K), arrays or tensors, as the policy takes them."""
        return obs

    @abstractmethod
    def examples(self) -> F32:
        """Return (n, K) observations on which the file is compared with the policy."""


class _Script(_Network):
    """A policy that is TorchScript already: those of rsl_rl and skrl."""

    def __init__(self, policy: ExportedPolicy, env: BaseEnv) -> None:
        super().__init__(policy.group, env)
        if policy.module is None:
            raise ConfigError([Problem("policy", f"{policy.name} is a file of ONNX already")])
        self._policy = policy
        self._env = env
        self._script = policy.module

    @property
    def written(self) -> torch.nn.Module:
        """The TorchScript module: others cannot be traced through it."""
        return self._script

    def examples(self) -> F32:
        """Return (n, K) observations of episodes that the policy plays: its scales are unknown."""
        env = self._env
        policy = self._policy
        steps: list[F32] = []
        obs, _ = env.reset(seed=0)
        while len(steps) * env.num_envs < _EXAMPLES:
            steps.append(policy.observed(obs, env))
            obs = env.step(policy(obs, env))[0]
        return np.concatenate(steps)


class _Learned(_Network):
    """A policy of Stable-Baselines3, with normalization and scaling."""

    mean: torch.Tensor
    deviation: torch.Tensor

    def __init__(self, policy: LearnedPolicy, env: BaseEnv) -> None:
        super().__init__(policy.group, env)
        self.policy = policy.model.policy.eval()
        if isinstance(self.policy, ChunkPolicy) and self.policy.has_memory:
            self.chunking["chunk_size"] = self.policy.chunk_size
            self.chunking["ensemble_decay"] = self.policy.ensemble_decay
        self.entries = _entry_shapes(policy, env)
        self.normalizes = False
        self.clip = 0.0
        statistics = policy.statistics
        if statistics is not None and statistics.norm_obs:
            self.normalizes = True
            self.clip = statistics.clip_obs
            # float64, as in `VecNormalize`: a large mean would lose digits in float32.
            mean = self._flat(statistics.obs_mean)
            deviation = np.sqrt(self._flat(statistics.obs_var) + statistics.epsilon)
            self.register_buffer("mean", torch.from_numpy(mean))
            self.register_buffer("deviation", torch.from_numpy(deviation))

    def examples(self) -> F32:
        """Return (n, K) observations distributed as in training, some of them far outside."""
        observations = np.random.default_rng(0).normal(size=(_EXAMPLES, self.width))
        observations[::4] *= 20.0  # outside the clipping range
        if self.normalizes:
            observations = self.mean.numpy() + observations * self.deviation.numpy()
        return observations.astype(np.float32)

    def _flat(self, moments: Any) -> F64:
        """(K,) means or variances of the columns."""
        if self.entries is not None:
            moments = np.concatenate([moments[name].ravel() for name in self.entries])
        return np.array(moments, np.float64)

    def split(self, obs: Any) -> Any:
        """Return flat observations (N, K), arrays or tensors, as the policy takes them."""
        if self.entries is None:
            return obs
        entries = {}
        start = 0
        for name, shape in self.entries.items():
            end = start + math.prod(shape)
            entries[name] = obs[:, start:end].reshape(-1, *shape)
            start = end
        return entries

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """Return actions within the task's bounds."""
        if self.normalizes:
            scaled = (obs.double() - self.mean) / self.deviation
            obs = scaled.clamp(-self.clip, self.clip).float()
        policy_obs = self.split(obs)
        if isinstance(self.policy, ChunkPolicy) and self.chunking:
            action = self.policy.chunks(policy_obs)
        else:
            action = self.policy._predict(policy_obs, deterministic=True)
        return to_bounds(action, self.low, self.high)


def _make_network(policy: LearnedPolicy | ExportedPolicy, env: BaseEnv) -> _Network:
    if isinstance(policy, LearnedPolicy):
        return _Learned(policy, env)
    return _Script(policy, env)


def _check_exportable(policy: LearnedPolicy) -> None:
    """Check that a file without memory and images can act as a policy does."""
    if not policy.deterministic:
        raise ConfigError([Problem("policy", "only deterministic policies are exported")])
    space = actor_space(policy.model.policy)
    entry_count = len(space) if isinstance(space, spaces.Dict) else 1
    if len(number_keys(space)) < entry_count:
        message = f"{policy.name} reads images; only policies that read numbers can be exported"
        raise ConfigError([Problem("policy", message)])
    if hasattr(policy.model.policy, "lstm_actor"):
        message = f"{policy.name} is recurrent: a file without memory cannot act as it does"
        raise ConfigError([Problem("policy", message)])


def _entry_shapes(policy: LearnedPolicy, env: BaseEnv) -> dict[str, tuple[int, ...]] | None:
    """Return entry -> shape, in the order of the columns; None for a policy of flat vectors."""
    space = actor_space(policy.model.policy)
    if not isinstance(space, spaces.Dict):
        return None
    names = env.observation_manager.group_terms(policy.group)
    return {name: space[name].shape or () for name in names}


def _compare(written: ExportedPolicy, observations: F32, actions: F32, network: _Network) -> float:
    """Return the largest difference from the policy's actions, for one row and for all rows.

    Raises:
        RuntimeError: If the difference is too large.
    """
    half_range = np.maximum((network.high - network.low).numpy() / 2, 1.0)
    half_range = np.where(np.isinf(half_range), 1.0, half_range)
    batch_error = written.network(observations) - actions
    single_error = written.network(observations[-1:]) - actions[-1:]
    error = np.abs(np.concatenate([batch_error, single_error]))
    # `not <=`, so that NaN fails.
    if not (error <= TOLERANCE * half_range).all():
        raise RuntimeError(
            f"the exported policy differs from the model by {np.max(error):.3g}, more than "
            f"{TOLERANCE:g} of the actions' range: nothing was written"
        )
    return float(error.max())


def _write_onnx(
    network: torch.nn.Module, example: F32, path: Path, metadata: PolicyMetadata
) -> None:
    onnx = need_onnx("onnx")
    with warnings.catch_warnings(), torch.no_grad():
        # The tracing exporter: the other one needs one more package for the same graph.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            (torch.from_numpy(example),),
            str(path),
            input_names=[INPUT],
            output_names=[OUTPUT],
            dynamic_axes={INPUT: {0: "N"}, OUTPUT: {0: "N"}},
            opset_version=_ONNX_OPSET,
            dynamo=False,
        )
    model = onnx.load(str(path))
    entry = model.metadata_props.add()
    entry.key = METADATA
    entry.value = metadata.to_json()
    onnx.checker.check_model(model)
    onnx.save(model, str(path))


def _write_torchscript(
    network: torch.nn.Module, example: F32, path: Path, metadata: PolicyMetadata
) -> None:
    path.write_bytes(script_bytes(network, torch.from_numpy(example), metadata))


_WRITERS: dict[Format, Callable[[torch.nn.Module, F32, Path, PolicyMetadata], None]] = {
    "onnx": _write_onnx,
    "torchscript": _write_torchscript,
}


def _exists(path: Path) -> ConfigError:
    return ConfigError([Problem("output", f"{path} exists; it is never replaced")])
