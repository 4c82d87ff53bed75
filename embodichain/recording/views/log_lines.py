"""Lines of `/log`: what happened, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.views.messages import Log, set_time

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import StepRecord

__all__ = ["ending_text", "event_text", "ids_text", "log_line"]

_MOST = 8
"""Numbers and environments that a line lists."""
_REASONS = ("success", "fail", "diverged")


def log_line(time_ns: int, message: str, level: str = "INFO") -> bytes:
    """Return a serialized `foxglove.Log`."""
    line = Log(level=Log.Level.Value(level), message=message, name="embodichain")
    set_time(line.timestamp, time_ns)
    data: bytes = line.SerializeToString()
    return data


def event_text(env_id: int, term: str, mode: str, drawn: Mapping[str, NDArray[Any]]) -> str:
    """``environment 0: place_cube (reset): position 0.58 0.14 0.05, rotation 0 0 0.16``."""
    values = ", ".join(f"{name} {_numbers(value)}" for name, value in drawn.items())
    return f"environment {env_id}: {term} ({mode})" + (f": {values}" if values else "")


def ending_text(record: StepRecord, env_id: int) -> str:
    """``environment 0: episode 3 ended after 120 steps: success``."""
    flags = [key for key in _REASONS if key in record.info and bool(record.info[key][env_id])]
    if not flags:
        flags = ["terminated" if record.terminated[env_id] else "out of time"]
    steps = record.info.get("elapsed_steps")
    after = f" after {int(steps[env_id])} steps" if steps is not None else ""
    episode = int(record.episode_ids[env_id])
    return f"environment {env_id}: episode {episode} ended{after}: {', '.join(flags)}"


def ids_text(ids: NDArray[np.int64]) -> str:
    """``0, 3, 5 (and 12 more)``."""
    return ", ".join(map(str, ids[:_MOST].tolist())) + _more(len(ids))


def _numbers(values: NDArray[Any]) -> str:
    flat = np.asarray(values).reshape(-1)
    return " ".join(f"{value:.4g}" for value in flat[:_MOST].tolist()) + _more(len(flat))


def _more(count: int) -> str:
    return f" (and {count - _MOST} more)" if count > _MOST else ""
