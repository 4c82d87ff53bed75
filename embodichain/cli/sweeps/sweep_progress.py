"""One table of the progress of a sweep, read from the folders of its jobs.

The jobs may run on other machines; what they share with this process is the sweep's folder.
"""

from __future__ import annotations

import csv
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import yaml

from embodichain.cli.sweeps.sweep_jobs import read_summary
from embodichain.cli.terminal.output import result_number
from embodichain.config.run_folder import CONFIG, SUMMARY
from embodichain.utils.env_text import shown
from embodichain.utils.errors import ConfigError

__all__ = ["JobRow", "job_label", "job_rows", "read_numbers", "show_progress", "table_of"]

PROGRESS = "progress.csv"
_SHORTEST_PERIOD_S = 10.0
"""Time between two tables, at first."""
_LONGEST_PERIOD_S = 60.0
"""Time between two tables, in the end."""
_PERIOD_SHARE = 0.1
"""Time between two tables, by the time since the sweep began."""
_MOST_ROWS = 20
"""Running jobs in a table."""
_TAIL = 4096
"""Bytes of `progress.csv` that contain its last row."""
_COLUMNS = {
    "steps": "time/total_timesteps",
    "steps/s": "time/fps",
    "return": "rollout/ep_rew_mean",
    "success": "rollout/success_rate",
}


@dataclass(frozen=True)
class JobRow:
    """The state of a job.

    Attributes:
        label: ``NUMBER KEY=VALUE ...``.
        state: ``running``, or the status in its `summary.json`.
        numbers: Steps, steps/s, return, success, as far as known.
    """

    label: str
    state: str
    numbers: dict[str, float]


def job_label(number: str, overrides: Sequence[str], keys: Sequence[str]) -> str:
    """Return the name of a job: its number, and the values of the keys that differ.

    Args:
        number: Its number, or the name of its folder.
        overrides: The job's overrides.
        keys: Keys with several values in the sweep.
    """
    words = [number]
    for override in overrides:
        word = shown(str(override)).lstrip("+")
        if word.partition("=")[0] in keys:
            words.append(word)
    return " ".join(words)


def job_rows(folder: Path, keys: Sequence[str]) -> list[JobRow]:
    """Return the state of each job that has begun, by its number.

    Args:
        folder: The sweep's folder.
        keys: Keys with several values in the sweep.
    """
    configs = [path for path in folder.glob(f"*/{CONFIG}") if ".earlier-" not in str(path)]
    folders = [path.parent for path in configs]
    folders.sort(key=lambda path: (len(path.name), path.name))  # 10 after 9
    return [_read_row(path, keys) for path in folders]


def table_of(rows: Sequence[JobRow], jobs: int) -> str:
    """Return the states as a table: running jobs one by one, the others as a count.

    Args:
        rows: The jobs that have begun.
        jobs: Number of jobs of the sweep.
    """
    counts = [f"{count} {state}" for state, count in Counter(row.state for row in rows).items()]
    if jobs > len(rows):
        counts.append(f"{jobs - len(rows)} waiting")
    lines = [f"jobs: {', '.join(counts)}"]
    running = [row for row in rows if row.state == "running"]
    table = running[:_MOST_ROWS]
    width = max((len(row.label) for row in table), default=0)
    for row in table:
        facts = [f"{name} {_text(name, value)}" for name, value in row.numbers.items()]
        label = f"[{row.label}]".ljust(width + len("[]"))
        lines.append(f"  {label}  {'  '.join(facts)}".rstrip())
    if len(running) > len(table):
        lines.append(f"  and {len(running) - len(table)} more")
    return "\n".join(lines) + "\n"


@contextmanager
def show_progress(read_rows: Callable[[], list[JobRow]], jobs: int) -> Iterator[None]:
    """Write the table to stderr while the context lasts, whenever it has changed.

    Args:
        read_rows: Returns the state of each job that has begun.
        jobs: Number of jobs of the sweep.
    """
    ended = threading.Event()
    stream = sys.stderr

    def show() -> None:
        start = time.monotonic()
        period = _SHORTEST_PERIOD_S
        previous_table = ""
        while not ended.wait(period):
            table = table_of(read_rows(), jobs)
            if table != previous_table:
                stream.write(table)
                stream.flush()
            previous_table = table
            elapsed = time.monotonic() - start
            period = min(max(_SHORTEST_PERIOD_S, _PERIOD_SHARE * elapsed), _LONGEST_PERIOD_S)

    thread = threading.Thread(target=show, name="sweep progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _read_row(folder: Path, keys: Sequence[str]) -> JobRow:
    """Read the state of a job from its folder."""
    try:
        summary = read_summary(folder)
        overrides = yaml.safe_load((folder / "overrides.yaml").read_text(encoding="utf-8")) or []
    except (OSError, ConfigError, yaml.YAMLError):  # being written
        summary = {}
        overrides = []
    state = str(summary.get("status", "running"))
    if _is_newer(folder / PROGRESS, folder / SUMMARY):
        state = "running"  # again, after it was interrupted
    return JobRow(
        label=job_label(folder.name, overrides, keys),
        state=state,
        numbers=read_numbers(folder / PROGRESS),
    )


def _is_newer(path: Path, than: Path) -> bool:
    try:
        return path.stat().st_mtime_ns > than.stat().st_mtime_ns
    except OSError:
        return False


def read_numbers(path: Path) -> dict[str, float]:
    """Return steps, steps/s, return and success of the last row of a `progress.csv`.

    The last row may be incomplete: then the one before it counts.
    """
    try:
        with path.open("rb") as stream:
            header = stream.readline().decode()
            stream.seek(max(len(header.encode()), path.stat().st_size - _TAIL))
            tail = stream.read().decode(errors="replace")
    except OSError:
        return {}
    names = next(csv.reader(StringIO(header)), [])
    last_values: dict[str, float] = {}
    for cells in csv.reader(StringIO(tail)):
        if len(cells) != len(names):  # cut off, at the tail's beginning or at the file's end
            continue
        row = dict(zip(names, cells, strict=True))
        for name, column in _COLUMNS.items():
            if row.get(column):
                last_values[name] = float(row[column])
    return {name: last_values[name] for name in _COLUMNS if name in last_values}


def _text(name: str, value: float) -> str:
    if name == "success":
        return f"{value:.0%}"
    if name == "return":
        return result_number(value)
    return f"{value:,.0f}"
