"""`CheckpointKeeper` writes the checkpoints of a training; `find_resumable` finds the newest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from embodichain.learning.checkpoint import CHECKPOINTS, FINAL, read_note
from embodichain.learning.curriculum_stage import stage_path
from embodichain.learning.episodes import TrainStatistics
from embodichain.learning.normalization import statistics_path
from embodichain.learning.plain_state import read_tree
from embodichain.learning.training_state import buffer_path
from embodichain.utils.errors import ConfigError, EmbodichainError, Problem

__all__ = [
    "BEST",
    "CheckpointKeeper",
    "Saved",
    "WriteError",
    "find_resumable",
    "state_path",
    "telling_where",
]

BEST = "best.zip"
_STEP = "step_{:012d}.zip"
_STATE = ".state.npz"


class Saved(Protocol):
    """A training that can be saved.

    Attributes:
        run_dir: The run's folder.
        statistics: The progress of the training.
    """

    run_dir: Path
    statistics: TrainStatistics

    @property
    def env_steps(self) -> int:
        """Environment steps taken, summed over environments."""

    def save(self, path: Path, note: dict[str, Any], *, resumable: bool, rolling: bool) -> None:
        """Write a checkpoint.

        Args:
            path: The zip, written last.
            note: Its metadata.
            resumable: Whether to write beside it what the training needs to continue.
            rolling: Whether a rollout has begun.
        """


class CheckpointKeeper:
    """Writes checkpoints of one training: periodic ones, the best of these, and the final one.

    The files of a checkpoint are written atomically, the zip last: if it exists, the others do.

    Args:
        session: The training.
        note: Metadata of the zips; gets ``env_steps``.
        every: Environment steps between two periodic checkpoints.
        keep: Number of periodic checkpoints to keep.
    """

    def __init__(self, session: Saved, note: Mapping[str, Any], every: int, keep: int) -> None:
        self._folder = session.run_dir / CHECKPOINTS
        self._session = session
        self._note = note
        self._every, self._keep = every, keep
        self._written = sorted(self._folder.glob("step_*.zip"))  # a job may continue in its folder
        self._next: int | None = None

    @property
    def best(self) -> str | None:
        """Path of the best checkpoint, relative to the run's folder; None if there is none."""
        path = self._folder / BEST
        return f"{CHECKPOINTS}/{BEST}" if path.is_file() else None

    def boundary(self) -> None:
        """Write a checkpoint if one is due, and delete the oldest; call it before each rollout."""
        steps = self._session.env_steps
        if self._next is None:  # the first rollout, or the first after a resume
            self._next = steps + self._every
        if steps < self._next:
            return
        self._next = steps + self._every
        self._judge()
        if self._keep == 0:
            return
        self._written.append(self._write(_STEP.format(steps), resumable=True))
        while len(self._written) > self._keep:
            _remove(self._written.pop(0))

    def final(self, *, resumable: bool, rolling: bool) -> str:
        """Write the final checkpoint.

        Args:
            resumable: Whether the model is between two rollouts, so that training can be resumed.
            rolling: Whether the next rollout has begun.

        Returns:
            Its path, relative to the run's folder.
        """
        self._judge()
        self._write(FINAL, resumable=resumable, rolling=rolling)
        return f"{CHECKPOINTS}/{FINAL}"

    def _judge(self) -> None:
        """Write the best checkpoint if the current model has the best score."""
        statistics, steps = self._session.statistics, self._session.env_steps
        score = statistics.score
        if score is not None and (statistics.best is None or score > statistics.best[1]):
            statistics.best = steps, score
            self._write(BEST, resumable=False)

    def _write(self, name: str, *, resumable: bool, rolling: bool = True) -> Path:
        session, path = self._session, self._folder / name
        self._folder.mkdir(parents=True, exist_ok=True)
        note = {**self._note, "env_steps": session.env_steps}
        session.save(path, note, resumable=resumable, rolling=rolling)
        return path


def find_resumable(run: Path) -> tuple[Path, dict[str, Any]]:
    """Return the newest checkpoint of a run from which training can be resumed, and its state.

    A zip is skipped if its state is missing or of another step (the process was killed in between).

    Raises:
        ConfigError: If there is none; lists the paths that were tried.
    """
    folder = run / CHECKPOINTS
    paths = [*folder.glob("step_*.zip"), *folder.glob(FINAL)]
    steps = {path: int(read_note(path).get("env_steps", -1)) for path in paths}
    for path in sorted(paths, key=lambda p: (steps[p], p.name == FINAL), reverse=True):
        if state_path(path).is_file():
            state = read_tree(state_path(path))
            if state.get("env_steps") == steps[path]:
                return path, state
    message = f"{run} has no checkpoint that a training can continue from"
    raise ConfigError([Problem("resume", message)])


def state_path(checkpoint: Path) -> Path:
    """Return the file with the training state of ``NAME.zip``: ``NAME.state.npz`` beside it."""
    return checkpoint.with_name(checkpoint.stem + _STATE)


def _remove(checkpoint: Path) -> None:
    beside = (state_path, statistics_path, buffer_path, stage_path)
    for path in (checkpoint, *(of(checkpoint) for of in beside)):
        path.unlink(missing_ok=True)


class WriteError(EmbodichainError):
    """A training's folder cannot be written; reports its contents and how to resume."""


@contextmanager
def telling_where(run_dir: Path) -> Iterator[None]:
    """Convert OS errors to an error that names the folder and its newest checkpoint.

    Args:
        run_dir: The training's folder.

    Raises:
        WriteError: A file could not be written.
    """
    try:
        yield
    except OSError as error:
        why = f"{run_dir} could not be written: {error.strerror or error}"
        raise WriteError(f"{why}; {_what_remains(run_dir)}") from error


def _what_remains(run_dir: Path) -> str:
    try:
        checkpoint, _ = find_resumable(run_dir)
    except (ConfigError, OSError):
        return "it has no checkpoint to continue from yet"
    command = f"embodichain train resume={run_dir}"
    return f"with room again, `{command}` continues from its {checkpoint.name}"
