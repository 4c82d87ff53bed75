"""`read_episodes`: the episodes of a run for its page, from its log, its lists or its result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.cli.pages.run_record import RunRecord

if TYPE_CHECKING:
    from embodichain.recording.read.episodes import LogEpisode
    from embodichain.recording.read.summary import LogSummary

__all__ = ["PlayedEpisode", "counted_episodes", "episodes_of", "read_episodes"]


@dataclass(frozen=True, slots=True)
class PlayedEpisode:
    """An episode that ended.

    Attributes:
        env: Its environment.
        episode: Its number within the environment; None if that is not recorded.
        length: Control steps.
        total_reward: Undiscounted sum of its rewards.
        success: Whether it was a success; None for a task without success.
        end: What ended it, in words; empty if that is not recorded.
        has_failed: Whether it is one of those that a reader wants to see: not a success, or of a
            task without success one that failed or diverged.
        counted: Whether it is part of the results; None if the log does not say.
        drawn: What was drawn when it began.
        log: The log that has it; None without one.
        first_step: Its first control step in the log.
    """

    env: int
    episode: int | None
    length: int
    total_reward: float
    success: bool | None
    end: str = ""
    has_failed: bool = False
    counted: bool | None = None
    drawn: Mapping[str, Sequence[float]] = field(default_factory=dict)
    log: Path | None = None
    first_step: int = 0

    @property
    def last_step(self) -> int:
        """Its last control step in the log."""
        return self.first_step + self.length - 1

    @property
    def label(self) -> str:
        """``environment 3, episode 0``."""
        if self.episode is None:
            return f"environment {self.env}"
        return f"environment {self.env}, episode {self.episode}"


def read_episodes(record: RunRecord, log: LogSummary | None) -> list[PlayedEpisode]:
    """Return the episodes of a run that ended.

    Args:
        record: The run.
        log: The summary of its log, if it has one.

    Raises:
        ConfigError: A list of a collection is damaged.
    """
    if record.kind == "collection":
        return _of_collection(record.folder)
    if log is not None:
        return [_of_log(episode, record.log) for episode in log.episodes]
    return _of_evaluation(record.evaluation)


def episodes_of(record: RunRecord) -> list[PlayedEpisode]:
    """Return the episodes of a run, also where its log cannot be read.

    Raises:
        ConfigError: A list of a collection is damaged.
    """
    from embodichain.recording import inspect
    from embodichain.utils.errors import EmbodichainError

    log = None
    if record.log is not None and record.kind != "collection":
        with suppress(EmbodichainError):  # its own page says what is wrong with it
            log = inspect(record.log)
    return read_episodes(record, log)


def counted_episodes(episodes: Sequence[PlayedEpisode]) -> list[PlayedEpisode]:
    """Return the episodes that the results are made of: all, unless the log says which."""
    return [episode for episode in episodes if episode.counted is not False]


def _of_log(episode: LogEpisode, log: Path | None) -> PlayedEpisode:
    return PlayedEpisode(
        env=episode.env,
        episode=episode.episode,
        length=episode.steps,
        total_reward=episode.total_reward,
        success=episode.success,
        end=", ".join(episode.reasons) or ("time limit" if episode.truncated else ""),
        has_failed=_has_failed(episode),
        counted=episode.counted,
        drawn=episode.drawn,
        log=log,
        first_step=episode.first_step,
    )


def _has_failed(episode: LogEpisode) -> bool:
    if episode.success is None:
        return bool({"fail", "diverged"} & set(episode.reasons))
    return not episode.success


def _of_collection(folder: Path) -> list[PlayedEpisode]:
    from embodichain.recording.demos.collection import read_collection

    return [
        PlayedEpisode(
            env=episode.env,
            episode=episode.episode,
            length=episode.steps,
            total_reward=episode.total_reward,
            success=episode.success,
            end=episode.failure or "success",
            has_failed=not episode.success,
            log=folder / episode.log,
            first_step=episode.first_step,
        )
        for episode in read_collection(folder, failures=True)
    ]


def _of_evaluation(evaluation: Mapping[str, object]) -> list[PlayedEpisode]:
    columns = evaluation.get("per_episode")
    if not isinstance(columns, dict):
        return []
    envs = columns.get("env", [])
    successes = columns.get("success") or [None] * len(envs)
    rows = zip(envs, columns.get("return", []), columns.get("length", []), successes, strict=True)
    return [
        PlayedEpisode(
            env=env,
            episode=None,
            length=length,
            total_reward=total_reward,
            success=success,
            has_failed=success is False,
        )
        for env, total_reward, length, success in rows
    ]
