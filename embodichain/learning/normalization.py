"""Statistics of normalized observations and rewards: a file without pickle beside a checkpoint.

Normalizing while learning is Stable-Baselines3's `VecNormalize`; this keeps what it has counted,
for playing, exporting and resuming.
"""

from __future__ import annotations

import dataclasses
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize

from embodichain.utils.atomic import atomic_file
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["NormalizeStatistics", "load_statistics", "save_statistics", "statistics_path"]

SUFFIX = ".normalize.npz"
F64 = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, slots=True)
class NormalizeStatistics:
    """What a `VecNormalize` has counted, copied.

    Attributes:
        obs_mean: (K,) mean of observations.
        obs_var: (K,) their variance.
        obs_count: How many were counted.
        ret_mean: () mean of discounted returns.
        ret_var: () their variance.
        ret_count: How many were counted.
        returns: (N,) discounted return of each environment's episode so far.
        clip_obs: Largest normalized observation.
        clip_reward: Largest normalized reward.
        gamma: Discount of returns.
        epsilon: Added to variances.
        norm_obs: Whether observations are normalized.
        norm_reward: Whether rewards are.
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
        """Copy them from the wrapper of a training."""
        # Without norm_obs, VecNormalize has no obs_rms at all.
        width = env.observation_space.shape or ()
        obs = _observed(env) if env.norm_obs else RunningMeanStd(shape=width)
        return cls(
            obs_mean=np.array(obs.mean, np.float64),
            obs_var=np.array(obs.var, np.float64),
            obs_count=float(obs.count),
            ret_mean=np.array(env.ret_rms.mean, np.float64),
            ret_var=np.array(env.ret_rms.var, np.float64),
            ret_count=float(env.ret_rms.count),
            returns=np.array(env.returns, np.float64),
            clip_obs=float(env.clip_obs),
            clip_reward=float(env.clip_reward),
            gamma=float(env.gamma),
            epsilon=float(env.epsilon),
            norm_obs=bool(env.norm_obs),
            norm_reward=bool(env.norm_reward),
        )

    def restore(self, env: VecNormalize) -> None:
        """Let a `VecNormalize` count on from here, to the bit; its own settings stay."""
        if env.norm_obs:
            _put(_observed(env), self.obs_mean, self.obs_var, self.obs_count)
        _put(env.ret_rms, self.ret_mean, self.ret_var, self.ret_count)
        env.returns = self.returns.copy()

    def normalize(self, obs: NDArray[Any]) -> NDArray[np.float32]:
        """Return observations (..., K) as the policy saw them in training, float32.

        The formula is that of `VecNormalize`: clip((obs - mean) / sqrt(var + epsilon)).
        """
        if not self.norm_obs:
            return np.asarray(obs, np.float32)
        scaled = (obs - self.obs_mean) / np.sqrt(self.obs_var + self.epsilon)
        result: NDArray[np.float32] = np.clip(scaled, -self.clip_obs, self.clip_obs).astype(
            np.float32
        )
        return result


def statistics_path(checkpoint: str | Path) -> Path:
    """Return where the statistics of ``NAME.zip`` are: ``NAME.normalize.npz`` beside it."""
    path = Path(checkpoint)
    return path.with_name(path.stem + SUFFIX)


def save_statistics(path: str | Path, statistics: VecNormalize | NormalizeStatistics) -> None:
    """Write statistics, as a whole or not at all.

    Args:
        path: Where to, see `statistics_path`.
        statistics: They, or the wrapper that has them.

    Raises:
        OSError: It cannot be written; nothing is left behind.
    """
    if isinstance(statistics, VecNormalize):
        statistics = NormalizeStatistics.of(statistics)
    path = Path(path)
    with atomic_file(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, **dataclasses.asdict(statistics))


def load_statistics(path: str | Path) -> NormalizeStatistics:
    """Read what `save_statistics` wrote; runs nothing of the file.

    Raises:
        ConfigError: If the file is missing or is no such file.
    """
    names = {field.name: field.type for field in dataclasses.fields(NormalizeStatistics)}
    try:
        with np.load(path, allow_pickle=False) as archive:
            missing = [name for name in names if name not in archive.files]
            if missing:
                raise _wrong(path, f"it has no {', '.join(missing)}")
            arrays = {name: archive[name] for name in names}
    except FileNotFoundError as error:
        message = f"{path} is missing: this policy needs the statistics its training normalized by"
        raise ConfigError([Problem("policy", message)]) from error
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise _wrong(path, str(error)) from error
    plain = {"float": float, "bool": bool}
    values: dict[str, Any] = {
        name: plain[str(kind)](arrays[name]) if str(kind) in plain else arrays[name]
        for name, kind in names.items()
    }
    return NormalizeStatistics(**values)


def _observed(env: VecNormalize) -> RunningMeanStd:
    """The statistics of flat observations (the wrapper's type is for dicts of them)."""
    found: Any = env.obs_rms
    if not isinstance(found, RunningMeanStd):
        raise TypeError("statistics of dict observations are not kept: learn on one flat vector")
    return found


def _put(target: RunningMeanStd, mean: F64, var: F64, count: float) -> None:
    target.mean, target.var, target.count = mean.copy(), var.copy(), count


def _wrong(path: str | Path, why: str) -> ConfigError:
    return ConfigError([Problem("policy", f"{path} holds no normalization statistics: {why}")])
