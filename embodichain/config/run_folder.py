"""Run folders, each used by one run only, and found again by name.

`OUTPUT/DATE/TIME_TASK` is made by an exclusive mkdir; `OUTPUT/latest` links to the newest.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import logging
import os
import platform
import re
import shutil
from collections.abc import Collection, Iterable, Iterator, Sequence
from datetime import datetime
from pathlib import Path

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean, listing
from embodichain.utils.system.atomic import remove_abandoned, temporary_name
from embodichain.utils.system.platforms import is_locked, shared_lock

__all__ = [
    "CHECKPOINT",
    "CONFIG",
    "LOG",
    "SHARDS",
    "STUDY",
    "SUMMARY",
    "abandon",
    "adopt",
    "check_unused",
    "checkpoint_of",
    "claim",
    "find_run",
    "is_running",
    "latest_of",
    "marked_as_running",
    "missing_folders",
    "named_checkpoint",
    "newest_run",
    "perhaps_last",
    "take_back",
    "versions",
    "whole_run",
    "why_no_run",
]

CONFIG = "config.yaml"
"""File name of a run's config in its folder."""
LOG = "rollout.mcap"
"""File name of a run's log."""
CHECKPOINT = "checkpoints/final.zip"
"""Path of a training's final policy in its folder."""
SHARDS = "rollout.shards.json"
"""File name of the manifest that joins the logs of a run in shards."""
SUMMARY = "summary.json"
"""File name of a run's summary."""
SWEEP = "multirun.yaml"
"""A file in the folder of a sweep, which contains those of its jobs."""
STUDY = "study.json"
"""A file in the folder of a study, which contains those of its jobs."""
LATEST = "latest"
_log = logging.getLogger(__name__)
_USED = (
    "{} contains a run already, and a folder is used for one run only. To repeat a command until "
    "it is finished, make it a sweep of one job: -m hydra.sweep.dir=FOLDER"
)
_MOST_SUFFIXES = 10_000
_PACKAGES = (
    "embodichain",
    "mujoco",
    "numpy",
    "torch",
    "tensordict",
    "gymnasium",
    "stable-baselines3",
    "hydra-core",
    "omegaconf",
    "pydantic",
    "mcap",
    "protobuf",
)


def claim(output_root: str | Path, task: str, now: datetime | None = None) -> Path:
    """Make a new folder for a run, and link ``latest`` to it.

    Args:
        output_root: The folder of runs, created if missing.
        task: The task's name, part of the folder's name.
        now: Date and time in the folder's name; None is the current local time.

    Returns:
        ``output_root/YYYY-MM-DD/HH-MM-SS_task``, with ``_2``, ``_3``... if that exists.

    Raises:
        ConfigError: The folder cannot be made; gives the reason.
    """
    root = Path(output_root)
    moment = now or datetime.now()
    name = f"{moment:%H-%M-%S}_{re.sub(r'[^A-Za-z0-9._-]+', '-', task)}"
    day = root / f"{moment:%Y-%m-%d}"
    try:
        day.mkdir(parents=True, exist_ok=True)
        folder = _make_new(day, name)
        _point_latest(root, folder)
    except OSError as error:
        raise ConfigError(f"output_dir: cannot make a run folder in {day}: {error}") from error
    return folder


def adopt(folder: str | Path) -> Path:
    """Claim a folder with a given name for one run, as for the jobs of a sweep.

    Raises:
        ConfigError: The folder already contains a run, or cannot be made.
    """
    path = Path(folder)
    try:
        path.mkdir(parents=True, exist_ok=True)
        with (path / CONFIG).open("x"):
            pass  # the process that makes this file owns the folder
    except FileExistsError as error:
        if not path.is_dir():
            raise ConfigError(f"cannot make the run folder {path}: it is a file") from error
        raise ConfigError(_USED.format(path)) from error
    except OSError as error:
        raise ConfigError(f"cannot make the run folder {path}: {error}") from error
    return path


