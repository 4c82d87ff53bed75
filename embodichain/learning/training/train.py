"""`train`: runs a training from its config to the final checkpoint and the summary."""

from __future__ import annotations

import dataclasses
import json
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import KVWriter

from embodichain.config import Resolved, make_batch
from embodichain.config.checks.validation import check_training_keys
from embodichain.config.keys.algorithms import DEFAULT_ALGORITHM, AlgoCfg
from embodichain.config.keys.learners import LEARNERS
from embodichain.config.keys.schema import RootCfg
from embodichain.config.keys.tensor_algorithms import TensorAlgoCfg
from embodichain.config.run_folder import SUMMARY
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.managers.observation_manager import no_vector
from embodichain.lab.sim.compiler.compile_scene import CompiledScene
from embodichain.learning.checkpoints.checkpoint import DIGEST, FINAL, read_digest, read_note
from embodichain.learning.checkpoints.task_digest import TaskDigest, check_unchanged
from embodichain.learning.cloning.behavior_cloning import BehaviorCloning
from embodichain.learning.cloning.demonstrations import (
    Demonstration,
    Demonstrations,
    fill,
    learn_scales,
)
from embodichain.learning.evaluation.episodes import EPISODE_WINDOW, TrainStatistics
from embodichain.learning.evaluation.evaluation import Evaluation
from embodichain.learning.evaluation.plots import draw_curves
from embodichain.learning.sb3.algorithms import Algorithm
from embodichain.learning.sb3.training_state import buffer_of
from embodichain.learning.sb3.vec_env import SB3VecEnv
from embodichain.learning.tensors.tensor_env import GROUP, TensorEnv
from embodichain.learning.training.finite import NotFiniteError
from embodichain.learning.training.keeper import CheckpointKeeper, find_resumable, telling_where
from embodichain.learning.training.session import Progress, Session
from embodichain.learning.training.tensor_training import TensorAlgorithm, TensorSession
from embodichain.learning.training.train_logs import check_wandb, wandb_writers
from embodichain.utils.env_text import as_written, env_texts
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean
from embodichain.utils.system.atomic import write_text

__all__ = [
    "TORCH_THREADS",
    "TrainSummary",
    "add_evaluation",
    "check_algorithm",
    "check_episode",
    "check_training",
    "train",
]

DEMONSTRATIONS = "demonstrations"
"""Key of a checkpoint's note with the checksum of the demonstrations."""
_EVAL_KEYS = {field.name for field in dataclasses.fields(Evaluation)} - {"per_episode"}
AnyAlgorithm = Algorithm | TensorAlgorithm
AnyVecEnv = SB3VecEnv | TensorEnv
_log = logging.getLogger(__name__)
TORCH_THREADS = 1
"""Threads of torch while learning: one, as networks are small and physics needs the cores."""


@dataclasses.dataclass(frozen=True, slots=True)
class TrainSummary:
    """The results of a training; `summary.json` has the same keys.

    Attributes:
        env_steps: Environment steps, summed over environments, including those before a resume. Of
            `bc`: steps of demonstrations in batches.
        train_seconds: Wall time of learning, without start-up.
        time_fractions: Shares of the wall time since the start or the resume, see `session.PARTS`.
        success_rate: Success rate of the last 200 episodes; None without episodes.
        mean_return: Mean return of the last 200 episodes; None without episodes.
        checkpoint: Path of the final checkpoint, relative to the run folder.
        best: Path of the best checkpoint; None if no episode ended.
        demonstrations: Number of episodes that were learned from; None without `dataset`.
        resumed_from: The checkpoint that this training was resumed from; None for a new one.
        eval: Results of the evaluation at the end, see `add_evaluation`; None without one.
        objective: The objective for a sweeper: the evaluation's success rate, or its mean return
            for a task without success; without an evaluation, that of the training.
    """

    task: str
    algo: str
    seed: int
    num_envs: int
    env_steps: int
    train_seconds: float
    env_steps_per_second: float
    time_fractions: dict[str, float]
    episodes: int
    success_rate: float | None
    mean_return: float | None
    status: Literal["finished", "interrupted"]
    checkpoint: str
    best: str | None = None
    demonstrations: int | None = None
    resumed_from: str | None = None
    eval: dict[str, Any] | None = None
    objective: float | None = None


