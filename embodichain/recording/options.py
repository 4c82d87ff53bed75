"""The options of a recorder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

__all__ = ["COMPRESSIONS", "STATES", "RecordOptions", "check_options"]

STATES = ("all", "keyframes", "none")
COMPRESSIONS = ("zstd", "lz4", "none")


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """What is recorded, and how it is compressed."""

    state: str = "all"
    """``all``: everything that replay needs, for every environment. ``keyframes``: the same, but
    with states only every `keyframe_every` steps; states in between are simulated again. ``none``:
    only the channels for viewers and the ends of episodes; such a log cannot be verified."""
    view_envs: Sequence[int] = (0,)
    """Environments that viewers show: poses, joints and metrics."""
    view_hz: float = 10.0
    """Sampling rate of `view_envs` in 1/s of simulated time; at most once a control step."""
    compression: str = "zstd"
    """``zstd`` with its fastest strategy, ``lz4`` or ``none``."""
    keyframe_every: int = 100
    """Number of control steps between states with ``keyframes``."""
    every: int = 1
    """k: record all environments during every k-th episode of the first viewed environment (or of
    environment 0 if none is viewed); at other times, record only how episodes end."""
    max_mb: float | None = None
    """Size in megabytes (10^6 bytes) at which a new file is begun; None: no limit."""


def check_options(options: RecordOptions, num_envs: int) -> None:
    """Raise `ConfigError` with every value that is not allowed."""
    problems = []
    for name, allowed in (("state", STATES), ("compression", COMPRESSIONS)):
        value = getattr(options, name)
        if value not in allowed:
            message = f"{value!r} is not one of {', '.join(allowed)}."
            problems.append((name, message, did_you_mean(str(value), allowed).strip()))
    if not options.view_hz > 0:
        problems.append(("view_hz", f"{options.view_hz!r} must be positive (1/s, simulated)", ""))
    for name in ("keyframe_every", "every"):
        if getattr(options, name) < 1:
            problems.append((name, f"{getattr(options, name)!r} must be at least 1", ""))
    if options.max_mb is not None and not options.max_mb > 0:
        problems.append(("max_mb", f"{options.max_mb!r} must be positive", ""))
    outside = [i for i in options.view_envs if not 0 <= i < num_envs]
    if outside:
        there = f"there are environments 0 to {num_envs - 1}"
        problems.append(("view_envs", f"{outside} do not exist: {there}", ""))
    if problems:
        raise ConfigError([Problem(f"record.{name}", *rest) for name, *rest in problems])
