"""Reads the `dataset` of a training: the episodes of logs that succeeded, of the same task."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.cli.jobs.job import Job
from embodichain.cli.terminal.process import Interrupted
from embodichain.cli.terminal.reporting import ProgressDisplay
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.config.keys.schema import RootCfg
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.recording.demos.demonstrations import Episode

__all__ = ["first_episode", "read_dataset"]


def read_dataset(job: Job, env: BaseEnv) -> Iterator[Episode]:
    """Yield the successful episodes of a job's data set, with a progress display.

    Args:
        job: A training with a `dataset`.
        env: The environment that it learns in.

    Raises:
        ConfigError: If a log is of another task (`allow_changed` accepts one that changed), cannot
            be read, or has no successful episode.
        Interrupted: A signal came.
    """
    with ProgressDisplay("demonstrations", None, "episodes", quiet=job.quiet) as display:

        def progress(read: int, total: int) -> None:
            display.total = total
            if display.due or read == total:
                display.show(read, {})
            if job.stop.is_stopped():
                raise Interrupted(f"interrupted ({job.stop.stopped}): nothing was learned yet")

        yield from _episodes(job.root, env, progress)


def first_episode(root: RootCfg, env: BaseEnv) -> Episode:
    """Check the data set of a training, and return its first episode.

    Args:
        root: The config of the training.
        env: Its environment.

    Raises:
        ConfigError: As of `read_dataset`.
    """
    return next(_episodes(root, env, None))


def _episodes(
    root: RootCfg, env: BaseEnv, progress: Callable[[int, int], None] | None
) -> Iterator[Episode]:
    from embodichain.recording.demos.demonstrations import read_episodes
    from embodichain.recording.format.log_error import LogError

    names = root.dataset or []
    if isinstance(names, str):
        names = [names]
    paths = [Path(name) for name in names]
    try:
        checked_folder: Path | None = None
        for episode in read_episodes(paths, progress=progress):
            if episode.path.parent != checked_folder:  # the logs of a folder are of one task
                checked_folder = episode.path.parent
                _check_task(episode.path, env, allow=root.allow_changed)
            yield episode
    except LogError as error:
        raise ConfigError([Problem("dataset", str(error))]) from error
    except ConfigError as error:
        problems: list[Problem] = []
        for problem in error.problems:
            if not problem.path:
                problem = Problem("dataset", problem.message)
            problems.append(problem)
        raise ConfigError(problems) from error


def _check_task(log: Path, env: BaseEnv, *, allow: bool) -> None:
    """Compare the task of a log with the training's, as that of a policy is compared."""
    from embodichain.config.environments.factory import make_env
    from embodichain.learning.checkpoints.task_digest import TaskDigest, check_unchanged
    from embodichain.recording.demos.reenactment import config_of
    from embodichain.recording.read.recorded_log import RecordedLog

    with RecordedLog(log) as opened_log:
        recorded_env = make_env(config_of(opened_log))
    try:
        recorded_task = TaskDigest.of(recorded_env)
    finally:
        recorded_env.close()
    check_unchanged(str(log), recorded_task, env, "policy", allow=allow, made="recording")