def train(
    resolved: Resolved,
    run_dir: Path,
    progress: Progress | None = None,
    attach: Callable[[BaseEnv], object] | None = None,
    episodes: Callable[[BaseEnv], Iterable[Demonstration]] | None = None,
    *,
    compiled_scene: CompiledScene | None = None,
) -> TrainSummary:
    """Train a policy in this process.

    Writes checkpoints, ``summary.json`` (both atomically) and logs into the run folder. With
    ``resume`` in the config, training continues from the newest checkpoint of that run's folder.

    Args:
        resolved: A config of the verb `train`.
        run_dir: The run's folder, which exists.
        progress: Called after every control step with `TrainStatistics`; may raise
            KeyboardInterrupt to stop after the current rollout and its update.
        attach: Called with the built environment, to attach observers such as viewers.
        episodes: Reads the episodes of the config's `dataset`, for the built environment.
        compiled_scene: The scene of this config, if it was compiled before.

    Returns:
        The results.

    Raises:
        ConfigError: If the task cannot be learned or an argument is wrong; nothing was written.
        KeyboardInterrupt: Raised by `progress` or Ctrl-C; the model is saved first.
        WriteError: The folder cannot be written; complete checkpoints remain.
        NotFiniteError: The networks or the losses of an update are not finite; checkpoints of
            before remain.
        NoValidStepError: Every environment diverged in each of ten control steps in a row.
    """
    algorithm = _check_keys(resolved)
    if resolved.root.wandb.mode != "disabled":
        for path, text in env_texts(resolved.tree["wandb"], "wandb"):
            names = " and ".join(text.names)
            _log.warning("%s holds the value of %s: Weights & Biases keeps it", path, names)
    env = make_batch(resolved, compiled_scene=compiled_scene)
    try:
        env.run_dir = run_dir
        if attach is not None:
            attach(env)
        vec_env = _make_vec_env(env, algorithm)
        demonstrations = None
        if resolved.root.dataset is not None:
            if episodes is None:
                raise ConfigError([Problem("dataset", "give its episodes: train(episodes=...)")])
            demonstrations = Demonstrations.of(episodes(env), _require_sb3(vec_env))
        with (
            _torch_threads(TORCH_THREADS),
            wandb_writers(resolved.root.wandb, run_dir, as_written(resolved.tree)) as writers,
            telling_where(run_dir),
        ):
            return _learn(
                resolved,
                algorithm,
                vec_env,
                run_dir=run_dir,
                progress=progress,
                writers=writers,
                demonstrations=demonstrations,
            )
    finally:
        env.close()


def add_evaluation(run_dir: Path, found: Mapping[str, Any]) -> dict[str, Any]:
    """Add an evaluation of the final checkpoint to a training's `summary.json`.

    Args:
        run_dir: The training's folder.
        found: `Evaluation.as_dict()`; `per_episode` is left out.

    Returns:
        The summary.
    """
    summary: dict[str, Any] = json.loads((run_dir / SUMMARY).read_text(encoding="utf-8"))
    summary["eval"] = {name: value for name, value in found.items() if name in _EVAL_KEYS}
    if found["complete"]:
        success = found["success"]
        summary["objective"] = found["returns"]["mean"] if success is None else success["rate"]
    _write_summary(run_dir, summary)
    return summary


def check_training(resolved: Resolved) -> None:
    """Run the checks of `train` that need no environment.

    Args:
        resolved: A config of the verb `train`.

    Raises:
        ConfigError: Lists every mistake.
    """
    _check_keys(resolved)


