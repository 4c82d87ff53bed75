"""`train`: from one config to a checkpoint and a summary. The story of a training, top to bottom.

The environment's vector interface is `vec_env.py`, algorithms `algorithms.py`, files
`checkpoint.py`. What people see while it runs is the command line's.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger

from embodichain.config import Resolved, make_env
from embodichain.config.run_folder import write_atomically
from embodichain.config.schema import LARGEST_TRAINING_SEED
from embodichain.learning.algorithms import build_algorithm, check_arguments
from embodichain.learning.checkpoint import CHECKPOINTS, FINAL, save_checkpoint
from embodichain.learning.episodes import Progress, TrainStatistics, Watch
from embodichain.learning.vec_env import SB3VecEnv
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["SUMMARY_FILE", "TORCH_THREADS", "TrainSummary", "check_training", "train"]

SUMMARY_FILE = "summary.json"
GROUP = "policy"
TORCH_THREADS = 1
"""Threads of torch while learning: networks are small, and the cores belong to physics."""


@dataclasses.dataclass(frozen=True, slots=True)
class TrainSummary:
    """What a training was; `summary.json` has the same keys.

    Attributes:
        task: The task's name.
        algo: The algorithm's name.
        seed: The seed of everything drawn.
        num_envs: Environments stepped together.
        env_steps: Environment steps taken, summed over environments.
        train_seconds: Wall time of learning, without start-up.
        env_steps_per_second: Their ratio.
        episodes: Episodes finished.
        success_rate: Share of the last 200 episodes that were a success; None without any.
        mean_return: Mean return of the last 200 episodes; None without any.
        status: ``finished`` or ``interrupted``.
        checkpoint: Path of the checkpoint, relative to the run folder.
    """

    task: str
    algo: str
    seed: int
    num_envs: int
    env_steps: int
    train_seconds: float
    env_steps_per_second: float
    episodes: int
    success_rate: float | None
    mean_return: float | None
    status: Literal["finished", "interrupted"]
    checkpoint: str


@dataclasses.dataclass(frozen=True, slots=True)
class _Plan:
    """What a training does, checked."""

    task: str
    algo: str
    arguments: dict[str, object]
    seed: int
    total_timesteps: int


def train(resolved: Resolved, run_dir: Path, progress: Progress | None = None) -> TrainSummary:
    """Learn a task in this process.

    Writes ``checkpoints/final.zip`` and ``summary.json`` into the run folder, each as a whole or
    not at all.

    Args:
        resolved: A config of the verb `train`.
        run_dir: The run's own folder, which exists.
        progress: Called after every control step with `TrainStatistics`; may raise
            KeyboardInterrupt to stop.

    Returns:
        What the training was.

    Raises:
        ConfigError: If the task cannot be learned or an argument is wrong; nothing was written.
        KeyboardInterrupt: Ctrl-C; what was learned until then is saved first.
    """
    plan = _plan(resolved)
    env = make_env(resolved)
    try:
        env.run_dir = run_dir
        vec_env = SB3VecEnv(env, GROUP)
        with _torch_threads(TORCH_THREADS):
            return _learn(plan, vec_env, run_dir, progress)
    finally:
        env.close()


def check_training(resolved: Resolved) -> None:
    """Check what `train` would refuse before it builds anything.

    Args:
        resolved: A config of the verb `train`.

    Raises:
        ConfigError: Every mistake.
    """
    _plan(resolved)


def _plan(resolved: Resolved) -> _Plan:
    """Check what the config says about learning before anything is built."""
    root = resolved.root
    problems: list[Problem] = []
    if root.total_timesteps is None:
        message = "needs the number of environment steps; this task suggests none"
        problems.append(Problem("total_timesteps", message))
    if root.seed is None or not 0 <= root.seed <= LARGEST_TRAINING_SEED:
        message = f"training needs a seed from 0 to {LARGEST_TRAINING_SEED}, got {root.seed}"
        problems.append(Problem("seed", message))
    if root.resume is not None:
        problems.append(Problem("resume", "not available yet; leave it out"))
    name = root.algo.name if root.algo is not None else "ppo"
    arguments: dict[str, object] = {}
    try:
        arguments = check_arguments(name, root.algo.arguments() if root.algo is not None else {})
    except ConfigError as error:
        problems += error.problems
    if problems or root.total_timesteps is None or root.seed is None:
        raise ConfigError(problems)
    return _Plan(resolved.task_name, name, arguments, root.seed, root.total_timesteps)


def _learn(
    plan: _Plan, vec_env: SB3VecEnv, run_dir: Path, progress: Progress | None
) -> TrainSummary:
    model = build_algorithm(plan.algo, plan.arguments, vec_env, plan.seed)
    model.set_logger(Logger(folder=None, output_formats=[]))  # its own would make a folder
    statistics = TrainStatistics(plan.total_timesteps)
    statistics.begin()
    try:
        model.learn(plan.total_timesteps, callback=Watch(statistics, progress))
    except KeyboardInterrupt:
        statistics.end()
        _save(plan, model, statistics, run_dir, "interrupted")
        raise
    statistics.end()
    return _save(plan, model, statistics, run_dir, "finished")


def _save(
    plan: _Plan,
    model: BaseAlgorithm,
    statistics: TrainStatistics,
    run_dir: Path,
    status: Literal["finished", "interrupted"],
) -> TrainSummary:
    """Write the checkpoint, then the summary that says it is there."""
    relative = Path(CHECKPOINTS) / FINAL
    note = {"algo": plan.algo, "group": GROUP, "task": plan.task, "env_steps": statistics.env_steps}
    save_checkpoint(model, run_dir / relative, note)
    summary = TrainSummary(
        task=plan.task,
        algo=plan.algo,
        seed=plan.seed,
        num_envs=model.n_envs,
        env_steps=statistics.env_steps,
        train_seconds=statistics.seconds,
        env_steps_per_second=statistics.env_steps_per_second,
        episodes=statistics.episodes,
        success_rate=statistics.success_rate,
        mean_return=statistics.mean_return,
        status=status,
        checkpoint=relative.as_posix(),
    )
    text = json.dumps(dataclasses.asdict(summary), indent=2)
    write_atomically(run_dir / SUMMARY_FILE, text + "\n")
    return summary


@contextmanager
def _torch_threads(count: int) -> Iterator[None]:
    """Set the threads of torch's operators for a while; they belong to the whole process."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
