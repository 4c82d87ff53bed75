"""`export`: the formats, the part of a log to write, and writing without replacing files."""

from __future__ import annotations

import importlib
import logging
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np

from embodichain.recording.read.api import Log
from embodichain.recording.read.episodes import LogEpisode
from embodichain.recording.read.playback import Playback, span_of
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean
from embodichain.utils.system.atomic import move_new, named_errors, remove_abandoned, temporary_name

if TYPE_CHECKING:
    from embodichain.recording.film.filming import Filmed

__all__ = [
    "EPISODE_FORMATS",
    "FORMATS",
    "Format",
    "Part",
    "about",
    "demonstrations",
    "export",
    "new_file",
    "poses",
    "required",
]

_FILM_SIZE = (640, 480)
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Part:
    """The part of a log to write.

    Attributes:
        env: One environment; None is all (for ROS 2 and Rerun the viewed ones, for mp4 the first
            viewed one).
        episode: One of its episodes; needs `env`.
        start: First control step.
        stop: End of the control steps, exclusive; None is the end of the log.
        cameras: Cameras whose pictures are drawn, see `cameras_of`; None is all camera sensors of
            the task (for mp4, one: the scene's ``default`` or a front view).
        size: Width and height of the pictures in pixels; None is that of each camera.
    """

    env: int | None = None
    episode: int | None = None
    start: int = 0
    stop: int | None = None
    cameras: tuple[str, ...] | None = None
    size: tuple[int, int] | None = None

    @property
    def last(self) -> int | None:
        """Last control step, included; None is the end of the log."""
        return None if self.stop is None else self.stop - 1

    def envs_of(self, log: Log) -> list[int]:
        """The selected environment, or the viewed ones if none is selected."""
        return [self.env] if self.env is not None else log.header.view_envs or [0]

    def steps_of(self, episode: LogEpisode) -> range:
        """The control steps of an episode that are in the part."""
        if self.env not in (None, episode.env) or self.episode not in (None, episode.episode):
            return range(0)
        stop = episode.last_step + 1 if self.stop is None else min(self.stop, episode.last_step + 1)
        return range(max(self.start, episode.first_step), stop)


class Format(NamedTuple):
    """A format of files.

    Attributes:
        suffix: Suffix of the file's name; empty if the format is a folder.
        module: Module of this package with the function ``write_FORMAT(log, part, path)``, or
            ``write_episodes(data, path)`` of `EPISODE_FORMATS`; empty for a film.
        extra: Extra that installs the required packages.
    """

    suffix: str
    module: str = ""
    extra: str = ""


FORMATS: dict[str, Format] = {
    "csv": Format(".csv", "tables"),
    "npz": Format(".npz", "tables"),
    "parquet": Format(".parquet", "tables", "parquet"),
    "hdf5": Format(".hdf5", "tables", "hdf5"),
    "lerobot": Format("", "lerobot", "lerobot"),
    "rrd": Format(".rrd", "rrd", "rerun"),
    "ros2": Format(".mcap", "ros2", "ros2"),
    "mp4": Format(".mp4"),
}
EPISODE_FORMATS: dict[str, Format] = {
    "lerobot": Format("", "lerobot_episodes", "lerobot"),
    "robomimic": Format(".hdf5", "robomimic", "hdf5"),
}
"""Formats of `export_episodes`, with the task's observations."""
PICTURES = ("hdf5", "lerobot", "rrd", "mp4")
"""Formats that have pictures of cameras."""
_PACKAGES = {"rerun": "rerun-sdk"}
"""Module to package, if the names differ."""


def export(
    log: Log,
    format: str,
    output: str | Path | None = None,
    part: Part | None = None,
    *,
    progress: Callable[[Filmed], None] | None = None,
    stop: Callable[[], bool] | None = None,
) -> Path:
    """Write a log, or a part of it, in another format.

    Args:
        log: The log.
        format: Key of `FORMATS`.
        output: A new file; None: next to the log, with the log's name.
        part: The part to write; None is the whole log.
        progress: For films only, see `film_log`.
        stop: For films only, see `film_log`: without a picture, no file is written. In other
            formats, an exception such as KeyboardInterrupt removes the incomplete file.

    Returns:
        The file, or the folder if the format is one.

    Raises:
        ConfigError: If the format is unknown or needs a package that is missing, the part does not
            exist, or the file already exists.
        LogError: If the log has no states, or is damaged.
        OSError: If the file cannot be written.
    """
    if format in FORMATS and format not in PICTURES and part and (part.cameras or part.size):
        raise ConfigError(f"{format} has no pictures; formats with cameras: {', '.join(PICTURES)}")
    if format not in FORMATS:
        if format in EPISODE_FORMATS:
            raise ConfigError(f"{format} has the task's observations: use export_episodes")
        raise ConfigError(
            f"no format {format!r}.{did_you_mean(format, FORMATS)} Formats: {', '.join(FORMATS)}"
        )
    chosen = FORMATS[format]
    name = log.path.stem + (f"_{format}" if chosen.suffix in ("", ".mcap") else "")
    path = Path(output) if output else log.path.with_name(name + chosen.suffix)
    part = part or Part()
    log.header.require_states(log.path)
    _require_steps(log, part)
    with new_file(path, chosen.suffix) as partial:
        if chosen.module:
            module = importlib.import_module(f"embodichain.recording.export.{chosen.module}")
            getattr(module, f"write_{format}")(log, part, partial)
        else:
            from embodichain.recording.film.filming import film_log

            if part.cameras is not None and len(part.cameras) != 1:
                raise ConfigError(f"a film has one camera, not {', '.join(part.cameras) or 'none'}")
            film_log(
                log,
                partial,
                part.envs_of(log)[0],
                part.episode,
                part.start,
                part.last,
                size=part.size or _FILM_SIZE,
                camera=part.cameras[0] if part.cameras else None,
                progress=progress,
                stop=stop,
            )
    return path


