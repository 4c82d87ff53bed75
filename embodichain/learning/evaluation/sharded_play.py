"""`play_sharded`: episodes of a batch in shards, many control steps in each call of a shard.

Policies that need no observation act inside of the shards, so that nothing is sent in a step.
Steps, episodes and statistics are those of `episode_statistics.play`.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any

from embodichain.lab.gym.policies import resolve_policy
from embodichain.learning.episode_statistics import EpisodeStatistics, play

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.shards.sharded_env import ShardedEnv

__all__ = ["Played", "play_shard", "play_sharded"]

_FIRST_STEPS = 16
"""Control steps of the first call."""
_MOST_STEPS = 4096
"""Control steps of a call at most."""
_SHORT_CALL_S = 0.25
"""Seconds below which the next call takes twice as many steps."""
_LONG_CALL_S = 1.0
"""Seconds above which the next call takes half as many steps."""


@dataclass(frozen=True, slots=True)
class Played:
    """What a shard did in a call.

    Attributes:
        steps: Control steps taken.
        state: Its statistics, see `EpisodeStatistics.state_dict`.
        records: Values of the counted episodes that ended, see `EpisodeStatistics.take`.
    """

    steps: int
    state: dict[str, Any]
    records: list[dict[str, Any]]


def play_shard(
    env: BaseEnv, policy: str | Mapping[str, Any], state: Mapping[str, Any], steps: int
) -> Played:
    """Play in a shard until its environments have their episodes, for some steps at most.

    Args:
        env: The environments of the shard.
        policy: A policy that reads no observation and has no state.
        state: The statistics so far.
        steps: Control steps at most.
    """
    counted = EpisodeStatistics(env.num_envs, state["quota"])
    counted.load_state_dict(state)
    steps_before = counted.steps
    for _ in islice(play(env, resolve_policy(policy), None, counted), steps):
        pass
    return Played(
        steps=counted.steps - steps_before,
        state=counted.state_dict(),
        records=counted.take(),
    )


def go_on(env: BaseEnv, policy: str | Mapping[str, Any], steps: int) -> None:
    """Take further control steps in a shard that has its episodes, as others have not."""
    acting: Any = resolve_policy(policy)
    for _ in range(steps):
        env.step(acting(None, env))


def play_sharded(
    env: ShardedEnv,
    policy: str | Mapping[str, Any],
    counted: EpisodeStatistics,
    most_steps: int | None = None,
) -> Iterator[None]:
    """Play until every environment has finished its quota; yields after each call of the shards.

    Args:
        env: The batch, just reset.
        policy: A policy that reads no observation and has no state.
        counted: The statistics of the batch, updated in place.
        most_steps: Control steps at most; None means no limit.
    """
    firsts = env.pool.firsts
    states: list[dict[str, Any]] = [
        counted.part(slice(first, first + count))
        for first, count in zip(firsts, env.pool.counts, strict=True)
    ]
    next_steps = _FIRST_STEPS
    while not counted.complete:
        start = time.perf_counter()
        steps = next_steps
        if most_steps is not None:
            steps = min(steps, most_steps - counted.steps)
        if steps < 1:
            return
        shards: list[Played] = env.advance(play_shard, [(policy, state, steps) for state in states])
        # All environments take as many steps as the one that needs most.
        longest = max(shard.steps for shard in shards)
        if any(shard.steps < longest for shard in shards):
            env.advance(go_on, [(policy, longest - shard.steps) for shard in shards])
        env.passed(longest)
        counted.merge([(first, shard.records) for first, shard in zip(firsts, shards, strict=True)])
        counted.steps += longest
        states = [{**shard.state, "steps": counted.steps} for shard in shards]
        seconds = time.perf_counter() - start
        if seconds < _SHORT_CALL_S:
            next_steps = min(2 * next_steps, _MOST_STEPS)
        elif seconds > _LONG_CALL_S:
            next_steps = max(next_steps // 2, 1)
        yield
