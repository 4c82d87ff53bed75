"""The options of a recorder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

__all__ = ["COMPRESSIONS", "STATES", "ImageOptions", "RecordOptions", "check_options"]

STATES = ("all", "keyframes", "none")
COMPRESSIONS = ("zstd", "lz4", "none")
FORMATS = ("h264", "jpeg", "png")
LARGEST_SIDE = 8192
"""Pixels of the longer side of a picture."""


@dataclass(frozen=True, slots=True)
class ImageOptions:
    """Pictures in a log. It needs none to draw them again: they are for other programs."""

    cameras: Sequence[str] | None = None
    """Names of camera sensors, or of cameras of the scene; None: all camera sensors."""
    envs: Sequence[int] = (0,)
    """Environments."""
    format: str = "h264"
    """``h264``, ``jpeg`` or ``png``."""
    rate: float = 10.0
    """Pictures in 1/s of simulated time; at most one a control step, and one after each reset."""
    size: tuple[int, int] | None = None
    """Width and height in pixels; None: that of each camera."""


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
    images: ImageOptions | None = None
    """Pictures; None: no pictures."""
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
    if options.images is not None:
        problems += _wrong_images(options.images, num_envs)
    if problems:
        raise ConfigError([Problem(f"record.{name}", *rest) for name, *rest in problems])


def _wrong_images(options: ImageOptions, num_envs: int) -> list[tuple[str, str, str]]:
    problems = []
    if options.format not in FORMATS:
        message = f"{options.format!r} is not one of {', '.join(FORMATS)}."
        hint = did_you_mean(str(options.format), FORMATS).strip()
        problems.append(("images.format", message, hint))
    if not options.rate > 0:
        message = f"{options.rate!r} must be positive (1/s, simulated)"
        problems.append(("images.rate", message, ""))
    if options.size is not None and not 0 < min(options.size) <= max(options.size) <= LARGEST_SIDE:
        message = f"{list(options.size)} must be from 1 to {LARGEST_SIDE} pixels"
        problems.append(("images.size", message, ""))
    outside = [i for i in options.envs if not 0 <= i < num_envs]
    if outside or not options.envs:
        there = f"there are environments 0 to {num_envs - 1}"
        problems.append(("images.envs", f"{outside or 'none'}: {there}", ""))
    return problems
