"""Statistics of `VecNormalize`, in a file without pickle beside a checkpoint."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize

from embodichain.learning.plain_state import read_tree, write_tree
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["NormalizeStatistics", "load_statistics", "save_statistics", "statistics_path"]

SUFFIX = ".normalize.npz"
_SETTINGS = ("clip_obs", "clip_reward", "gamma", "epsilon", "norm_obs", "norm_reward")
F64 = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, slots=True)
class NormalizeStatistics:
    """A copy of the running statistics and settings of a `VecNormalize`, with the same names.

    Mean and variance of observations are (K,), of discounted returns (); `returns` is (N,), the
    discounted return so far of each environment's episode.
    """

    obs_mean: F64
    obs_var: F64
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
        # Without norm_obs, VecNormalize has no obs_rms at all.
        width = env.observation_space.shape or ()
        obs = _observed(env) if env.norm_obs else RunningMeanStd(shape=width)
        moments = [(np.array(s.mean), np.array(s.var), float(s.count)) for s in (obs, env.ret_rms)]
        settings = (getattr(env, name) for name in _SETTINGS)
        return cls(*moments[0], *moments[1], env.returns.copy(), *settings)

    def restore(self, env: VecNormalize) -> None:
        """Set the statistics of a `VecNormalize` to the same bits; its settings are unchanged."""
        if env.norm_obs:
            _put(_observed(env), self.obs_mean, self.obs_var, self.obs_count)
        _put(env.ret_rms, self.ret_mean, self.ret_var, self.ret_count)
        env.returns = self.returns.copy()

    def normalize(self, obs: NDArray[Any]) -> NDArray[np.float32]:
        """Return observations (..., K) normalized as in training, float32.

        The formula is that of `VecNormalize`: clip((obs - mean) / sqrt(var + epsilon)).
        """
        if not self.norm_obs:
            return np.asarray(obs, np.float32)
        scaled = (obs - self.obs_mean) / np.sqrt(self.obs_var + self.epsilon)
        clipped: NDArray[Any] = np.clip(scaled, -self.clip_obs, self.clip_obs)
        return clipped.astype(np.float32)


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
    found = read_tree(Path(path), "policy", "normalization statistics")
    try:
        return NormalizeStatistics(**found)
    except TypeError as error:
        message = f"{path} has no normalization statistics: {error}"
        raise ConfigError([Problem("policy", message)]) from error


def _observed(env: VecNormalize) -> RunningMeanStd:
    """The statistics of flat observations (the wrapper's type is for dicts of them)."""
    found: Any = env.obs_rms
    if not isinstance(found, RunningMeanStd):
        raise TypeError("statistics of dict observations are not kept: learn on one flat vector")
    return found


def _put(target: RunningMeanStd, mean: F64, var: F64, count: float) -> None:
    target.mean, target.var, target.count = mean.copy(), var.copy(), count
