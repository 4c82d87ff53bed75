"""The options of a recorder. Pure data: no file is opened here."""

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
    """How much is recorded, and how it is packed."""

    state: str = "all"
    """``all``: everything that replay needs, of every environment. ``keyframes``: the same with
    states only every `keyframe_every` steps; what is between is simulated again. ``none``: only
    what people look at; such a file cannot be verified."""
    view_envs: Sequence[int] = (0,)
    """Environments whose poses, joints and metrics viewers show."""
    view_hz: float = 10.0
    """How often they are sampled, in 1/s of simulated time; at most once a control step."""
    compression: str = "zstd"
    """``zstd`` with its fastest strategy, ``lz4`` or ``none``."""
    keyframe_every: int = 100
    """Control steps from one state to the next with ``keyframes``."""
    every: int = 1
    """k records every k-th episode of the first viewed environment (of environment 0 without one),
    and meanwhile all environments; in between only how episodes end."""
    max_mb: float | None = None
    """Megabytes (10^6 bytes) after which the log goes on in another file; None: never."""


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
