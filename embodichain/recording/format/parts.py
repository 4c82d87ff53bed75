"""A log in several files: their names, their order, and the manifest that lists them.

`rollout.mcap` continues in `rollout_0001.mcap`, then in `rollout_0002.mcap`. Every file names its
successor when it is closed, so the files can be read without the manifest. The manifest lists the
expected files and the steps in each.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.format.draws import EpisodeDraws
from embodichain.utils.errors import ConfigError
from embodichain.utils.system.atomic import write_text_at

__all__ = [
    "MANIFEST_SUFFIX",
    "LogPlace",
    "Manifest",
    "PartEntry",
    "first_file",
    "missing_part",
    "part_name",
]

MANIFEST_SUFFIX = ".manifest.json"
_LARGEST_MANIFEST = 2**26
_NAME = re.compile(r"[^/\\\0]{1,255}\Z")


def part_name(first: str, part: int) -> str:
    """Name of a file of a log: ``rollout.mcap``, ``rollout_0001.mcap``, ..."""
    if not part:
        return first
    path = Path(first)
    return f"{path.stem}_{part:04d}{path.suffix}"


@dataclass(slots=True)
class PartEntry:
    """The manifest's entry of a file; values that are not known yet are None.

    Attributes:
        name: File name in the manifest's folder.
        first_step: Its first control step.
        steps: Number of control steps in it.
        start_s: Simulated seconds from the start of the recording to its first step.
        stop_s: Simulated seconds from the start of the recording to the end of its last step.
        nbytes: Its size.
        complete: Whether it was closed.
    """

    name: str
    first_step: int
    start_s: float
    steps: int | None = None
    stop_s: float | None = None
    nbytes: int | None = None
    complete: bool = False


@dataclass(frozen=True, slots=True)
class LogPlace:
    """Where a file of a log begins, for a recorder in another process that continues there.

    Attributes:
        log_id: Identifier of the recording.
        part: Index of the file.
        step: Its first control step.
        start_ns: Wall clock of the recording's start.
        files: The manifest's entries of the files before it.
        episodes: (N,) episodes in progress.
        returns: (N,) their sums of rewards so far.
        lengths: (N,) their control steps so far.
        draws: What was drawn for them; None if that is not known.
    """

    log_id: str
    part: int
    step: int
    start_ns: int
    files: tuple[PartEntry, ...]
    episodes: NDArray[np.int64]
    returns: NDArray[np.float64]
    lengths: NDArray[np.int64]
    draws: EpisodeDraws | None = None


class Manifest:
    """The list of a log's files, rewritten atomically whenever it changes.

    Args:
        folder: Descriptor of the folder: it stays valid if the folder is renamed.
        first: Name of the first file.
        log_id: Identifier that all files of this log share.
        period_s: Length of a control step in seconds.
    """

    def __init__(self, folder: int, first: str, log_id: str, period_s: float) -> None:
        self._folder = folder
        self._id = log_id
        self._period = period_s
        self._name = Path(first).stem + MANIFEST_SUFFIX
        self.files = [PartEntry(first, first_step=0, start_s=0.0)]

    def closed(self, last_step: int, nbytes: int) -> None:
        """Note that the newest file is complete; it ends before control step `last_step`."""
        entry = self.files[-1]
        entry.steps = last_step - entry.first_step
        entry.stop_s = last_step * self._period
        entry.nbytes = nbytes
        entry.complete = True

    def begun(self, name: str, first_step: int) -> None:
        """Note that a new file was begun."""
        self.files.append(PartEntry(name, first_step, first_step * self._period))

    def write(self, complete: bool) -> None:
        """Write the manifest atomically, so that readers never find half of it."""
        content = {
            "log_id": self._id,
            "complete": complete,
            "files": [asdict(entry) for entry in self.files],
        }
        write_text_at(self._folder, self._name, json.dumps(content, indent=1))


def first_file(path: str | Path) -> Path:
    """The first file of a log.

    Args:
        path: A file of a log, the manifest of a log, or a run's folder.

    Raises:
        ConfigError: If a manifest cannot be read.
    """
    path = Path(path)
    if path.is_dir():
        return path / "rollout.mcap"
    if not path.name.endswith(MANIFEST_SUFFIX):
        return path
    names = _names(_read(path))
    if not names:
        raise ConfigError(f"{path} is not a manifest of a log: it names no files")
    return path.with_name(names[0])


def _read(path: Path) -> Mapping[str, Any]:
    try:
        if path.stat().st_size > _LARGEST_MANIFEST:
            raise ConfigError(f"{path} is not a manifest of a log: it is too large")
        manifest = json.loads(path.read_text())
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not a manifest of a log: {error}") from error
    return manifest if isinstance(manifest, dict) else {}


def _names(manifest: Mapping[str, Any]) -> list[str]:
    """The names of its files that are possible; a damaged manifest may have any values."""
    files = manifest.get("files")
    if not isinstance(files, list):
        return []
    names = [entry.get("name") for entry in files if isinstance(entry, dict)]
    return [name for name in names if isinstance(name, str) and _NAME.match(name)]


def missing_part(first: Path, name: str) -> tuple[str, bool]:
    """Describe a missing file that its predecessor names.

    Args:
        first: The first file of the log.
        name: The missing file.

    Returns:
        One line, and whether the file counts as lost: if the manifest or later files are present.
        Otherwise the file before it was copied alone, and is read alone.
    """
    folder = first.parent
    manifest = first.with_name(first.stem + MANIFEST_SUFFIX)
    pattern = re.compile(re.escape(first.stem) + r"_\d{4,}" + re.escape(first.suffix) + r"\Z")
    others = sorted(path.name for path in folder.iterdir() if pattern.match(path.name))
    # Names are compared by length first: a number may have more than four digits.
    later = [other for other in others if (len(other), other) > (len(name), name)]
    if not manifest.exists() and not later:
        return f"{name}, which continues it, is missing", False
    text = f"{name}{_steps_in(manifest, name)}, which continues it, is missing"
    if later:
        text += f"; {later[0]} and later files can be read by themselves"
    return text, True


def _steps_in(manifest: Path, name: str) -> str:
    """The steps of a file by the manifest, as text; empty if it does not say."""
    if not manifest.exists():
        return ""
    try:
        for entry in _read(manifest).get("files", []):
            if entry.get("name") == name:
                return _steps(entry)
    except (ConfigError, AttributeError, TypeError):
        pass  # a damaged manifest does not hide that the file is missing
    return ""


def _steps(entry: Mapping[str, Any]) -> str:
    first = entry.get("first_step")
    count = entry.get("steps")
    if type(first) is not int or type(count) is not int or not count:
        return ""
    return f" (steps {first} to {first + count - 1})"
