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
    """Pictures in a log, for other programs: a replay draws them again and does not need them."""

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
        problems += _check_choice(f"record.{name}", getattr(options, name), allowed)
    if not options.view_hz > 0:
        message = f"{options.view_hz!r} must be positive (1/s, simulated)"
        problems.append(Problem("record.view_hz", message))
    for name in ("keyframe_every", "every"):
        value = getattr(options, name)
        if value < 1:
            problems.append(Problem(f"record.{name}", f"{value!r} must be at least 1"))
    if options.max_mb is not None and not options.max_mb > 0:
        problems.append(Problem("record.max_mb", f"{options.max_mb!r} must be positive"))
    missing_envs = [env_id for env_id in options.view_envs if not 0 <= env_id < num_envs]
    if missing_envs:
        message = f"{missing_envs} do not exist: there are environments 0 to {num_envs - 1}"
        problems.append(Problem("record.view_envs", message))
    if options.images is not None:
        problems += _check_images(options.images, num_envs)
    if problems:
        raise ConfigError(problems)


def _check_choice(path: str, value: object, allowed: Sequence[str]) -> list[Problem]:
    if value in allowed:
        return []
    message = f"{value!r} is not one of {', '.join(allowed)}."
    return [Problem(path, message, did_you_mean(str(value), allowed).strip())]


def _check_images(options: ImageOptions, num_envs: int) -> list[Problem]:
    problems = _check_choice("record.images.format", options.format, FORMATS)
    if not options.rate > 0:
        message = f"{options.rate!r} must be positive (1/s, simulated)"
        problems.append(Problem("record.images.rate", message))
    if options.size is not None and not 0 < min(options.size) <= max(options.size) <= LARGEST_SIDE:
        message = f"{list(options.size)} must be from 1 to {LARGEST_SIDE} pixels"
        problems.append(Problem("record.images.size", message))
    missing_envs = [env_id for env_id in options.envs if not 0 <= env_id < num_envs]
    if missing_envs or not options.envs:
        message = f"{missing_envs or 'none'}: there are environments 0 to {num_envs - 1}"
        problems.append(Problem("record.images.envs", message))
    return problems
