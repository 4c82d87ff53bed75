"""Arrays of NumPy, with names and units of their columns."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.export.format_register import log_format
from embodichain.recording.export.log_parts import Part, about
from embodichain.recording.read.api import Log

__all__ = ["write_npz"]


@log_format("npz", suffix=".npz")
def write_npz(log: Log, part: Part, path: Path) -> None:
    """Write fields, their names and units, `steps`, `time`, `env_ids` and `about`."""
    data = log.read(env=part.env, episode=part.episode, start=part.start, stop=part.stop)
    arrays: dict[str, NDArray[Any]] = {
        "steps": data.steps,
        "time": data.time,
        "env_ids": data.env_ids,
        "about": np.array(json.dumps(about(log))),
    }
    for field in data:
        arrays[field] = data[field]
        arrays[f"{field}.names"] = np.array(data.names(field), np.str_)
        units = [column.unit for column in data.columns[field]]
        arrays[f"{field}.units"] = np.array(units, np.str_)
    with path.open("xb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)