def check_unused(folder: str | Path) -> None:
    """Check that a folder, which need not exist, can be claimed with `adopt`; makes nothing.

    Raises:
        ConfigError: It contains a run, is a file, or is the working directory.
    """
    path = Path(folder)
    if path.resolve() == Path.cwd():
        raise ConfigError(
            f"{str(folder)!r} is the working directory, and a run has a folder of its own: leave "
            "it out, or name a new folder"
        )
    if (path / CONFIG).is_file():
        raise ConfigError(_USED.format(path))
    existing = next(p for p in (path, *path.absolute().parents) if p.exists())
    if not existing.is_dir():
        raise ConfigError(f"cannot make the run folder {path}: {existing} is a file")
    if not os.access(existing, os.W_OK):
        raise ConfigError(f"cannot make the run folder {path}: {existing} is not writable")


def latest_of(output_root: str | Path) -> str | None:
    """Return what ``latest`` links to, for `abandon`; None without a link."""
    link = Path(output_root) / LATEST
    return os.readlink(link) if link.is_symlink() else None


def abandon(
    folder: Path, output_root: str | Path, latest: str | None, made: Sequence[Path]
) -> None:
    """Remove the folder of a run that was refused before it began.

    Args:
        folder: A folder of `claim`.
        output_root: The folder of runs.
        latest: What `latest_of` was before `claim`; ``latest`` links to it again, unless another
            run has replaced the link since.
        made: The folders above it that `claim` has made; they are removed unless others use them.
    """
    root = Path(output_root)
    link = root / LATEST
    if latest_of(root) == str(folder.relative_to(root)):
        link.unlink()
        if latest is not None:
            link.symlink_to(latest, target_is_directory=True)
    shutil.rmtree(folder)
    _remove_empty((folder.parent, *made))


@contextlib.contextmanager
def marked_as_running(folder: Path) -> Iterator[None]:
    """Lock a run's folder, so that others know that it is going; the end of a process unlocks it.

    Where folders cannot be locked (Windows, some network file systems), others see an unfinished
    run.
    """
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(shared_lock(folder))
        except OSError as error:
            _log.warning("%s cannot be locked (%s): to others it is unfinished", folder, error)
        yield


def is_running(folder: str | Path) -> bool:
    """Whether a process of this machine runs what is in a run's folder."""
    return is_locked(Path(folder))


def take_back(folder: Path, before: Collection[str], made: Sequence[Path]) -> None:
    """Remove what a run that was refused before it began has written to a given folder.

    Args:
        folder: A folder of `adopt`.
        before: The names in it before `adopt`; these files stay.
        made: It and the folders above it that were made for the run; they are removed if empty.
    """
    for entry in folder.iterdir():
        if entry.name in before:
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()
    _remove_empty(made)


def missing_folders(folder: str | Path) -> list[Path]:
    """Return a folder and those above it that do not exist, the innermost first."""
    path = Path(folder).absolute()
    return [place for place in (path, *path.parents) if not place.exists()]


def _remove_empty(folders: Iterable[Path]) -> None:
    for empty in folders:
        with contextlib.suppress(OSError):  # others use it
            empty.rmdir()


def find_run(name: str | Path, output_root: str | Path = "outputs") -> Path:
    """Return the folder of an existing run.

    Args:
        name: Its path, or ``last`` for the run that ``latest`` links to.
        output_root: The folder that contains ``latest``.

    Raises:
        ConfigError: There is no such run.
    """
    if str(name) == "last":
        path = Path(output_root) / LATEST
        reason = f" ({path} does not exist)"
    else:
        path = Path(name)
        reason = why_no_run(name)
    if not path.is_dir():
        raise ConfigError(f"there is no run {str(name)!r}{reason}")
    return path.resolve()


def perhaps_last(name: str | Path) -> str:
    """Return ``". Did you mean 'last'?"`` for a name that nothing has, or ``""``."""
    if str(name) == "last":
        return ""
    hint = did_you_mean(str(name), ["last"])
    return f".{hint}" if hint else ""


