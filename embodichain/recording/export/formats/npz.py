"""Arrays of NumPy, with names and units of their columns."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.export.format_register import log_format
from embodichain.recording.export.log_parts import Part, about, episodes_with_draws
from embodichain.recording.read.api import Log
from embodichain.recording.read.episodes import LogEpisode

__all__ = ["write_npz"]


@log_format("npz", suffix=".npz")
def write_npz(log: Log, part: Part, path: Path) -> None:
    """Write fields, their names and units, `steps`, `time`, `env_ids` and `about`.

    Of the E episodes for which the log has draws: `drawn.env_ids`, `drawn.episodes`, and for each
    draw an array `drawn.TERM.NAME` (E, K), NaN where it was not drawn.
    """
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
    episodes = episodes_with_draws(log, part)
    if episodes:
        arrays["drawn.env_ids"] = np.array([episode.env for episode in episodes], np.int64)
        arrays["drawn.episodes"] = np.array([episode.episode for episode in episodes], np.int64)
        arrays.update(_draws(episodes))
    with path.open("xb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def _draws(episodes: list[LogEpisode]) -> dict[str, NDArray[np.float64]]:
    """``drawn.TERM.NAME`` -> (E, K) numbers of E episodes, NaN where there are none."""
    widths: dict[str, int] = {}
    for episode in episodes:
        for name, numbers in episode.drawn.items():
            widths[name] = max(len(numbers), widths.get(name, 0))
    arrays: dict[str, NDArray[np.float64]] = {}
    for name, width in widths.items():
        values = np.full((len(episodes), width), np.nan)
        for row, episode in zip(values, episodes, strict=True):
            numbers = episode.drawn.get(name, [])
            row[: len(numbers)] = numbers
        arrays[f"drawn.{name}"] = values
    return arrays
