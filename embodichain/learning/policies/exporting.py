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
_CHECKED = 256  # number of observations on which the file is compared
_OPSET = 17
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
        raise _taken(path)
    if isinstance(policy, LearnedPolicy):
        _refuse(policy)
    if form == "onnx":
        for package in ("onnx", "onnxruntime"):
            need_onnx(package)
    policy.check(env)
    network: _Network
    network = _Learned(policy, env) if isinstance(policy, LearnedPolicy) else _Script(policy, env)
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
    split = network.split(observations)
    if isinstance(policy, LearnedPolicy) and network.chunking:
        wanted = policy.plan(split)
    else:
        wanted = policy.act(split)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path, new=True) as temporary:
            _WRITERS[form](network.written, observations[:2], temporary, metadata)
            worst = _compare(load_exported(temporary), observations, wanted, network)
        if policy.stage is not None:
            write_tree(stage_path(path), policy.stage)
    except FileExistsError as error:
        raise _taken(path) from error
    except OSError as error:
        raise ConfigError([Problem("output", f"cannot write {path}: {error}")]) from error
    return worst


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
        self._policy, self._env, self._script = policy, env, policy.module

    @property
    def written(self) -> torch.nn.Module:
        """The TorchScript module: others cannot be traced through it."""
        return self._script

    def examples(self) -> F32:
        """Return (n, K) observations of episodes that the policy plays: its scales are unknown."""
        env, policy, rows = self._env, self._policy, list[F32]()
        obs, _ = env.reset(seed=0)
        while len(rows) * env.num_envs < _CHECKED:
            rows.append(policy.observed(obs, env))
            obs = env.step(policy(obs, env))[0]
        return np.concatenate(rows)


class _Learned(_Network):
    """A policy of Stable-Baselines3, with normalization and scaling."""

    mean: torch.Tensor
    deviation: torch.Tensor

    def __init__(self, policy: LearnedPolicy, env: BaseEnv) -> None:
        super().__init__(policy.group, env)
        self.policy = policy.model.policy.eval()
        if isinstance(self.policy, ChunkPolicy) and self.policy.has_memory:
            names = ("chunk_size", "ensemble_decay")
            self.chunking = {name: getattr(self.policy, name) for name in names}
        statistics = policy.statistics
        self.entries = _entries(policy, env)
        self.normalizes = statistics is not None and statistics.norm_obs
        self.clip = statistics.clip_obs if statistics is not None else 0.0
        if statistics is not None and self.normalizes:
            # float64, as in `VecNormalize`: a large mean would lose digits in float32.
            mean, variance = self._flat(statistics.obs_mean), self._flat(statistics.obs_var)
            self.register_buffer("mean", torch.from_numpy(mean))
            deviation = np.sqrt(variance + statistics.epsilon)
            self.register_buffer("deviation", torch.from_numpy(deviation))

    def examples(self) -> F32:
        """Return (n, K) observations distributed as in training, some of them far outside."""
        drawn = np.random.default_rng(0).normal(size=(_CHECKED, self.width))
        drawn[::4] *= 20.0  # outside the clipping range
        if self.normalizes:
            drawn = self.mean.numpy() + drawn * self.deviation.numpy()
        return drawn.astype(np.float32)

    def _flat(self, moments: Any) -> F64:
        """(K,) means or variances of the columns."""
        if self.entries is not None:
            moments = np.concatenate([moments[name].ravel() for name in self.entries])
        return np.array(moments, np.float64)

    def split(self, obs: Any) -> Any:
        """Return flat observations (N, K), arrays or tensors, as the policy takes them."""
        if self.entries is None:
            return obs
        ends = np.cumsum([math.prod(shape) for shape in self.entries.values()]).tolist()
        return {
            name: obs[:, end - math.prod(shape) : end].reshape(-1, *shape)
            for (name, shape), end in zip(self.entries.items(), ends, strict=True)
        }

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """Return actions within the task's bounds."""
        if self.normalizes:
            scaled = (obs.double() - self.mean) / self.deviation
            obs = scaled.clamp(-self.clip, self.clip).float()
        seen, policy = self.split(obs), self.policy
        if isinstance(policy, ChunkPolicy) and self.chunking:
            action = policy.chunks(seen)
        else:
            action = policy._predict(seen, deterministic=True)
        return to_bounds(action, self.low, self.high)


def _refuse(policy: LearnedPolicy) -> None:
    if not policy.deterministic:
        raise ConfigError([Problem("policy", "only deterministic policies are exported")])
    space = actor_space(policy.model.policy)
    if len(number_keys(space)) < (len(space) if isinstance(space, spaces.Dict) else 1):
        message = f"{policy.name} sees images: policies of numbers are exported"
        raise ConfigError([Problem("policy", message)])
    if hasattr(policy.model.policy, "lstm_actor"):
        message = f"{policy.name} is recurrent: a file without memory cannot act as it does"
        raise ConfigError([Problem("policy", message)])


def _entries(policy: LearnedPolicy, env: BaseEnv) -> dict[str, tuple[int, ...]] | None:
    """Entry -> shape, in the order of the columns; None for a policy of flat vectors."""
    space = actor_space(policy.model.policy)
    if not isinstance(space, spaces.Dict):
        return None
    names = env.observation_manager.group_terms(policy.group)
    return {name: space[name].shape or () for name in names}


def _compare(written: ExportedPolicy, observations: F32, wanted: F32, network: _Network) -> float:
    """The largest difference from the model's actions, for one row and for all rows.

    Raises:
        RuntimeError: If the difference is too large.
    """
    found = written.network(observations)
    single = written.network(observations[-1:])
    half = np.maximum((network.high - network.low).numpy() / 2, 1.0)
    half = np.where(np.isinf(half), 1.0, half)
    error = np.abs(np.concatenate([found - wanted, single - wanted[-1:]]))
    # `not <=`, so that NaN fails.
    if not (error <= TOLERANCE * half).all():
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
            opset_version=_OPSET,
            dynamo=False,
        )
    model = onnx.load(str(path))
    entry = model.metadata_props.add()
    entry.key, entry.value = METADATA, metadata.to_json()
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


def _taken(path: Path) -> ConfigError:
    return ConfigError([Problem("output", f"{path} exists; it is never replaced")])
