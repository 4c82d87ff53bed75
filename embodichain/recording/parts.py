"""A log in several files: their names, the manifest beside them, and which belongs to which.

`rollout.mcap` goes on in `rollout_0001.mcap`, that in `rollout_0002.mcap`. Every file names its
successor when it is closed, so the chain holds without the manifest; the manifest says at a glance
which steps lie where, and which files there ought to be.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from embodichain.utils.errors import ConfigError

__all__ = ["MANIFEST_SUFFIX", "Manifest", "PartEntry", "first_file", "missing_part", "part_name"]

MANIFEST_SUFFIX = ".manifest.json"
_LARGEST_MANIFEST = 2**26
_NAME = re.compile(r"[^/\\\0]{1,255}\Z")


def part_name(first: str, part: int) -> str:
    """Name of a file of a log: ``rollout.mcap``, ``rollout_0001.mcap``, ..."""
    path = Path(first)
    return f"{path.stem}_{part:04d}{path.suffix}" if part else first


@dataclass(slots=True)
class PartEntry:
    """What the manifest says of a file; what is not known yet is None.

    Attributes:
        name: In the manifest's folder.
        first_step: Control step it begins with.
        steps: Control steps in it.
        start_s: Simulated seconds from the start of the recording to its first step.
        stop_s: And to the end of its last.
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


class Manifest:
    """The list of a log's files; written anew whenever it changes, under another name first.

    Args:
        folder: Descriptor of the folder: it holds when the folder is renamed meanwhile.
        first: Name of the first file.
        log_id: What all files of this log have in common.
        period_s: Seconds a control step.
    """

    def __init__(self, folder: int, first: str, log_id: str, period_s: float) -> None:
        self._folder, self._id, self._period = folder, log_id, period_s
        self._name = Path(first).stem + MANIFEST_SUFFIX
        self.files = [PartEntry(first, 0, 0.0)]

    def closed(self, last_step: int, nbytes: int) -> None:
        """The newest file is whole; it ends before control step `last_step`."""
        entry = self.files[-1]
        entry.steps = last_step - entry.first_step
        entry.stop_s = last_step * self._period
        entry.nbytes, entry.complete = nbytes, True

    def begun(self, name: str, first_step: int) -> None:
        """Another file has begun."""
        self.files.append(PartEntry(name, first_step, first_step * self._period))

    def write(self, complete: bool) -> None:
        """Write it; at no moment is there half a manifest."""
        content = {
            "log_id": self._id,
            "complete": complete,
            "files": [asdict(entry) for entry in self.files],
        }
        partial = f".{self._name}.part"
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
        with open(os.open(partial, flags, 0o644, dir_fd=self._folder), "w") as stream:
            json.dump(content, stream, indent=1)
        os.replace(partial, self._name, src_dir_fd=self._folder, dst_dir_fd=self._folder)


def first_file(path: str | Path) -> Path:
    """The file that a log begins with.

    Args:
        path: A file of a log, the manifest of one, or a run's folder.

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
        raise ConfigError(f"{path} is no manifest of a log: it names no files")
    return path.with_name(names[0])


def _read(path: Path) -> Mapping[str, Any]:
    try:
        if path.stat().st_size > _LARGEST_MANIFEST:
            raise ConfigError(f"{path} is no manifest of a log: it is too large")
        found = json.loads(path.read_text())
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is no manifest of a log: {error}") from error
    return found if isinstance(found, dict) else {}


def _names(manifest: Mapping[str, Any]) -> list[str]:
    files = manifest.get("files")
    found = [f.get("name") for f in files if isinstance(f, dict)] if isinstance(files, list) else []
    return [name for name in found if isinstance(name, str) and _NAME.match(name)]


def missing_part(first: Path, name: str) -> tuple[str, bool]:
    """What to say of a file that the one before it names, but that is not there.

    Args:
        first: The file the log begins with.
        name: The file that is missing.

    Returns:
        One line, and whether it is lost: the manifest or a later file shows that others are here.
        Else the file before it was taken out of its log, and is read alone.
    """
    folder = first.parent
    manifest = first.with_name(first.stem + MANIFEST_SUFFIX)
    pattern = re.compile(re.escape(first.stem) + r"_\d{4,}" + re.escape(first.suffix) + r"\Z")
    others = sorted(p.name for p in folder.iterdir() if pattern.match(p.name))
    later = [other for other in others if (len(other), other) > (len(name), name)]
    says = f"{name}, which continues it, is missing"
    if not manifest.exists() and not later:
        return says, False
    try:
        entries = _read(manifest).get("files", []) if manifest.exists() else []
        steps = next((_steps(e) for e in entries if e.get("name") == name), "")
    except (ConfigError, AttributeError, TypeError):
        steps = ""
    also = f"; {later[0]} and what follows it can be read by themselves" if later else ""
    return f"{name}{steps}, which continues it, is missing{also}", True


def _steps(entry: Mapping[str, Any]) -> str:
    first, count = entry.get("first_step"), entry.get("steps")
    if type(first) is not int or type(count) is not int or not count:
        return ""
    return f" (steps {first} to {first + count - 1})"