def check_unfinished(checkpoint: Path, done: int, total: int) -> None:
    """Check that a training that is resumed has steps left, or results that were not written.

    Args:
        checkpoint: Its newest checkpoint.
        done: Environment steps until then.
        total: Environment steps of the whole training.

    Raises:
        ConfigError: If nothing is left to do.
    """
    if done < total:
        return
    if checkpoint.name == FINAL and not _has_summary(checkpoint.parent.parent):
        return  # a full disk, or a kill, between the last checkpoint and the summary
    message = f"{checkpoint} has {done} steps already: give more, total_timesteps=N"
    raise ConfigError([Problem("total_timesteps", message)])


def _has_summary(run_dir: Path) -> bool:
    """Whether a training has written its summary."""
    try:
        summary = json.loads((run_dir / SUMMARY).read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return False
    return isinstance(summary, dict) and summary.get("status") in ("finished", "interrupted")


def check_algorithm(resolved: Resolved, env: BaseEnv) -> None:
    """Build the algorithm of a training on its environment, as a check, without training.

    Args:
        resolved: A config of the verb `train`.
        env: Its environment.

    Raises:
        ConfigError: If the task cannot be learned or an argument is wrong.
    """
    algorithm = _check_keys(resolved)
    _build(algorithm, _make_vec_env(env, algorithm), resolved.root.seed)


def check_episode(resolved: Resolved, env: BaseEnv, episode: Demonstration) -> None:
    """Check that a training can learn from an episode of its data set.

    Args:
        resolved: A config of the verb `train`.
        env: Its environment.
        episode: The episode.

    Raises:
        ConfigError: If the episode's observations or actions are not the task's.
    """
    vec_env = _make_vec_env(env, _check_keys(resolved))
    Demonstrations.of([episode], _require_sb3(vec_env))


def _make_vec_env(env: BaseEnv, algorithm: AnyAlgorithm) -> AnyVecEnv:
    """Return the environment as the algorithm's policy takes it."""
    manager = env.observation_manager
    images = manager.image_terms(GROUP) if GROUP in manager.groups else ()
    if images and isinstance(algorithm, TensorAlgorithm):
        message = f"its networks take vectors, and {', '.join(images)} in group {GROUP!r} "
        message += "is an image" if len(images) == 1 else "are images"
        raise ConfigError([Problem("algo", f"{message}: use algo=ppo")])
    if algorithm.flat and images and len(manager.group_terms(GROUP)) > 1:
        message = f"{no_vector(GROUP, images)}."
        hint = "Write algo.policy=MultiInputPolicy, or in the task "
        hint += "suggested: {train: {algo: {policy: MultiInputPolicy}}}."
        raise ConfigError([Problem("algo.policy", message, hint)])
    unknown = [
        Problem(
            "algo.critic_groups",
            f"no observation is in group {group!r}; there are: {', '.join(manager.groups)}",
            did_you_mean(group, manager.groups).strip(),
        )
        for group in algorithm.critic_groups
        if group not in manager.groups
    ]
    if unknown:
        raise ConfigError(unknown)
    if isinstance(algorithm, TensorAlgorithm):
        return TensorEnv(env, algorithm.critic_groups, algorithm.cfg.action_scale)
    return SB3VecEnv(env, GROUP, flatten=algorithm.flat, critic_groups=algorithm.critic_groups)


def _require_sb3(vec_env: AnyVecEnv) -> SB3VecEnv:
    """Return the environment of an algorithm that takes demonstrations."""
    if isinstance(vec_env, TensorEnv):
        raise TypeError("only algorithms of Stable-Baselines3 take demonstrations")
    return vec_env


def _build(algorithm: AnyAlgorithm, vec_env: AnyVecEnv, seed: int | None) -> Any:
    """Construct the algorithm, a `BaseAlgorithm` or a `Learner`, for its environment."""
    if isinstance(algorithm, TensorAlgorithm):
        if not isinstance(vec_env, TensorEnv):
            raise TypeError(f"{algorithm.name} takes a TensorEnv")
        return algorithm.build(vec_env, seed)
    return algorithm.build(_require_sb3(vec_env), seed)


def _check_keys(resolved: Resolved) -> AnyAlgorithm:
    """Check the config keys for learning, before building; returns the algorithm."""
    root = resolved.root
    problems = check_training_keys(root)
    problems += check_wandb(root.wandb)
    if root.resume is not None and not Path(root.resume).is_dir():
        problems.append(Problem("resume", f"there is no run folder {root.resume!r}"))
    if root.video and not root.eval.episodes:
        problems.append(Problem("video", "there is no evaluation to film: eval.episodes is 0"))
    algo_cfg = root.algo or AlgoCfg(name=DEFAULT_ALGORITHM)
    algorithm: AnyAlgorithm
    try:
        if isinstance(algo_cfg, TensorAlgoCfg):
            algorithm = TensorAlgorithm.of(algo_cfg)
        else:
            algorithm = Algorithm.of(algo_cfg)
    except ConfigError as error:
        raise ConfigError([*problems, *error.problems]) from error
    if root.checkpoint.replay_buffer and not algorithm.has_replay_buffer:
        message = f"{algorithm.name} learns from no replay buffer"
        problems.append(Problem("checkpoint.replay_buffer", message))
    problems += _check_dataset(root)
    if problems:
        raise ConfigError(problems)
    return algorithm


def _check_dataset(root: RootCfg) -> list[Problem]:
    """Check that there are demonstrations if the algorithm needs them, and only if it takes any."""
    algo = root.algo.name if root.algo is not None else DEFAULT_ALGORITHM
    use = LEARNERS[algo].demonstrations
    if root.dataset is None:
        if use != "only":
            return []
        message = f"{algo} learns from demonstrations: dataset=FOLDER of `embodichain collect`, "
        return [Problem("dataset", f"{message}or a log")]
    if use == "none":
        takers = [name for name, entry in LEARNERS.items() if entry.demonstrations != "none"]
        message = f"{algo} learns from its own steps alone; these take demonstrations: "
        return [Problem("dataset", message + ", ".join(takers))]
    paths = [root.dataset] if isinstance(root.dataset, str) else root.dataset
    missing = [path for path in paths if not Path(path).exists()]
    return [Problem("dataset", f"there is no file or folder {path!r}") for path in missing]


def _learn(
    resolved: Resolved,
    algorithm: AnyAlgorithm,
    vec_env: AnyVecEnv,
    *,
    run_dir: Path,
    progress: Progress | None,
    writers: tuple[KVWriter, ...],
    demonstrations: Demonstrations | None,
) -> TrainSummary:
    root = resolved.root
    total = root.total_timesteps or 0
    seed = root.seed or 0
    resumed_from: Path | None = None
    state: dict[str, Any] = {}
    if root.resume is not None:
        resumed_from, state = find_resumable(Path(root.resume))
        check_unfinished(resumed_from, state["env_steps"], total)
        trained_in = read_digest(read_note(resumed_from), resumed_from)
        check_unchanged(
            str(resumed_from), trained_in, vec_env.base, GROUP, allow=root.allow_changed
        )
    note: dict[str, Any] = {
        "algo": algorithm.name,
        "group": GROUP,
        "task": resolved.task_name,
        DIGEST: TaskDigest.of(vec_env.base, GROUP).to_json(),
    }
    model = _build(algorithm, vec_env, seed)
    checkpoint_every = root.checkpoint.every_steps or max(1, total // 10)
    if demonstrations is not None and isinstance(model, BaseAlgorithm):
        note[DEMONSTRATIONS] = demonstrations.checksum
        if resumed_from is not None:
            _check_same_demonstrations(note, resumed_from)
        _use_demonstrations(demonstrations, model, checkpoint_every)

    # An evaluation while cloning is one episode in each environment.
    window = vec_env.num_envs if algorithm.is_cloning else EPISODE_WINDOW
    statistics = TrainStatistics(total, window)
    session: Session | TensorSession
    if isinstance(vec_env, TensorEnv):
        session = TensorSession(
            learner=model,
            vec_env=vec_env,
            statistics=statistics,
            run_dir=run_dir,
            writers=writers,
            seed=seed,
        )
    else:
        session = Session(
            model=model,
            vec_env=vec_env,
            statistics=statistics,
            run_dir=run_dir,
            writers=writers,
            replay_buffer=root.checkpoint.replay_buffer,
        )
    keeper = CheckpointKeeper(session, note, checkpoint_every, root.checkpoint.keep)
    if resumed_from is not None:
        session.resume(resumed_from, state)
        keeper.resume(resumed_from)

    try:
        interrupt, resumable = session.learn(keeper.boundary, progress)
        checkpoint = keeper.final(finished=interrupt is None, resumable=resumable)
    except NotFiniteError as error:
        rate = (resolved.tree["algo"] or {}).get("learning_rate")
        value = "" if rate is None else f", {rate},"
        message = f"{error}; the learning rate{value} may be too large (algo.learning_rate)"
        raise NotFiniteError(message) from error
    success_rate = statistics.success_rate
    summary = TrainSummary(
        task=resolved.task_name,
        algo=algorithm.name,
        seed=seed,
        num_envs=vec_env.num_envs,
        env_steps=statistics.env_steps,
        train_seconds=statistics.seconds,
        env_steps_per_second=statistics.env_steps_per_second,
        time_fractions={name: round(share, 4) for name, share in statistics.fractions.items()},
        episodes=statistics.episodes,
        success_rate=success_rate,
        mean_return=statistics.mean_return,
        status="finished" if interrupt is None else "interrupted",
        checkpoint=checkpoint,
        best=keeper.best,
        demonstrations=None if demonstrations is None else len(demonstrations.lengths),
        resumed_from=None if resumed_from is None else str(resumed_from),
        objective=statistics.mean_return if success_rate is None else success_rate,
    )
    _write_summary(run_dir, resolved.record(dataclasses.asdict(summary)))
    draw_curves(run_dir)
    if interrupt is not None:
        raise interrupt
    return summary


def _use_demonstrations(
    demonstrations: Demonstrations, model: BaseAlgorithm, checkpoint_every: int
) -> None:
    """Let a model learn from demonstrations, or fill its replay buffer with them."""
    count = len(demonstrations.lengths)
    steps = demonstrations.steps
    if isinstance(model, BehaviorCloning):
        model.set_demonstrations(demonstrations)
        model.play_every = checkpoint_every
        _log.info("%d demonstrations of %s steps to learn from", count, f"{steps:,}")
        return
    buffer = buffer_of(model)
    if buffer is None:
        raise ValueError(f"{type(model).__name__} has no replay buffer to fill")
    added = fill(buffer, demonstrations)
    normalizer = model.get_vec_normalize_env()
    if normalizer is not None:
        learn_scales(normalizer, demonstrations, rewards=True)
    again = f", {added - steps} of them twice" if added > steps else ""
    transitions = f"{added:,} transitions{again}, of {count} demonstrations"
    _log.info("the replay buffer begins with %s", transitions)


def _check_same_demonstrations(note: Mapping[str, Any], checkpoint: Path) -> None:
    """Check that a training continues with the demonstrations that it began with."""
    if read_note(checkpoint).get(DEMONSTRATIONS) != note[DEMONSTRATIONS]:
        message = f"it has other demonstrations than those that {checkpoint} was made with"
        raise ConfigError([Problem("dataset", message)])


def _write_summary(run_dir: Path, summary: Mapping[str, Any]) -> None:
    write_text(run_dir / SUMMARY, json.dumps(summary, indent=2) + "\n")


@contextmanager
def _torch_threads(count: int) -> Iterator[None]:
    """Set the number of torch's threads inside the context; it applies to the whole process."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
