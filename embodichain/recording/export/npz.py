"""NPZ: the arrays of `Log.read`, (T, N, ...), and for each the names and units of its columns."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.api import Log
from embodichain.recording.export.formats import Part
from embodichain.recording.export.table import about

__all__ = ["write"]


def write(log: Log, part: Part, path: Path) -> None:
    """Write fields, their names and units, `steps`, `time`, `env_ids` and `about`."""
    data = log.read(None, part.env, part.episode, part.start, part.stop)
    arrays: dict[str, NDArray[Any]] = {
        "steps": data.steps,
        "time": data.time,
        "env_ids": data.env_ids,
        "about": np.array(json.dumps(about(log))),
    }
    for field in data:
        arrays[field] = data[field]
        arrays[f"{field}.names"] = np.array(data.names(field), np.str_)
        arrays[f"{field}.units"] = np.array([c.unit for c in data.columns[field]], np.str_)
    with path.open("xb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)
