"""Shards in this process, which can be lost like those of a cluster."""

import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from embodichain.lab.gym.shards.shard import Shard
from embodichain.lab.gym.shards.shard_pool import ShardLostError, ShardPool
from embodichain.lab.gym.shards.sharded_env import ShardedEnv
from embodichain.lab.gym.shards.splitting import split_batch

Build = Callable[[int, int], Any]
"""``build(first, count)``: the environments of a shard."""


class Done:
    def __init__(self, result: Any) -> None:
        self._result = result

    def result(self) -> Any:
        if isinstance(self._result, Exception):
            raise self._result
        return pickle.loads(pickle.dumps(self._result))


class LocalShard:
    """A shard, called through copies, as by a network."""

    def __init__(self, build: Callable[[], Any], name: str) -> None:
        self.shard: Shard | None = Shard(build)
        self.node = name
        self.calls: list[str] = []

    def call(self, method: str, *args: Any) -> Done:
        self.calls.append(method)
        if self.shard is None:
            return Done(ShardLostError("it was lost on purpose"))
        try:
            return Done(getattr(self.shard, method)(*pickle.loads(pickle.dumps(args))))
        except Exception as error:  # noqa: BLE001  raised again by `result`
            return Done(error)

    def lose(self) -> None:
        """What a killed node does: nothing is closed."""
        self.shard = None

    def end(self) -> None:
        self.shard = None


class LocalShards:
    """Starts `LocalShard`s, and remembers them."""

    def __init__(self, build: Build, counts: list[int]) -> None:
        self._build, self._counts = build, counts
        self.started: list[LocalShard] = []
        self.running: dict[int, LocalShard] = {}

    def start(self, index: int) -> LocalShard:
        first, count = sum(self._counts[:index]), self._counts[index]
        shard = LocalShard(lambda: self._build(first, count), f"n{len(self.started)}")
        self.started.append(shard)
        self.running[index] = shard
        return shard


@contextmanager
def sharded(
    build: Build, num_envs: int, shards: int, save_every: int = 1000
) -> Iterator[tuple[ShardedEnv, LocalShards]]:
    """A batch in shards of this process."""
    counts = split_batch(num_envs, shards)
    source = LocalShards(build, counts)
    env = ShardedEnv(build(0, 1), ShardPool(source, counts, save_every))
    try:
        yield env, source
    finally:
        env.close()
