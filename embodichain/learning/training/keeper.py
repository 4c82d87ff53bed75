"""`CheckpointKeeper` writes the checkpoints of a training; `find_resumable` finds the newest."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from embodichain.learning.checkpoints.checkpoint import CHECKPOINTS, FINAL, read_note
from embodichain.learning.checkpoints.curriculum_stage import stage_path
from embodichain.learning.checkpoints.plain_state import read_tree
from embodichain.learning.evaluation.episodes import TrainStatistics
from embodichain.learning.sb3.normalization import statistics_path
from embodichain.learning.sb3.training_state import buffer_path
from embodichain.learning.training.finite import Learning, check_finite
from embodichain.utils.errors import ConfigError, EmbodichainError, Problem
from embodichain.utils.system.atomic import atomic_file

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
_SCORE = "score"
"""Key of the best checkpoint's note with its score, see `TrainStatistics.score`."""
_log = logging.getLogger(__name__)


class Saved(Learning, Protocol):
    """A training that can be saved.

    Attributes:
        run_dir: The run's folder.
        statistics: The progress of the training.
    """

    run_dir: Path
    statistics: TrainStatistics

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
        self._every = every
        self._keep = keep
        self._written = sorted(self._folder.glob("step_*.zip"))  # a job may continue in its folder

    @property
    def best(self) -> str | None:
        """Path of the best checkpoint, relative to the run's folder; None if there is none."""
        path = self._folder / BEST
        return f"{CHECKPOINTS}/{BEST}" if path.is_file() else None

    def resume(self, checkpoint: Path) -> None:
        """Continue from a checkpoint whose state the training has restored.

        The best checkpoint of its folder remains the best: it is copied if this is another folder.
        """
        statistics = self._session.statistics
        if statistics.next_checkpoint is not None:  # it may be due earlier than it was
            due = self._session.env_steps + self._every
            statistics.next_checkpoint = min(statistics.next_checkpoint, due)
        best = checkpoint.with_name(BEST)
        if not best.is_file():
            if statistics.best is not None:
                _log.warning("%s is missing: the best checkpoint is looked for anew", best)
            statistics.best = None
            return
        note = read_note(best)
        if _SCORE in note:  # later than the state if the process was killed between the two
            success, mean_return = note[_SCORE]
            score = (float(success), float(mean_return))
            if statistics.best is None or score > statistics.best[1]:
                statistics.best = (int(note["env_steps"]), score)
        if self._folder.resolve() != best.parent.resolve():
            self._copy_best(best)

    def _copy_best(self, best: Path) -> None:
        """Copy the best checkpoint of another folder, and the files beside it."""
        self._folder.mkdir(parents=True, exist_ok=True)
        for path in (statistics_path(best), stage_path(best), best):  # the zip last
            if path.is_file():
                with atomic_file(self._folder / path.name) as copy:
                    shutil.copyfile(path, copy)

    def boundary(self) -> None:
        """Write a checkpoint if one is due, and delete the oldest; call it before each rollout.

        Raises:
            NotFiniteError: The networks are not finite; nothing is written then.
        """
        check_finite(self._session)
        steps = self._session.env_steps
        statistics = self._session.statistics
        if statistics.next_checkpoint is None:  # the first rollout
            statistics.next_checkpoint = steps + self._every
        if steps < statistics.next_checkpoint:
            return
        statistics.next_checkpoint = steps + self._every
        self._write_if_best()
        if self._keep == 0:
            return
        path = self._folder / _STEP.format(steps)
        if path in self._written:  # a resume skips a checkpoint without a state
            self._written.remove(path)
        self._write(path.name, resumable=True)
        self._written.append(path)
        while len(self._written) > self._keep:
            _remove(self._written.pop(0))

    def final(self, *, finished: bool, resumable: bool) -> str:
        """Write the final checkpoint.

        It may be the best one only if the training is finished. An uninterrupted training would not
        be judged at the moment of an interruption: so both have the same best after a resume.

        Args:
            finished: Whether all steps were taken.
            resumable: Whether the model is between two rollouts, so that training can be resumed.

        Returns:
            Its path, relative to the run's folder.

        Raises:
            NotFiniteError: The networks are not finite; nothing is written then.
        """
        check_finite(self._session)
        if finished:
            self._write_if_best()
        # An interrupted training has begun its next rollout.
        self._write(FINAL, resumable=resumable, rolling=not finished)
        return f"{CHECKPOINTS}/{FINAL}"

    def _write_if_best(self) -> None:
        """Write the best checkpoint if the current model has the best score."""
        statistics = self._session.statistics
        score = statistics.score
        if score is None:
            return
        if statistics.best is None or score > statistics.best[1]:
            statistics.best = (self._session.env_steps, score)
            self._write(BEST, resumable=False, more={_SCORE: list(score)})

    def _write(
        self,
        name: str,
        *,
        resumable: bool,
        rolling: bool = True,
        more: Mapping[str, Any] | None = None,
    ) -> None:
        session = self._session
        self._folder.mkdir(parents=True, exist_ok=True)
        note = {**self._note, "env_steps": session.env_steps, **(more or {})}
        session.save(self._folder / name, note, resumable=resumable, rolling=rolling)


def find_resumable(run: Path) -> tuple[Path, dict[str, Any]]:
    """Return the newest checkpoint of a run from which training can be resumed, and its state.

    A zip is skipped if its state is missing or of another step (the process was killed in between).

    Raises:
        ConfigError: If there is none.
    """
    folder = run / CHECKPOINTS
    paths = [*folder.glob("step_*.zip"), *folder.glob(FINAL)]
    steps = {path: int(read_note(path).get("env_steps", -1)) for path in paths}
    newest_first = sorted(paths, key=lambda p: (steps[p], p.name == FINAL), reverse=True)
    for path in newest_first:
        if not state_path(path).is_file():
            continue
        state = read_tree(state_path(path))
        if state.get("env_steps") == steps[path]:
            return path, state
    message = f"{run} has no checkpoint that a training can continue from"
    raise ConfigError([Problem("resume", message)])


def state_path(checkpoint: Path) -> Path:
    """Return the file with the training state of ``NAME.zip``: ``NAME.state.npz`` beside it."""
    return checkpoint.with_name(checkpoint.stem + _STATE)


def _remove(checkpoint: Path) -> None:
    """Delete a checkpoint and the files beside it."""
    checkpoint.unlink(missing_ok=True)
    state_path(checkpoint).unlink(missing_ok=True)
    statistics_path(checkpoint).unlink(missing_ok=True)
    buffer_path(checkpoint).unlink(missing_ok=True)
    stage_path(checkpoint).unlink(missing_ok=True)


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
        message = f"{run_dir} could not be written: {error.strerror or error}"
        raise WriteError(f"{message}; {_how_to_resume(run_dir)}") from error


def _how_to_resume(run_dir: Path) -> str:
    try:
        checkpoint, _ = find_resumable(run_dir)
    except (ConfigError, OSError):
        return "it has no checkpoint to continue from yet"
    command = f"embodichain train resume={run_dir}"
    return f"with room again, `{command}` continues from its {checkpoint.name}"
