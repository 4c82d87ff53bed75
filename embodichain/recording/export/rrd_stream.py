"""A recording of Rerun's as it is written: its timelines, and what is sent to it in columns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.export.formats import required
from embodichain.recording.header import Header

__all__ = ["Stream", "path_of"]


def path_of(root: str, name: str) -> str:
    """The entity path of something below `root`; a slash in its name parts it."""
    rr = required("rerun", "rrd")
    return "/".join([root, *(rr.escape_entity_path_part(part) for part in name.split("/") if part)])


_PALETTE = (
    *(0x4E98E2, 0xF5774D, 0xF7DF71, 0x5CD6A9, 0xA395E2),
    *(0xEA4D6C, 0x61CBFF, 0x9AA5B1, 0xC08552),
)


class Stream:
    """An `.rrd` file with the timelines ``step`` (control steps) and ``sim_time`` (seconds).

    It is held in memory until `save`: rerun's own writer waits for ever where the disk is full.

    Args:
        header: Of the log: length of a step, start of the run, task, seed.
        blueprint: What a viewer shows at first.

    Raises:
        ConfigError: If rerun is not installed.
    """

    def __init__(self, header: Header, blueprint: Any) -> None:
        self.rr: Any = required("rerun", "rrd")
        self._dt = header.control_dt
        # The same log gives the same recording: a viewer shows a second export in its place.
        name = f"{header.task}-{header.seed}-{header.start_ns}"
        made = self.rr.RecordingStream("embodichain", recording_id=name)
        self._bytes: Any = made.binary_stream()
        made.send_blueprint(blueprint, make_active=False)
        made.set_log_time_enabled(False)  # neither is of the run
        made.set_log_tick_enabled(False)
        made.send_recording_name(f"{header.task}, seed {header.seed}")
        made.send_recording_start_time_nanos(header.start_ns)
        self._recording: Any = made

    def save(self, path: Path) -> None:
        """Write the file; nothing can be sent afterwards.

        Raises:
            OSError: If it cannot be written.
        """
        with path.open("xb") as file:
            file.write(self._bytes.read() or b"")
        self._recording.disconnect()

    def about(self, facts: dict[str, str]) -> None:
        """Add properties of the recording."""
        self._recording.send_property("embodichain", self.rr.AnyValues(**facts))

    def log(self, path: str, archetype: Any, step: int | None) -> None:
        """Send something at a step; None is at all times."""
        if step is not None:
            self._recording.set_time("step", sequence=step)
            self._recording.set_time("sim_time", duration=step * self._dt)
        self._recording.log(path, archetype, static=step is None, strict=True)

    def columns(self, path: str, steps: NDArray[np.int64], columns: Iterable[Any]) -> None:
        """Send columns, a row for each of the steps."""
        rr = self.rr
        times = [
            rr.TimeColumn("step", sequence=steps),
            rr.TimeColumn("sim_time", duration=steps.astype(np.float64) * np.float64(self._dt)),
        ]
        self._recording.send_columns(path, times, columns, strict=True)

    def name(self, path: str, names: Sequence[str]) -> None:
        """Say what the curves at a path are called."""
        colors = np.resize(np.array(_PALETTE, np.uint32) << 8 | 0xFF, len(names))
        self.log(path, self.rr.SeriesLines(names=names, colors=colors), None)

    def curves(self, path: str, steps: NDArray[np.int64], values: NDArray[Any]) -> None:
        """Send (T, K) numbers: K curves."""
        if values.size:
            flat = self.rr.Scalars.columns(scalars=values.astype(np.float64).reshape(-1))
            self.columns(path, steps, flat.partition(np.full(len(values), values.shape[1])))

    def lines(self, path: str, lines: Sequence[tuple[int, str, str]]) -> None:
        """Send lines of text: step, level, text."""
        if lines:
            steps, levels, texts = zip(*lines, strict=True)
            columns = self.rr.TextLog.columns(text=texts, level=levels)
            self.columns(path, np.array(steps, np.int64), columns)
