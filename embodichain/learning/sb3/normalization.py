"""Statistics of `VecNormalize`, in a file without pickle beside a checkpoint."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize

from embodichain.learning.checkpoints.plain_state import read_tree, write_tree
from embodichain.utils.errors import ConfigError, Problem

__all__ = [
    "NormalizeStatistics",
    "load_statistics",
    "number_keys",
    "save_statistics",
    "statistics_path",
]

SUFFIX = ".normalize.npz"
_SETTINGS = ("clip_obs", "clip_reward", "gamma", "epsilon", "norm_obs", "norm_reward")
_IMAGE_DIMENSIONS = 3  # channels, height, width
F64 = NDArray[np.float64]
Moments = F64 | dict[str, F64]


@dataclasses.dataclass(frozen=True, slots=True)
class NormalizeStatistics:
    """A copy of the running statistics and settings of a `VecNormalize`, with the same names.

    Mean and variance of observations are (K,), those of a dict are dicts of its normalized entries;
    of discounted returns they are (). `returns` is (N,), the discounted return so far of each
    environment's episode.
    """

    obs_mean: Moments
    obs_var: Moments
    obs_count: float
    ret_mean: F64
    ret_var: F64
    ret_count: float
    returns: F64
    clip_obs: float
    clip_reward: float
    gamma: float
    epsilon: float
    norm_obs: bool
    norm_reward: bool

    @classmethod
    def of(cls, env: VecNormalize) -> NormalizeStatistics:
        """Copy the statistics from the wrapper of a training."""
        if env.norm_obs:
            obs_rms: Any = env.obs_rms
        else:  # VecNormalize has no obs_rms then
            obs_rms = RunningMeanStd(shape=env.observation_space.shape or ())
        obs_mean: Moments
        obs_var: Moments
        if isinstance(obs_rms, dict):
            obs_mean = {key: np.array(entry.mean) for key, entry in obs_rms.items()}
            obs_var = {key: np.array(entry.var) for key, entry in obs_rms.items()}
            obs_count = next(iter(obs_rms.values())).count  # entries are counted together
        else:
            obs_mean = np.array(obs_rms.mean)
            obs_var = np.array(obs_rms.var)
            obs_count = obs_rms.count
        return cls(
            obs_mean=obs_mean,
            obs_var=obs_var,
            obs_count=float(obs_count),
            ret_mean=np.array(env.ret_rms.mean),
            ret_var=np.array(env.ret_rms.var),
            ret_count=float(env.ret_rms.count),
            returns=env.returns.copy(),
            **{name: getattr(env, name) for name in _SETTINGS},
        )

    @property
    def shape(self) -> Any:
        """Shape of an observation; entry -> shape for a dict."""
        if isinstance(self.obs_mean, dict):
            return {key: mean.shape for key, mean in self.obs_mean.items()}
        return self.obs_mean.shape

    def restore(self, env: VecNormalize) -> None:
        """Set the statistics of a `VecNormalize` to the same bits; its settings are unchanged."""
        if env.norm_obs:
            means = _by_key(self.obs_mean)
            variances = _by_key(self.obs_var)
            for key, obs_rms in _by_key(env.obs_rms).items():
                _set_moments(obs_rms, means[key], variances[key], self.obs_count)
        _set_moments(env.ret_rms, self.ret_mean, self.ret_var, self.ret_count)
        env.returns = self.returns.copy()

    def normalize(self, obs: Any) -> Any:
        """Return observations normalized as in training, float32.

        The formula is that of `VecNormalize`: clip((obs - mean) / sqrt(var + epsilon)).

        Args:
            obs: An array (..., K), or a dict; entries without statistics, such as images, are
                passed on, and entries may be missing.
        """
        means = _by_key(self.obs_mean)
        variances = _by_key(self.obs_var)
        if not isinstance(obs, dict):
            if not self.norm_obs:
                return _f32(obs)
            return self._normalize_entry(obs, means[""], variances[""])
        entries = dict(obs)
        if self.norm_obs:
            for key in means.keys() & obs.keys():
                entries[key] = self._normalize_entry(obs[key], means[key], variances[key])
        return entries

    def _normalize_entry(self, obs: NDArray[Any], mean: F64, variance: F64) -> NDArray[np.float32]:
        scaled = (obs - mean) / np.sqrt(variance + self.epsilon)
        return _f32(np.clip(scaled, -self.clip_obs, self.clip_obs))


def number_keys(space: spaces.Space[Any]) -> list[str]:
    """Return the entries of an observation that are normalized: floating point, not images.

    Args:
        space: One observation, or a Dict; the name of the only entry of the former is "".
    """
    entries = space.spaces if isinstance(space, spaces.Dict) else {"": space}
    return [
        key
        for key, entry in entries.items()
        if entry.dtype == np.float32 and len(entry.shape or ()) < _IMAGE_DIMENSIONS
    ]


def statistics_path(checkpoint: str | Path) -> Path:
    """Return the file with the statistics of ``NAME.zip``: ``NAME.normalize.npz`` beside it."""
    path = Path(checkpoint)
    return path.with_name(path.stem + SUFFIX)


def save_statistics(path: str | Path, statistics: VecNormalize | NormalizeStatistics) -> None:
    """Write statistics atomically.

    Raises:
        OSError: The file cannot be written; no partial file remains.
    """
    if isinstance(statistics, VecNormalize):
        statistics = NormalizeStatistics.of(statistics)
    write_tree(Path(path), dataclasses.asdict(statistics))


def load_statistics(path: str | Path) -> NormalizeStatistics:
    """Read a file written by `save_statistics`; runs no code of the file.

    Raises:
        ConfigError: If the file is missing or has another format.
    """
    if not Path(path).is_file():
        message = f"{path} is missing: this policy needs the statistics its training normalized by"
        raise ConfigError([Problem("policy", message)])
    fields = read_tree(Path(path), key="policy", what="normalization statistics")
    try:
        return NormalizeStatistics(**fields)
    except TypeError as error:
        message = f"{path} has no normalization statistics: {error}"
        raise ConfigError([Problem("policy", message)]) from error


def _by_key(moments: Any) -> dict[str, Any]:
    """Return the moments of a dict by entry; those of an array have the name ""."""
    return moments if isinstance(moments, dict) else {"": moments}


def _f32(values: Any) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)


def _set_moments(statistics: RunningMeanStd, mean: F64, var: F64, count: float) -> None:
    statistics.mean = mean.copy()
    statistics.var = var.copy()
    statistics.count = count
