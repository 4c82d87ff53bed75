"""Lines of `/log`: what happened, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording import wire
from embodichain.recording.foxglove.messages import Log

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import StepRecord

__all__ = ["ending_text", "event_text", "ids_text", "log_line"]

_LEVELS = {name: wire.uint(2, number) for name, number in Log.Level.items()}
_NAME = wire.text(4, "embodichain")
_MOST = 8
"""Numbers and environments that a line lists."""
_WHY = ("success", "fail", "diverged")


def log_line(time_ns: int, message: str, level: str = "INFO") -> bytes:
    """`foxglove.Log`, as bytes: made by hand, because some tasks write one in every step."""
    seconds, nanos = divmod(time_ns, 1_000_000_000)
    stamp = wire.uint(1, seconds) + wire.uint(2, nanos)
    return bytes((1 << 3 | 2, len(stamp))) + stamp + _LEVELS[level] + wire.text(3, message) + _NAME


def event_text(env_id: int, term: str, mode: str, drawn: Mapping[str, NDArray[Any]]) -> str:
    """``environment 0: place_cube (reset): position 0.58 0.14 0.05, rotation 0 0 0.16``."""
    values = ", ".join(f"{name} {_numbers(value)}" for name, value in drawn.items())
    return f"environment {env_id}: {term} ({mode})" + (f": {values}" if values else "")


def ending_text(record: StepRecord, env_id: int) -> str:
    """``environment 0: episode 3 ended after 120 steps: success``."""
    flags = [key for key in _WHY if key in record.info and bool(record.info[key][env_id])]
    if not flags:
        flags = ["terminated" if record.terminated[env_id] else "out of time"]
    steps = record.info.get("elapsed_steps")
    after = f" after {int(steps[env_id])} steps" if steps is not None else ""
    episode = int(record.episode_ids[env_id])
    return f"environment {env_id}: episode {episode} ended{after}: {', '.join(flags)}"


def ids_text(ids: NDArray[np.int64]) -> str:
    """``0, 3, 5 (and 12 more)``."""
    shown = ", ".join(str(i) for i in ids[:_MOST])
    return shown if len(ids) <= _MOST else f"{shown} (and {len(ids) - _MOST} more)"


def _numbers(values: NDArray[Any]) -> str:
    flat = np.asarray(values).reshape(-1)
    shown = " ".join(f"{value:.4g}" for value in flat[:_MOST].tolist())
    return shown if len(flat) <= _MOST else f"{shown} (and {len(flat) - _MOST} more)"
