"""What a recorder can be told. Pure data: no file is opened here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

__all__ = ["COMPRESSIONS", "STATES", "RecordLike", "RecordOptions", "check_options"]

STATES = ("all", "none")
COMPRESSIONS = ("lz4", "zstd", "none")


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


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """How much is recorded, and how it is packed."""

    state: str = "all"
    """``all``: everything that replay needs, of every environment. ``none``: only what people look
    at; such a file cannot be verified."""
    view_envs: Sequence[int] = (0,)
    """Environments whose poses, joints and metrics viewers show."""
    view_hz: float = 10.0
    """How often they are sampled, in 1/s of simulated time; at most once a control step."""
    compression: str = "lz4"
    """``lz4``, ``zstd`` or ``none``. lz4 costs the simulation least; zstd makes files smaller."""


def check_options(options: RecordLike, num_envs: int) -> None:
    """Raise `ConfigError` with every value that is not allowed."""
    problems = []
    if options.state == "keyframes":
        problems.append(Problem("record.state", "'keyframes' is not available yet; all or none"))
    elif options.state not in STATES:
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
