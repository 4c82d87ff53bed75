"""What a recorder can be told. Pure data: no file is opened here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

__all__ = ["COMPRESSIONS", "STATES", "RecordLike", "RecordOptions", "check_options"]

STATES = ("all", "keyframes", "none")
COMPRESSIONS = ("zstd", "lz4", "none")


class RecordLike(Protocol):
    """The attributes a recorder reads: `RecordOptions` has them, and so does `record` in YAML."""

    @property
    def state(self) -> str:
        """See `RecordOptions`."""

    @property
    def view_envs(self) -> Sequence[int]:
        """See `RecordOptions`."""

    @property
    def view_hz(self) -> float:
        """See `RecordOptions`."""

    @property
    def compression(self) -> str:
        """See `RecordOptions`."""

    @property
    def keyframe_every(self) -> int:
        """See `RecordOptions`."""

    @property
    def every(self) -> int:
        """See `RecordOptions`."""

    @property
    def max_mb(self) -> float | None:
        """See `RecordOptions`."""


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """How much is recorded, and how it is packed."""

    state: str = "all"
    """``all``: everything that replay needs, of every environment. ``keyframes``: the same with
    states only every `keyframe_every` steps; what lies between is simulated again. ``none``: only
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


def check_options(options: RecordLike, num_envs: int) -> None:
    """Raise `ConfigError` with every value that is not allowed."""
    problems = []
    if options.state not in STATES:
        problems.append(
            Problem(
                "record.state",
                f"{options.state!r} is not one of {', '.join(STATES)}.",
                did_you_mean(str(options.state), STATES).strip(),
            )
        )
    if options.compression not in COMPRESSIONS:
        problems.append(
            Problem(
                "record.compression",
                f"{options.compression!r} is not one of {', '.join(COMPRESSIONS)}.",
                did_you_mean(str(options.compression), COMPRESSIONS).strip(),
            )
        )
    if not options.view_hz > 0:
        problems.append(
            Problem("record.view_hz", f"{options.view_hz!r} must be positive (1/s, simulated)")
        )
    for name in ("keyframe_every", "every"):
        value = getattr(options, name)
        if value < 1:
            problems.append(Problem(f"record.{name}", f"{value!r} must be at least 1"))
    if options.max_mb is not None and not options.max_mb > 0:
        problems.append(Problem("record.max_mb", f"{options.max_mb!r} must be positive"))
    outside = [i for i in options.view_envs if not 0 <= i < num_envs]
    if outside:
        problems.append(
            Problem(
                "record.view_envs",
                f"{outside} do not exist: there are environments 0 to {num_envs - 1}",
            )
        )
    if problems:
        raise ConfigError(problems)
