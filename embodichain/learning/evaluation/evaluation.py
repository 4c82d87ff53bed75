"""`evaluate`: results of exactly N episodes of a policy, not biased towards short episodes."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.config.keys.schema import LARGEST_TRAINING_SEED
from embodichain.lab.gym.policies import Policy, resolve_policy
from embodichain.learning.checkpoints.curriculum_stage import at_stage
from embodichain.learning.episode_statistics import EpisodeStatistics, play
from embodichain.learning.evaluation.statistics import CONFIDENCE, Estimate, Rate, estimate, rate
from embodichain.learning.spaces import require_torch_batch

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["EVAL_SEED_OFFSET", "Evaluation", "evaluate", "quotas"]

EVAL_SEED_OFFSET = LARGEST_TRAINING_SEED + 1
"""Added to the seed of an evaluation; it is above all seeds of trainings, so streams differ."""


@dataclasses.dataclass(frozen=True, slots=True)
class Evaluation:
    """The results of an evaluation; `eval.json` has the same keys.

    Attributes:
        episodes: Number of counted episodes; fewer than requested if it was stopped.
        complete: Whether all requested episodes were played.
        num_envs: Number of environments in the batch.
        seed: As given; the environments use this plus `EVAL_SEED_OFFSET`.
        env_steps: Control steps taken, summed over environments.
        seconds: Wall time of the loop.
        confidence: Confidence level of every interval.
        returns: Undiscounted sums of rewards; None without episodes.
        length: Control steps of an episode.
        success: None if the task does not define success.
        terminated: Number of episodes that were terminated, not truncated.
        diverged: Number of episodes in which the physics diverged.
        rewards: Mean over episodes of each reward term's sum, weight included.
        metrics: Mean over episodes of each metric.
        curriculum: Of a task with one: the stage at which it was held, ``values`` and
            ``control_step``, and whether that is of the policy's ``training``.
        per_episode: ``env``, ``return``, ``length``, where known ``success``, and ``metrics`` (name
            -> a number an episode) of each episode, ordered by environment, then by time.
    """

    episodes: int
    complete: bool
    num_envs: int
    seed: int
    env_steps: int
    seconds: float
    confidence: float
    returns: Estimate | None
    length: Estimate | None
    success: Rate | None
    terminated: int
    diverged: int
    rewards: dict[str, float]
    metrics: dict[str, float]
    curriculum: dict[str, Any] | None
    per_episode: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, for JSON."""
        return dataclasses.asdict(self)


def evaluate(
    env: BaseEnv,
    policy: str | Path | Mapping[str, Any] | Callable[..., Any],
    episodes: int = 100,
    *,
    seed: int = 0,
    deterministic: bool = True,
    trust: bool = False,
    watch: Callable[[EpisodeStatistics], bool | None] | None = None,
) -> Evaluation:
    """Run a policy for exactly `episodes` episodes.

    A curriculum stays at the stage of the policy's training; without one, where it is.

    The first `quotas` episodes of each environment count, later ones do not. Counting the first N
    episodes to end in any environment would favour short episodes.

    Args:
        env: A batched environment with ``autoreset_mode`` SAME_STEP; it is reset first.
        policy: A policy, its file or folder, or any other value of the config key `policy`.
        episodes: Number of episodes, over all environments.
        seed: Seed of the environments (plus `EVAL_SEED_OFFSET`) and of drawn actions.
        deterministic: For files: the mean action; False draws from the policy's distribution.
        trust: For files: whether to run code of one that cannot be read without, see `load_policy`.
        watch: Called after every control step; returns True to stop.

    Returns:
        The results.

    Raises:
        ConfigError: If there is no such policy or it does not fit the environment.
        TypeError: If the environment is one of Gymnasium's with numpy arrays.
        ValueError: If `episodes` or `seed` is out of range, or the autoreset mode is another one.
    """
    if episodes < 1:
        raise ValueError(f"episodes must be at least 1, got {episodes}")
    if not 0 <= seed <= LARGEST_TRAINING_SEED:
        raise ValueError(f"seed must be from 0 to {LARGEST_TRAINING_SEED}, got {seed}")
    require_torch_batch(env, "evaluate")
    resolved_policy = _resolve_policy(env, policy, deterministic=deterministic, trust=trust)
    counted = EpisodeStatistics(env.num_envs, quotas(episodes, env.num_envs))
    # Forked, so that the caller's random numbers do not change.
    forked_generators = torch.random.fork_rng(devices=())
    with forked_generators, torch.no_grad(), at_stage(env, resolved_policy) as stage:
        obs, _ = env.reset(seed=EVAL_SEED_OFFSET + seed)
        resolved_policy.reset(None)
        start = time.perf_counter()
        for _ in play(env, resolved_policy, obs, counted):
            if watch is not None and watch(counted):
                break
    return _summarize(counted, seed, time.perf_counter() - start, stage)


def quotas(episodes: int, num_envs: int) -> NDArray[np.int64]:
    """Return (N,) the number of episodes of each environment; the first may have one more."""
    has_one_more = np.arange(num_envs) < episodes % num_envs
    return np.int64(episodes // num_envs) + has_one_more.astype(np.int64)


def _resolve_policy(env: BaseEnv, policy: Any, *, deterministic: bool, trust: bool) -> Policy:
    def load(path: Path) -> Policy:
        from embodichain.learning.policies.policy import load_policy

        return load_policy(path, env, deterministic=deterministic, trust=trust)

    if isinstance(policy, Path):
        return load(policy)
    return resolve_policy(policy, load_file=load)


def _summarize(
    counted: EpisodeStatistics, seed: int, seconds: float, stage: dict[str, Any] | None
) -> Evaluation:
    # By environment, then by time: not in the order of their ends, which may depend on N.
    order = np.lexsort((counted.column("episode"), counted.column("env")))

    def column(name: str) -> NDArray[Any]:
        return counted.column(name)[order]

    per_episode: dict[str, Any] = {}
    for name in ("env", "return", "length"):
        per_episode[name] = column(name).tolist()
    success: Rate | None = None
    if "success" in counted.names():
        successes = column("success").astype(np.bool_)
        success = rate(successes)
        per_episode["success"] = successes.tolist()
    metrics = [name for name in counted.names() if name.startswith("metrics/")]
    if metrics:
        per_episode["metrics"] = {
            name.removeprefix("metrics/"): column(name).tolist() for name in metrics
        }
    return Evaluation(
        episodes=counted.episodes,
        complete=counted.complete,
        num_envs=counted.num_envs,
        seed=seed,
        env_steps=counted.steps * counted.num_envs,
        seconds=seconds,
        confidence=CONFIDENCE,
        returns=estimate(column("return")),
        length=estimate(column("length")),
        success=success,
        terminated=int(counted.column("terminated").sum()),
        diverged=int(counted.column("diverged").sum()),
        rewards=_means(counted, "rewards/"),
        metrics=_means(counted, "metrics/"),
        curriculum=stage,
        per_episode=per_episode,
    )


def _means(counted: EpisodeStatistics, prefix: str) -> dict[str, float]:
    names = [name for name in counted.names() if name.startswith(prefix)]
    return {name.removeprefix(prefix): float(counted.column(name).mean()) for name in names}
