"""One table of the progress of a sweep, read from the folders of its jobs.

The jobs may run on other machines; what they share with this process is the sweep's folder.
"""

from __future__ import annotations

import csv
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import yaml

from embodichain.cli.sweeps.sweep_jobs import read_summary
from embodichain.config.run_folder import CONFIG, SUMMARY
from embodichain.utils.env_text import shown
from embodichain.utils.errors import ConfigError

__all__ = ["JobRow", "job_label", "job_rows", "shown_progress", "table_of"]

PROGRESS = "progress.csv"
_FIRST_PERIOD, _LAST_PERIOD = 10.0, 60.0
"""Seconds between two tables, at first and in the end."""
_MOST_ROWS = 20
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
        overrides: Of the job.
        keys: Keys with several values in the sweep.
    """
    lines = [shown(str(line)).lstrip("+") for line in overrides]
    return " ".join([number, *(line for line in lines if line.partition("=")[0] in keys)])


def job_rows(folder: Path, keys: Sequence[str]) -> list[JobRow]:
    """Return the state of each job that has begun, by its number.

    Args:
        folder: The sweep's folder.
        keys: Keys with several values in the sweep.
    """
    found = [path.parent for path in folder.glob(f"*/{CONFIG}") if ".earlier-" not in str(path)]
    return [_row(path, keys) for path in sorted(found, key=lambda p: (len(p.name), p.name))]


def table_of(rows: Sequence[JobRow], jobs: int) -> str:
    """Return the states as a table: running jobs one by one, the others as a count.

    Args:
        rows: Of the jobs that have begun.
        jobs: Number of jobs of the sweep.
    """
    states = [row.state for row in rows]
    waiting = max(jobs - len(rows), 0)
    counts = [f"{states.count(state)} {state}" for state in dict.fromkeys(states)]
    lines = ["jobs: " + ", ".join([*counts, *([f"{waiting} waiting"] if waiting else [])])]
    running = [row for row in rows if row.state == "running"]
    width = max((len(row.label) for row in running[:_MOST_ROWS]), default=0)
    for row in running[:_MOST_ROWS]:
        facts = [f"{name} {_text(name, value)}" for name, value in row.numbers.items()]
        label = f"[{row.label}]".ljust(width + 2)
        lines.append(f"  {label}  {'  '.join(facts)}".rstrip())
    if len(running) > _MOST_ROWS:
        lines.append(f"  and {len(running) - _MOST_ROWS} more")
    return "\n".join(lines) + "\n"


@contextmanager
def shown_progress(folder: Path, keys: Sequence[str], jobs: int) -> Iterator[None]:
    """Write the table to stderr while the context lasts, whenever it has changed.

    Args:
        folder: The sweep's folder.
        keys: Keys with several values in the sweep.
        jobs: Number of jobs of the sweep.
    """
    ended = threading.Event()
    stream = sys.stderr

    def show() -> None:
        period, last = _FIRST_PERIOD, ""
        begun = time.monotonic()
        while not ended.wait(period):
            text = table_of(job_rows(folder, keys), jobs)
            if text != last:
                stream.write(text)
                stream.flush()
            last = text
            period = min(max(_FIRST_PERIOD, (time.monotonic() - begun) / 10), _LAST_PERIOD)

    thread = threading.Thread(target=show, name="sweep progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _row(folder: Path, keys: Sequence[str]) -> JobRow:
    try:
        summary = read_summary(folder)
        lines = yaml.safe_load((folder / "overrides.yaml").read_text(encoding="utf-8")) or []
    except (OSError, ConfigError, yaml.YAMLError):  # being written
        summary, lines = {}, []
    state = str(summary.get("status", "running"))
    if _is_newer(folder / PROGRESS, folder / SUMMARY):
        state = "running"  # again, after it was interrupted
    return JobRow(job_label(folder.name, lines, keys), state, _numbers(folder / PROGRESS))


def _is_newer(path: Path, than: Path) -> bool:
    try:
        return path.stat().st_mtime_ns > than.stat().st_mtime_ns
    except OSError:
        return False


def _numbers(path: Path) -> dict[str, float]:
    """The last values in a `progress.csv`, which may be being written."""
    try:
        with path.open("rb") as stream:
            header = stream.readline().decode()
            stream.seek(max(len(header.encode()), path.stat().st_size - _TAIL))
            tail = stream.read().decode(errors="replace")
    except OSError:
        return {}
    names = next(csv.reader(StringIO(header)), [])
    found: dict[str, float] = {}
    for cells in csv.reader(StringIO(tail)):
        row = dict(zip(names, cells, strict=False)) if len(cells) == len(names) else {}
        for name, column in _COLUMNS.items():
            if row.get(column):
                found[name] = float(row[column])
    return {name: found[name] for name in _COLUMNS if name in found}


def _text(name: str, value: float) -> str:
    if name == "success":
        return f"{value:.0%}"
    return f"{value:.4g}" if name == "return" else f"{value:,.0f}"