def why_no_run(name: str | Path) -> str:
    """Return what to append to ``there is no run NAME``: 'last', or where it was looked for."""
    looked_for = Path(name).absolute()
    return perhaps_last(name) or f": no folder {looked_for}; 'last' is the newest run"


def newest_run(output_root: str | Path, *holding: str) -> Path | None:
    """Return the folder of the newest run that contains one of some files, or None.

    Args:
        output_root: The folder of runs; the jobs of sweeps are searched too.
        *holding: The file's path in a run's folder; may be a pattern (``*.zip``).
    """
    runs = []
    for config in Path(output_root).rglob(CONFIG):
        run = config.parent
        if any(file.is_file() for pattern in holding for file in run.glob(pattern)):
            runs.append(run)
    if not runs:
        return None
    return max(runs, key=_began).resolve()


def whole_run(folder: Path) -> Path:
    """Return the study or the sweep that a run is a job of, or the run's own folder."""
    for name in (STUDY, SWEEP):  # the jobs of a study are a sweep, too
        for parent in folder.parents:
            if (parent / name).is_file():
                return parent
    return folder


def named_checkpoint(path: str | Path) -> Path:
    """Return the path if it exists, else the checkpoint that it names without ``.zip``.

    ``RUN/best`` and ``RUN/checkpoints/best`` are both ``RUN/checkpoints/best.zip``.

    Args:
        path: As typed; returned unchanged if none of these exist.
    """
    typed = Path(path)
    file = f"{typed.name}.zip"
    choices = (
        typed,
        typed.parent / file,
        typed.parent / Path(CHECKPOINT).parent / file,
    )
    return next((choice for choice in choices if choice.exists()), typed)


def checkpoint_of(path: str | Path) -> Path:
    """Return the checkpoint of a path: a file, ``RUN/best``, or a run folder's final checkpoint.

    Raises:
        ConfigError: There is none; lists the checkpoints of the folder.
    """
    place = named_checkpoint(path)
    if place.is_file():
        return place
    if not place.is_dir():
        message = f"no such file or folder: {place}{perhaps_last(path)}"
        raise ConfigError([Problem("policy", message)])
    final = place / CHECKPOINT
    remove_abandoned(final.parent)
    if final.is_file():
        return final
    others = sorted(final.parent.glob("*.zip")) or sorted(place.glob("*.zip"))
    listed = f"there are: {listing(map(str, others))}" if others else "it has none"
    message = f"{place} has no {CHECKPOINT}: it is not the folder of a finished training; {listed}"
    raise ConfigError([Problem("policy", message)])


def versions() -> dict[str, str | None]:
    """Return the versions of software that can change a result; None if it is not installed."""
    by_name: dict[str, str | None] = {"python": platform.python_version()}
    for package in _PACKAGES:
        by_name[package] = None
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            by_name[package] = importlib.metadata.version(package)
    by_name["platform"] = platform.platform()
    by_name["machine"] = platform.machine()
    return by_name


def _make_new(day: Path, name: str) -> Path:
    for number in range(1, _MOST_SUFFIXES):
        folder = day / (name if number == 1 else f"{name}_{number}")
        with contextlib.suppress(FileExistsError):
            folder.mkdir()
            return folder
    raise FileExistsError(f"{_MOST_SUFFIXES} folders named {name} exist")


def _point_latest(root: Path, folder: Path) -> None:
    """Replace the link in one step; a real file or folder of that name is left alone."""
    link = root / LATEST
    if link.exists() and not link.is_symlink():
        raise FileExistsError(f"{link} is not a link; move it away")
    remove_abandoned(root)
    temporary = root / temporary_name(LATEST)
    try:
        temporary.symlink_to(folder.relative_to(root), target_is_directory=True)
        os.replace(temporary, link)
    finally:
        temporary.unlink(missing_ok=True)


def _began(run: Path) -> tuple[int, str]:
    """Sort key by the time when a run began: its config is written once, at the start."""
    return (run / CONFIG).stat().st_mtime_ns, str(run)
