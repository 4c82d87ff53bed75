"""`export_policy`: writes a model of Stable-Baselines3 as one ONNX or TorchScript file.

Normalization, clipping and scaling to the task's bounds are part of the exported network.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain import __version__
from embodichain.learning.exported import (
    INPUT,
    METADATA,
    OUTPUT,
    ExportedPolicy,
    PolicyMetadata,
    load_exported,
    need_onnx,
)
from embodichain.learning.normalization import NormalizeStatistics
from embodichain.learning.policy import LearnedPolicy
from embodichain.learning.spaces import observation_columns
from embodichain.utils.atomic import atomic_file
from embodichain.utils.errors import ConfigError, Problem

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


def export_policy(
    policy: LearnedPolicy, env: BaseEnv, path: str | Path, form: Format, *, task: str | None = None
) -> float:
    """Write a policy's deterministic action as a new file, and check the file.

    Args:
        policy: The result of `load_policy` for a zip, with deterministic actions.
        env: An environment of its task, for the observation columns and the action bounds.
        path: A file that does not exist yet.
        form: ``onnx`` or ``torchscript``.
        task: The task's name in the metadata; None takes it from the checkpoint.

    Returns:
        The largest difference from Stable-Baselines3's actions, in the task's units.

    Raises:
        ConfigError: If the policy does not fit, was trained in another task (and its
            `allow_changed` is not set), is recurrent, or draws its actions; if the file exists or
            cannot be written; or if a package is missing.
        RuntimeError: If the actions of the written file differ; the file is removed.
    """
    path = Path(path)
    _refuse(policy, path)
    if form == "onnx":
        for package in ("onnx", "onnxruntime"):
            need_onnx(package)
    policy.check(env)
    network = _Network(policy, env)
    metadata = PolicyMetadata(
        task=task or policy.task or "unknown",
        algo=policy.algo or "unknown",
        group=policy.group,
        columns=observation_columns(env, policy.group),
        action_low=tuple(network.low.tolist()),
        action_high=tuple(network.high.tolist()),
        embodichain=__version__,
        trained_in=policy.trained_in.to_json() if policy.trained_in is not None else None,
    )
    observations = _observations(policy)
    wanted = policy.act(observations)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path, new=True) as temporary:
            _WRITERS[form](network, observations[:2], temporary, metadata)
            worst = _compare(load_exported(temporary), observations, wanted, network)
    except FileExistsError as error:
        raise _taken(path) from error
    except OSError as error:
        raise ConfigError([Problem("output", f"cannot write {path}: {error}")]) from error
    return worst


class _Network(torch.nn.Module):
    """Maps observations (N, K) of the task to actions (N, A) of the task."""

    mean: torch.Tensor
    deviation: torch.Tensor
    low: torch.Tensor
    high: torch.Tensor

    def __init__(self, policy: LearnedPolicy, env: BaseEnv) -> None:
        super().__init__()
        self.policy = policy.model.policy.eval()
        space: Any = env.single_action_space
        statistics = policy.statistics
        self.normalizes = statistics is not None and statistics.norm_obs
        self.clip = statistics.clip_obs if statistics is not None else 0.0
        self._buffers_of(statistics)
        self.register_buffer("low", torch.from_numpy(np.array(space.low, np.float32)))
        self.register_buffer("high", torch.from_numpy(np.array(space.high, np.float32)))

    def _buffers_of(self, statistics: NormalizeStatistics | None) -> None:
        if statistics is None:
            return
        # float64, as in `VecNormalize`: a large mean would lose digits in float32.
        deviation = np.sqrt(statistics.obs_var + statistics.epsilon)
        self.register_buffer("mean", torch.from_numpy(statistics.obs_mean.copy()))
        self.register_buffer("deviation", torch.from_numpy(deviation))

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """Return actions within the task's bounds."""
        if self.normalizes:
            scaled = (obs.double() - self.mean) / self.deviation
            obs = scaled.clamp(-self.clip, self.clip).float()
        action = self.policy._predict(obs, deterministic=True).clamp(-1.0, 1.0)
        return 0.5 * ((1.0 - action) * self.low + (1.0 + action) * self.high)


def _refuse(policy: LearnedPolicy, path: Path) -> None:
    if os.path.lexists(path):
        raise _taken(path)
    if not policy.deterministic:
        raise ConfigError([Problem("policy", "only deterministic policies are exported")])
    if len(policy.model.observation_space.shape or ()) != 1:
        message = f"{policy.name} sees images: policies of one flat vector are exported"
        raise ConfigError([Problem("policy", message)])
    if hasattr(policy.model.policy, "lstm_actor"):
        message = f"{policy.name} is recurrent: a file without memory cannot act as it does"
        raise ConfigError([Problem("policy", message)])


def _observations(policy: LearnedPolicy) -> F32:
    """(n, K) observations distributed as in training, some of them far outside."""
    space: Any = policy.model.observation_space
    drawn = np.random.default_rng(0).normal(size=(_CHECKED, *space.shape))
    drawn[::4] *= 20.0  # outside the clipping range
    if policy.statistics is not None:
        drawn = policy.statistics.obs_mean + drawn * np.sqrt(policy.statistics.obs_var)
    return drawn.astype(np.float32)


def _compare(written: ExportedPolicy, observations: F32, wanted: F32, network: _Network) -> float:
    """The largest difference from the model's actions, for one row and for all rows.

    Raises:
        RuntimeError: If the difference is too large.
    """
    found = written.act(observations)
    single = written.act(observations[-1:])
    half = np.maximum((network.high - network.low).numpy() / 2, 1.0)
    error = np.abs(np.concatenate([found - wanted, single - wanted[-1:]]))
    # `not <=`, so that NaN fails.
    if not (error <= TOLERANCE * half).all():
        raise RuntimeError(
            f"the exported policy differs from the model by {np.max(error):.3g}, more than "
            f"{TOLERANCE:g} of the actions' range: nothing was written"
        )
    return float(error.max())


def _write_onnx(network: _Network, example: F32, path: Path, metadata: PolicyMetadata) -> None:
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
    network: _Network, example: F32, path: Path, metadata: PolicyMetadata
) -> None:
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # deprecated, but C++ programs load this format
        traced: Any = torch.jit.trace(network, torch.from_numpy(example))  # type: ignore[no-untyped-call]
        torch.jit.save(traced, str(path), _extra_files={METADATA: metadata.to_json()})


_WRITERS: dict[Format, Callable[[_Network, F32, Path, PolicyMetadata], None]] = {
    "onnx": _write_onnx,
    "torchscript": _write_torchscript,
}


def _taken(path: Path) -> ConfigError:
    return ConfigError([Problem("output", f"{path} exists; it is never replaced")])
