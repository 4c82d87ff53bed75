"""The index of a collection: which episodes of its logs succeeded, and why the others failed.

A folder of `embodichain collect` has one log for each time it ran (``rollout.mcap``, after a
resumption ``rollout-2.mcap``...), each perhaps in several files, and two lists with one JSON object
a line: ``successes.jsonl`` and ``failures.jsonl``. A line is written when the episode is complete
in the log on disk, so the lists are true after a kill. An episode of a log that neither list has
was cut off, or was not needed any more.
"""

from __future__ import annotations

import dataclasses
import json
import os
import platform
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Self

from embodichain.utils.errors import ConfigError, OutsideError
from embodichain.utils.system import platforms

__all__ = [
    "FAILURES",
    "SUCCESSES",
    "CollectedEpisode",
    "CollectionWriter",
    "is_collection",
    "new_log",
    "read_collection",
]

SUCCESSES = "successes.jsonl"
"""File name of the list of successful episodes."""
FAILURES = "failures.jsonl"
"""File name of the list of failed episodes."""

_LISTS = {True: SUCCESSES, False: FAILURES}


@dataclasses.dataclass(frozen=True, slots=True)
class CollectedEpisode:
    """One episode of a collection; each line of the lists has these keys.

    Attributes:
        attempt: Its number in the collection, from 0; with the collection's seed, it determines
            what is drawn in the episode.
        log: Name of the log's first file in the folder, for `embodichain.recording.open`.
        env: Its environment in the log.
        episode: Its episode id within the environment.
        first_step: Its first control step in the log.
        steps: Number of control steps.
        total_reward: Undiscounted sum of rewards.
        success: Whether its last step was a success.
        failure: What failed, in one line; None for a success.
    """

    attempt: int
    log: str
    env: int
    episode: int
    first_step: int
    steps: int
    total_reward: float
    success: bool
    failure: str | None = None


_TYPES: dict[str, tuple[type, ...]] = {
    "attempt": (int,),
    "env": (int,),
    "episode": (int,),
    "first_step": (int,),
    "steps": (int,),
    "log": (str,),
    "success": (bool,),
    "failure": (str, type(None)),
    "total_reward": (int, float),
}
"""Key of a line to the types of its value."""


def is_collection(folder: str | Path) -> bool:
    """Whether a folder was made by `embodichain collect` or `augment`."""
    return (Path(folder) / SUCCESSES).is_file()


def read_collection(folder: str | Path, *, failures: bool = False) -> list[CollectedEpisode]:
    """Return the episodes of a collection, sorted by attempt.

    Args:
        folder: The folder.
        failures: Whether the failed episodes are returned too.

    Raises:
        ConfigError: If it is not a collection, or a line of a list is damaged; the error names file
            and line.
    """
    path = Path(folder)
    if not is_collection(path):
        raise ConfigError(
            f"{path} is not a collection: it has no {SUCCESSES} (embodichain collect)"
        )
    episodes = _read(path / SUCCESSES)
    if failures and (path / FAILURES).exists():
        episodes += _read(path / FAILURES)
    return sorted(episodes, key=lambda episode: episode.attempt)


def _read(path: Path) -> list[CollectedEpisode]:
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} cannot be read: {error}") from error
    # The text after the last newline is empty, or a line that was cut off while it was written.
    complete = lines[:-1]
    return [_parse(line, f"{path}:{number}") for number, line in enumerate(complete, 1) if line]


def _parse(line: str, where: str) -> CollectedEpisode:
    try:
        values: Any = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{where} is not an episode of a collection: {error}") from error
    if not isinstance(values, dict) or set(values) != set(_TYPES):
        keys = ", ".join(_TYPES)
        raise ConfigError(f"{where} is not an episode of a collection: it needs the keys {keys}")
    for key, types in _TYPES.items():
        if type(values[key]) not in types:
            raise ConfigError(f"{where}: {key} must not be {values[key]!r}")
    log = values["log"]
    if log in ("", "..") or Path(log).name != log or "\\" in log or "\0" in log:
        raise OutsideError(f"{where}: log must be the name of a file beside it, not {log!r}")
    return CollectedEpisode(**values)


def new_log(folder: Path, first: str) -> str:
    """Return the file name for the log of the next recording in a collection.

    Args:
        folder: The collection.
        first: The first log's name, such as ``rollout.mcap``.
    """
    path = Path(first)
    name = first
    number = 1
    while (folder / name).exists():
        number += 1
        name = f"{path.stem}-{number}{path.suffix}"
    return name


class CollectionWriter:
    """Appends to the lists of a collection; only one process at a time can.

    Args:
        folder: An existing folder.

    Raises:
        ConfigError: If another process is writing there, or the folder cannot be written to.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[bool, int] = {}  # success to descriptor
        try:
            for success, name in _LISTS.items():
                flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC
                self._files[success] = os.open(folder / name, flags, 0o666)
                platforms.lock(self._files[success])
                _remove_half_line(self._files[success])
        except BlockingIOError as error:
            pid = platforms.locked_by(self._files[success])
            self.close()
            holder = "" if pid is None else f" (process {pid} on {platform.node()})"
            raise ConfigError(f"{folder}: another process is collecting into it{holder}") from error
        except OSError as error:
            self.close()
            raise ConfigError(f"{folder} cannot be written to: {error}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def add(self, episodes: Iterable[CollectedEpisode]) -> None:
        """Append episodes, which must be complete in their log on disk.

        Raises:
            OSError: If they could not be written, for example because the disk is full.
        """
        # Failures first: with the last success, a collection is complete.
        lines: dict[bool, list[str]] = {False: [], True: []}
        for episode in episodes:
            text = json.dumps(dataclasses.asdict(episode), allow_nan=False)
            lines[episode.success].append(text + "\n")
        for success, new_lines in lines.items():
            try:
                _write(self._files[success], new_lines)
            except OSError as error:
                name = str(self._folder / _LISTS[success])
                raise OSError(error.errno, error.strerror, name) from error

    def close(self) -> None:
        """Close the lists; another process may then write to them."""
        while self._files:
            _, descriptor = self._files.popitem()
            os.close(descriptor)


def _write(descriptor: int, lines: Sequence[str]) -> None:
    rest = memoryview("".join(lines).encode())
    while rest:
        rest = rest[os.write(descriptor, rest) :]


def _remove_half_line(descriptor: int) -> None:
    """Remove the part of a line that a killed process has written."""
    size = os.fstat(descriptor).st_size
    data = os.pread(descriptor, size, 0)
    os.ftruncate(descriptor, data.rfind(b"\n") + 1)
