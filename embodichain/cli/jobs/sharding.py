"""Jobs in shards (`sim.backend=ray`): their logs, and policies that act inside of the shards."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.config.checks.shard_checks import IN_SHARDS
from embodichain.config.environments.ray_shards import shard_config
from embodichain.config.resolved import dump_yaml
from embodichain.lab.gym.shards.sharded_env import ShardedEnv
from embodichain.recording.shards.shard_logs import ShardLogs

if TYPE_CHECKING:
    from embodichain.config.keys.schema import RootCfg
    from embodichain.config.resolved import Resolved
    from embodichain.learning.episode_statistics import EpisodeStatistics

__all__ = ["attach_logs", "play_inside"]


def attach_logs(
    resolved: Resolved, env: Any, path: Path, arguments: Mapping[str, Any]
) -> ShardLogs:
    """Attach a log to every shard of a batch.

    Args:
        resolved: The config of the job.
        env: The batch.
        path: The name that the log of one process would have.
        arguments: Further arguments of `ShardLogs`.

    Raises:
        TypeError: If the batch is not in shards.
    """
    if not isinstance(env, ShardedEnv):
        raise TypeError(f"sim.backend=ray makes shards, not {type(env).__name__}")

    def config_of(first: int, count: int) -> str:
        return dump_yaml(shard_config(resolved, first, count).tree)

    return ShardLogs(path, env, config_of=config_of, **arguments)


def play_inside(root: RootCfg, env: Any, counted: EpisodeStatistics) -> Iterator[None] | None:
    """Play episodes inside of the shards, many steps at a time, if the policy can act there.

    It can if it reads no observation and has no state, and no curriculum needs to know of resets
    in other shards. Results do not depend on it.

    Args:
        root: The config of the job.
        env: The batch, just reset.
        counted: The statistics, updated in place.

    Returns:
        An iterator that advances the batch, and yields between two calls of the shards; or None.
    """
    policy: Any = root.policy or "random"
    name = policy
    if not isinstance(policy, str):
        name = policy.func
        policy = {"func": policy.func, "params": policy.params}
    if not isinstance(env, ShardedEnv) or name not in IN_SHARDS or root.task.curriculum:
        return None
    from embodichain.learning.evaluation.sharded_play import play_sharded

    return play_sharded(env, policy, counted, root.max_steps)
