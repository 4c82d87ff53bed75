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

_FIRST, _MOST = 16, 4096
"""Control steps of the first call, and of a call at most."""
_SHORT, _LONG = 0.25, 1.0
"""Seconds of a call: shorter ones take twice as many steps next time, longer ones half as many."""


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
    before = counted.steps
    for _ in islice(play(env, resolve_policy(policy), None, counted), steps):
        pass
    return Played(counted.steps - before, counted.state_dict(), counted.take())


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
        most_steps: Control steps at most; None is no limit.
    """
    rows = [slice(f, f + n) for f, n in zip(env.pool.firsts, env.pool.counts, strict=True)]
    states: list[dict[str, Any]] = [counted.part(mine) for mine in rows]
    size = _FIRST
    while not counted.complete:
        begun = time.perf_counter()
        steps = size if most_steps is None else min(size, most_steps - counted.steps)
        if steps < 1:
            return
        args = [(policy, state, steps) for state in states]
        found: list[Played] = env.advance(play_shard, args)
        states = [one.state for one in found]
        # All environments take as many steps as the one that needs most.
        taken = max(one.steps for one in found)
        if any(one.steps < taken for one in found):
            env.advance(go_on, [(policy, taken - one.steps) for one in found])
        env.passed(taken)
        counted.merge([(mine.start, one.records) for mine, one in zip(rows, found, strict=True)])
        counted.steps += taken
        for state in states:
            state["steps"] = counted.steps
        seconds = time.perf_counter() - begun
        if seconds < _SHORT:
            size = min(2 * size, _MOST)
        elif seconds > _LONG:
            size = max(size // 2, 1)
        yield