def _require_steps(log: Log, part: Part) -> None:
    """Refuse a range of steps that are not in the log."""
    if part.start or part.stop is not None:
        asked = log.parts("rewards", part.env, part.episode, part.start, part.stop, steps=50)
        if next(asked, None) is None:
            end = "the end" if part.stop is None else part.stop
            raise ConfigError(f"{log.path} has no control step from {part.start} to {end}")


@contextmanager
def new_file(path: Path, suffix: str) -> Iterator[Path]:
    """A temporary name to write to; the complete file is renamed unless `path` exists by then.

    Nothing is written where the writer has not made the file.
    """
    if os.path.lexists(path):
        raise ConfigError(f"{path} exists; it is never replaced")
    if not path.parent.is_dir():
        raise ConfigError(f"the folder {path.parent} does not exist")
    remove_abandoned(path.parent)
    partial = path.with_name(temporary_name(f"{path.stem}{suffix}"))
    try:
        with named_errors(partial, path):
            yield partial
            if partial.exists():
                move_new(partial, path)
    except (FileExistsError, NotADirectoryError) as error:
        raise ConfigError(f"{path} exists; it is never replaced") from error
    finally:
        if partial.is_dir():
            shutil.rmtree(partial)
        partial.unlink(missing_ok=True)


# -- what writers share ----------------------------------------------------------------------------


def required(module: str, format: str) -> ModuleType:
    """Import what a format needs; ConfigError if it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        package, extra = (
            _PACKAGES.get(package, package),
            {**FORMATS, **EPISODE_FORMATS}[format].extra,
        )
        raise ConfigError(
            f"--format {format} needs {package}: pip install 'embodichain[{extra}]'"
        ) from error


def about(log: Log) -> dict[str, str]:
    """Metadata for tables: task, seed, versions, whether the log is complete."""
    header = log.header
    return {
        "task": header.task,
        "seed": str(header.seed),
        "num_envs": str(header.num_envs),
        "control_dt": repr(header.control_dt),
        "physics_dt": repr(header.physics_dt),
        "mujoco_version": header.mujoco_version,
        "complete": str(log.complete).lower(),
        "quaternions": "wxyz",
    }


def demonstrations(log: Log, part: Part) -> list[tuple[LogEpisode, range]]:
    """Return the episodes of a part and their steps in it, by environment, then in time.

    With `record.every`, steps of some episodes are missing. These episodes are left out, since a
    demonstration must have no gaps, and their number is logged.

    Raises:
        ConfigError: If there are no episodes.
    """
    chosen = [(episode, steps) for episode in log.episodes if (steps := part.steps_of(episode))]
    if log.header.every > 1 and chosen:
        recorded, count = log.read(()).steps, len(chosen)
        chosen = [
            (episode, steps)
            for episode, steps in chosen
            if np.diff(np.searchsorted(recorded, [steps.start, steps.stop]))[0] == len(steps)
        ]
        why = f"record.every={log.header.every} did not record all of their steps"
        if not chosen:
            raise ConfigError(f"none of {count} episodes is whole: {why}")
        if len(chosen) < count:
            _log.warning("%d of %d episodes are left out: %s", count - len(chosen), count, why)
    if not chosen:
        raise ConfigError("no episode is in the chosen range")
    return chosen


def poses(log: Log, env: int, part: Part) -> Iterator[tuple[int, mujoco.MjData, bool]]:
    """Yield the control steps of a part of one environment.

    Each comes with the input state of physics and its kinematics, in data that the next step
    overwrites, and with whether `data.model`, the environment's model, has changed.

    Raises:
        ConfigError: If the part does not exist.
        LogError: If the log is damaged.
    """
    playback, changes = Playback(log, env), -1
    data = mujoco.MjData(log.model)
    for step in playback.steps(span_of(log, env, part.episode, part.start, part.last)):
        changed = playback.changes != changes
        if changed:
            changes, data = playback.changes, mujoco.MjData(playback.engine.model_of(0))
        state = playback.engine.rows[0]
        mujoco.mj_setState(data.model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_kinematics(data.model, data)
        yield step, data, changed
