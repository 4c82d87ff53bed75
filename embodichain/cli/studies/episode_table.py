"""The episodes of a study as one tidy table: a row an episode, a column a variable."""

from __future__ import annotations

import csv
import importlib.util
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.cli.studies.study_job import StudyFolder
from embodichain.config.study import Study, StudyJob
from embodichain.utils.system.atomic import atomic_file, write_text

__all__ = ["EpisodeTable", "read_episodes", "write_table", "wrong_tables"]

_KEYS = ("arm", "task", "seed", "variation", "episode")
_CSV = "episodes.csv"
_PARQUET = "episodes.parquet"
DRAWN = "drawn."
"""What the names of columns of drawn values begin with."""


@dataclass(frozen=True)
class EpisodeTable:
    """Rows of episodes.

    Attributes:
        rows: ``arm``, ``task``, ``seed``, ``variation``, ``episode``, ``success``, ``return``,
            ``length``, the tasks' metrics, ``strength.NAME`` of each variation that was on,
            ``drawn.TERM.NAME`` of what was drawn (a number an element), ``folder``. A value that an
            episode does not have is missing.
    """

    rows: tuple[dict[str, Any], ...]

    @property
    def columns(self) -> list[str]:
        """Names of all columns, in the order in which they first occur."""
        names = dict.fromkeys(name for row in self.rows for name in row)
        return [*_KEYS, *(name for name in names if name not in _KEYS)]

    def where(self, **values: Any) -> EpisodeTable:
        """Return the rows with these values."""
        matching = [row for row in self.rows if all(row[k] == v for k, v in values.items())]
        return EpisodeTable(tuple(matching))

    def column(self, name: str) -> NDArray[np.float64]:
        """Return (n,) the numbers of a column; NaN where a row has none."""
        values = [row.get(name) for row in self.rows]
        return np.array([math.nan if value is None else float(value) for value in values])

    @property
    def factors(self) -> list[str]:
        """Names of the columns with drawn numbers."""
        return [name for name in self.columns if name.startswith(DRAWN)]


def read_episodes(study: Study, place: StudyFolder) -> EpisodeTable:
    """Read the episodes of all evaluations that are done.

    Args:
        study: The study.
        place: Its folder.

    Raises:
        ConfigError: A file is damaged.
    """
    rows: list[dict[str, Any]] = []
    for job in study.jobs():
        for variation in study.variations:
            results = place.results(job, variation)
            if results is not None:
                folder = place.evaluation(job, variation).relative_to(place.path)
                rows += _rows(job, variation, results, str(folder))
    return EpisodeTable(tuple(rows))


def _rows(
    job: StudyJob, variation: str, results: dict[str, Any], folder: str
) -> Iterator[dict[str, Any]]:
    """Yield a row for each episode of an evaluation."""
    per_episode = results["per_episode"]
    strengths = job.study.cfg.evaluate.variations[variation]
    drawn = per_episode.get("drawn") or {}
    metrics = per_episode.get("metrics") or {}
    for i, env in enumerate(per_episode["env"]):
        row: dict[str, Any] = {
            "arm": job.arm,
            "task": job.task,
            "seed": job.seed,
            "variation": variation,
            "episode": env,  # the first one of its environment
        }
        if "success" in per_episode:
            row["success"] = bool(per_episode["success"][i])
        row["return"] = per_episode["return"][i]
        row["length"] = per_episode["length"][i]
        for name, values in metrics.items():
            row.setdefault(name, values[i])
        for name, strength in strengths.items():
            row[f"strength.{name}"] = strength
        for name, values in drawn.items():
            numbers = values[i] or []
            for k, number in enumerate(numbers):
                suffix = f".{k}" if len(numbers) > 1 else ""
                row[f"{DRAWN}{name}{suffix}"] = number
        row["folder"] = folder
        yield row


def wrong_tables(table: EpisodeTable, folder: Path) -> Iterator[str]:
    """Yield what is wrong with the files of `write_table`: those that are not of these episodes.

    Args:
        table: The episodes.
        folder: The folder of the files.
    """
    path = folder / _CSV
    if path.read_bytes() != _csv_text(table).encode():
        yield f"{path.name} is not that of the evaluations"
    path = folder / _PARQUET
    if path.is_file() and importlib.util.find_spec("pyarrow") is not None:
        from pyarrow import parquet

        if parquet.read_table(path).to_pydict() != _columns_of(table):
            yield f"{path.name} is not that of the evaluations"


def write_table(table: EpisodeTable, folder: Path) -> list[Path]:
    """Write ``episodes.csv``, and ``episodes.parquet`` where pyarrow is installed.

    Args:
        table: The episodes.
        folder: The folder for both; earlier ones are replaced.

    Returns:
        The files.
    """
    path = folder / _CSV
    write_text(path, _csv_text(table))
    files = [path]
    if importlib.util.find_spec("pyarrow") is not None:
        files.append(_write_parquet(table, folder / _PARQUET))
    return files


def _csv_text(table: EpisodeTable) -> str:
    stream = io.StringIO(newline="")
    writer = csv.DictWriter(stream, table.columns)
    writer.writeheader()
    writer.writerows(table.rows)
    return stream.getvalue()


def _columns_of(table: EpisodeTable) -> dict[str, list[Any]]:
    """Name -> values of each column; None where a row has none."""
    return {name: [row.get(name) for row in table.rows] for name in table.columns}


def _write_parquet(table: EpisodeTable, path: Path) -> Path:
    import pyarrow
    from pyarrow import parquet

    with atomic_file(path) as partial:
        parquet.write_table(pyarrow.table(_columns_of(table)), partial)
    return path
