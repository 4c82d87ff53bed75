"""Checks of what stands beside a term's `func` and `params`: intervals, noise, delays, names.

What types and ranges express is checked by pydantic; here is what relates one value to another.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from embodichain.lab.gym.envs.cfg import (
    ActionTermCfg,
    CommandCfg,
    EnvCfg,
    EventCfg,
    NoiseCfg,
    ObservationCfg,
    TermCfg,
)
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean

__all__ = ["check_corruption", "check_fields"]

_NOISE = {
    "gaussian": ("mean", "std"),
    "uniform": ("low", "high", "n_min", "n_max"),
    "constant": ("bias",),
}
_ALIASES = (("low", "n_min"), ("high", "n_max"))


def check_fields(path: str, term: TermCfg) -> list[Problem]:
    """Return the mistakes of one term beside `func` and `params`.

    Args:
        path: Its key path.
        term: Its declaration.
    """
    if isinstance(term, EventCfg):
        return _check_times(f"{path}.interval_range_s", term.interval_range_s)
    if isinstance(term, CommandCfg):
        return _check_times(f"{path}.resampling_time_s", term.resampling_time_s)
    if isinstance(term, ObservationCfg):
        return _check_observation(path, term)
    return _check_disturbance(path, term) if isinstance(term, ActionTermCfg) else []


def _check_times(path: str, seconds: Sequence[float] | None) -> list[Problem]:
    if seconds is None or 0 < seconds[0] <= seconds[1] < float("inf"):
        return []
    return [Problem(path, f"needs 0 < low <= high, got [{seconds[0]}, {seconds[1]}]")]


def _check_observation(path: str, term: ObservationCfg) -> list[Problem]:
    found = _check_disturbance(path, term)
    if term.clip is not None and not term.clip[0] <= term.clip[1]:
        found.append(Problem(f"{path}.clip", f"low exceeds high in {list(term.clip)}"))
    if term.name is not None and not all(term.name.split("/")):
        found.append(Problem(f"{path}.name", f"has an empty part: {term.name!r}"))
    return found


def _check_disturbance(path: str, term: ActionTermCfg | ObservationCfg) -> list[Problem]:
    """Check noise and delay, which actions and observations have."""
    found = [] if term.noise is None else _check_noise(f"{path}.noise", term.noise)
    delay: Any = term.delay
    low, high = (delay, delay) if isinstance(delay, int) else delay
    if not 0 <= low <= high:
        found.append(Problem(f"{path}.delay", f"needs 0 <= low <= high, got {delay}"))
    return found


def _check_noise(path: str, noise: Any) -> list[Problem]:
    if not isinstance(noise, NoiseCfg):  # of Python's API: YAML's is checked for types before
        kind = type(noise).__name__
        return [Problem(path, f"must be a NoiseCfg, got {kind}; NoiseCfg.from_dict makes one")]
    if noise.type not in _NOISE:
        hint = did_you_mean(str(noise.type), _NOISE).strip()
        message = f"unknown type {noise.type!r}; one of: {', '.join(_NOISE)}"
        return [Problem(f"{path}.type", message, hint)]
    allowed = _NOISE[noise.type]
    given = [n for names in _NOISE.values() for n in names if getattr(noise, n) is not None]
    strange = [name for name in given if name not in allowed]
    found = [
        Problem(f"{path}.{n}", f"noise of type {noise.type!r} takes {', '.join(allowed)}")
        for n in strange
    ]
    for name, alias in _ALIASES:
        if name in given and alias in given:
            found.append(Problem(f"{path}.{alias}", f"means the same as {name}: leave one out"))
    needed = {"gaussian": ("std",), "uniform": ("low", "high"), "constant": ("bias",)}[noise.type]
    aliases = dict(_ALIASES)
    missing = [n for n in needed if n not in given and aliases.get(n) not in given]
    found += [
        Problem(f"{path}.{n}", f"missing; noise of type {noise.type!r} needs it")
        for n in missing
        if not strange
    ]
    wild = [n for n in given if not np.isfinite(np.asarray(getattr(noise, n))).all()]
    found += [Problem(f"{path}.{name}", "must be finite") for name in wild]
    return found or _check_noise_order(path, noise)


def _check_noise_order(path: str, noise: NoiseCfg) -> list[Problem]:
    if noise.type == "gaussian" and (np.asarray(noise.std) < 0).any():
        return [Problem(f"{path}.std", f"must not be negative, got {noise.std}")]
    if noise.type != "uniform":
        return []
    low = noise.n_min if noise.low is None else noise.low
    high = noise.n_max if noise.high is None else noise.high
    lists = [bound for bound in (low, high) if isinstance(bound, list)]
    if len({len(bound) for bound in lists}) > 1:
        return [Problem(path, f"low has {len(lists[0])} values, high {len(lists[1])}")]
    if (np.asarray(low) > np.asarray(high)).any():
        return [Problem(path, f"low {low} exceeds high {high}")]
    return []


def check_corruption(cfg: EnvCfg) -> list[Problem]:
    """Return the groups in `enable_corruption` that no observation is in."""
    if isinstance(cfg.enable_corruption, bool):
        return []
    groups = list(dict.fromkeys(term.group for term in cfg.observations.values()))
    return [
        Problem(
            f"enable_corruption.{name}",
            f"no observation is in group {name!r}; there are: {', '.join(groups) or 'none'}",
            did_you_mean(name, groups).strip(),
        )
        for name in cfg.enable_corruption
        if name not in groups
    ]
