"""`sim.backend=ray`: the shards of a batch as Ray actors, on the nodes of a cluster or locally.

Ray is imported when a batch is built, not before.
"""

from __future__ import annotations

import logging
import os
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from embodichain.config.keys.schema import RayCfg
from embodichain.config.resolved import (
    Resolved,
    build_env,
    compile_scene_of,
    resolve_tree,
    thaw,
)
from embodichain.lab.gym.shards.shard_pool import ShardLostError, ShardPool
from embodichain.lab.gym.shards.splitting import numbers_in_shard, split_batch
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.shards.shard import Shard
    from embodichain.lab.gym.shards.sharded_env import ShardedEnv
    from embodichain.lab.sim.compiler.compile_scene import CompiledScene

__all__ = ["RayShards", "ShardBuilder", "make_sharded", "need_ray", "shard_config"]

_log = logging.getLogger(__name__)
_INLINE = 8_000_000
"""Bytes of a result that Ray sends with the answer of a call. Its own 100 kB is less than a step of
1,024 environments; what is larger goes through both nodes' object stores, which takes longer."""
_WAIT = 10.0
"""Seconds between two messages while no node has room for a shard."""


def need_ray() -> Any:
    """Import Ray.

    Raises:
        ConfigError: If it is not installed; names the extra.
    """
    try:
        import ray
    except ImportError as error:
        message = "ray: it needs the package ray: pip install 'embodichain[ray]'"
        raise ConfigError([Problem("sim.backend", message)]) from error
    return ray


def shard_config(resolved: Resolved, first: int, count: int) -> Resolved:
    """The config of a shard: an experiment of its own, with environments of the batch.

    Args:
        resolved: The config of the batch.
        first: The shard's first environment in the batch.
        count: Its number of environments.
    """
    sim = thaw(resolved.tree["sim"])
    sim["num_threads"] = sim["num_threads"] or sim["ray"]["cpus"]
    sim["backend"] = "local"
    sim["shards"] = 1
    sim["ray"] = vars(RayCfg())
    sim["first_env"] += first
    viewer = {**thaw(resolved.tree["viewer"]), "name": "none"}
    record = thaw(resolved.tree["record"])
    if "view_envs" in record:  # not with record=none
        record["view_envs"] = numbers_in_shard(record["view_envs"], first, count)
    images = record.get("images")
    if images is not None:
        images["envs"] = numbers_in_shard(images["envs"], first, count)
        record["images"] = images if images["envs"] else None
    return resolved.changed(num_envs=count, video=False, sim=sim, record=record, viewer=viewer)


@dataclass(frozen=True, slots=True)
class ShardBuilder:
    """Builds the environments of a shard, where it runs.

    Attributes:
        tree: The config of the shard, as plain values.
        task_name: Name of the task.
        kwargs: Arguments of the environment's class.
        folder: The working directory, for relative paths in the config.
        paths: Folders where Python finds the user's modules.
        varied: Key paths of the config that variations have set.
    """

    tree: Mapping[str, Any]
    task_name: str
    kwargs: dict[str, Any] = field(default_factory=dict)
    folder: str = ""
    paths: tuple[str, ...] = ()
    varied: frozenset[str] = frozenset()

    def __call__(self) -> BaseEnv:
        """Build the environments.

        Raises:
            ConfigError: As `make_env` does; a node may lack a file that this machine has.
        """
        sys.path += [path for path in self.paths if path not in sys.path]
        if self.folder and os.path.isdir(self.folder):
            os.chdir(self.folder)
        where = f"the config of environments {self.tree['sim']['first_env']} and on"
        name = self.task_name
        resolved = resolve_tree(self.tree, where, "run", task_name=name, allow_import=True)
        resolved = replace(resolved, varied=self.varied)
        return build_env(resolved, compile_scene_of(resolved), **self.kwargs)


class RemoteShard:
    """The actor: a `Shard` in a process of its own. Warnings are returned with the results."""

    def __init__(self) -> None:
        self._shard: Shard | None = None
        self._warnings = _Warnings()
        logger = logging.getLogger("embodichain")
        logger.addHandler(self._warnings)
        logger.propagate = False

    def node(self) -> str:
        """The host's name and the node's identifier in Ray."""
        import socket

        ray = need_ray()
        return f"{socket.gethostname()}/{ray.get_runtime_context().get_node_id()[:8]}"

    def build(self, builder: ShardBuilder) -> None:
        """Build the environments."""
        import torch

        from embodichain.lab.gym.shards.shard import Shard

        torch.set_num_threads(1)  # physics has its own threads
        self._shard = Shard(builder)

    def call(self, method: str, args: tuple[Any, ...]) -> tuple[Any, list[tuple[int, str]]]:
        """Call a method of the shard."""
        if self._shard is None:
            raise RuntimeError("the shard was not built")
        result = getattr(self._shard, method)(*args)
        return result, self._warnings.take()


class _Warnings(logging.Handler):
    """Stores warnings until they are sent."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._waiting: list[tuple[int, str]] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Store level and text of a record."""
        self._waiting.append((record.levelno, record.getMessage()))

    def take(self) -> list[tuple[int, str]]:
        """Return the stored warnings, and forget them."""
        waiting = self._waiting
        self._waiting = []
        return waiting


class _RayPending:
    """A call of an actor that is under way."""

    def __init__(self, ray: Any, reference: Any, name: str, *, returns_warnings: bool) -> None:
        self._ray = ray
        self._reference = reference
        self._name = name
        self._returns_warnings = returns_warnings

    def result(self) -> Any:
        """Wait for the result."""
        errors = self._ray.exceptions
        try:
            answer = self._ray.get(self._reference)
        except (
            errors.RayActorError,
            errors.NodeDiedError,
            errors.ObjectLostError,
            errors.WorkerCrashedError,
        ) as error:
            raise ShardLostError(_first_line(error)) from error
        except errors.RayTaskError as error:
            if isinstance(error.cause, Exception):
                raise error.cause from error
            raise
        if not self._returns_warnings:
            return answer
        result, warnings = answer
        for level, text in warnings:
            _log.log(level, "%s: %s", self._name, text)
        return result


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0] if lines else type(error).__name__


class RayShard:
    """A shard in an actor.

    Args:
        actor: The actor's class, with its resources.
        builder: Builds its environments.
        index: Its index in the batch.
    """

    def __init__(self, actor: Any, builder: ShardBuilder, index: int) -> None:
        self._ray = need_ray()
        self._actor = actor.remote()
        self._name = f"shard {index}"
        self._node: str | None = None
        self._where = self._actor.node.remote()
        self._built = self._actor.build.remote(builder)

    @property
    def node(self) -> str:
        """Where it runs; empty if it never did."""
        return self._node or ""

    def ready(self) -> None:
        """Wait until its environments are built.

        Raises:
            ShardLostError: If it is gone.
            Exception: Any exception of the builder.
        """
        begun = time.monotonic()
        while not self._ray.wait([self._where], timeout=_WAIT)[0]:
            waited = time.monotonic() - begun
            why = "no node has free cores, or its process takes as long"
            _log.warning("%s has not started after %.0f s: %s", self._name, waited, why)
        where = _RayPending(self._ray, self._where, self._name, returns_warnings=False)
        self._node = where.result()
        _RayPending(self._ray, self._built, self._name, returns_warnings=False).result()

    def call(self, method: str, *args: Any) -> _RayPending:
        """Begin to call a method."""
        reference = self._actor.call.remote(method, args)
        return _RayPending(self._ray, reference, self._name, returns_warnings=True)

    def end(self) -> None:
        """End the actor's process."""
        self._ray.kill(self._actor)


class RayShards:
    """Starts the shards of a batch as actors.

    Args:
        builders: For each shard.
        cpus: Cores that each shard reserves.
        address: The cluster's; None is ``RAY_ADDRESS``, or a cluster of this machine alone.

    Raises:
        ConfigError: If Ray is not installed, or the cluster cannot be reached or has too few cores.
    """

    def __init__(
        self, builders: Sequence[ShardBuilder], cpus: int, address: str | None = None
    ) -> None:
        ray = need_ray()
        self._ray = ray
        self._builders = tuple(builders)
        needed = len(builders) * cpus
        self._has_connected = not ray.is_initialized()
        if self._has_connected:
            _connect(ray, address, needed)
        available = int(ray.cluster_resources().get("CPU", 0))
        if available < needed:
            self.disconnect()
            message = (
                f"{len(builders)} shards of {cpus} cores each need {needed}, there are {available}"
            )
            raise ConfigError([Problem("sim.shards", message)])
        as_actor = ray.remote(num_cpus=cpus, max_restarts=0, scheduling_strategy="SPREAD")
        self._actor = as_actor(RemoteShard)
        self._started: set[int] = set()
        self._shards = [RayShard(self._actor, builder, k) for k, builder in enumerate(builders)]

    def start(self, index: int) -> RayShard:
        """Start a shard; the first time, all of them are built at once."""
        if index in self._started:
            self._shards[index] = RayShard(self._actor, self._builders[index], index)
        self._started.add(index)
        shard = self._shards[index]
        try:
            shard.ready()
        except ShardLostError:
            shard.end()
            raise
        return shard

    def disconnect(self) -> None:
        """Leave the cluster, unless the caller of this process had connected."""
        if self._has_connected:
            self._ray.shutdown()


def _connect(ray: Any, address: str | None, cores: int) -> None:
    """Connect to a cluster, or start one on this machine with enough cores for all shards."""
    quiet = {"log_to_driver": True, "configure_logging": False}
    address = address or os.environ.get("RAY_ADDRESS")
    try:
        if address is not None:
            ray.init(address=address, **quiet)
            return
        os.environ.setdefault("RAY_max_direct_call_object_size", str(_INLINE))
        available = len(os.sched_getaffinity(0))
        if cores > available:
            _log.warning("%d cores of shards share the %d cores of this machine", cores, available)
        ray.init(num_cpus=max(cores, available), include_dashboard=False, **quiet)
    except (ConnectionError, RuntimeError, ValueError) as error:
        message = f"no Ray cluster at {address or 'this machine'}: {_first_line(error)}"
        raise ConfigError([Problem("sim.ray.address", message)]) from error


class _Disconnecting(ShardPool):
    """Shards of a cluster that this process connected to for them."""

    def __init__(self, source: RayShards, counts: Sequence[int], save_every: int) -> None:
        self._cluster = source
        try:
            super().__init__(source, counts, save_every)
        except BaseException:
            source.disconnect()
            raise

    def close(self) -> None:
        """Close the shards, then leave the cluster."""
        try:
            super().close()
        finally:
            self._cluster.disconnect()


def make_sharded(
    resolved: Resolved, kwargs: Mapping[str, Any], compiled_scene: CompiledScene | None = None
) -> ShardedEnv:
    """Build the batch of a config with ``sim.backend=ray``.

    Args:
        resolved: A checked config.
        kwargs: As of `make_env`.
        compiled_scene: As of `make_env`, for this process; each shard compiles its own.

    Raises:
        ConfigError: As `make_env` and `RayShards` do.
        TypeError: If an argument has no form with shards.
    """
    from embodichain.lab.gym.shards.sharded_env import ShardedEnv

    rest = dict(kwargs)
    run_dir = rest.pop("run_dir", None)
    for name in ("render_mode", "autoreset_mode"):
        if rest.pop(name, None) is not None:
            raise TypeError(f"{name} has no form with sim.backend=ray")
    sim = resolved.root.sim
    num_envs = resolved.root.num_envs or 1
    shards = min(sim.shards, num_envs)
    if shards < sim.shards:  # an evaluation of few episodes
        _log.warning("%d environments are in %d shards, not %d", num_envs, shards, sim.shards)
    counts = split_batch(num_envs, shards)
    paths = tuple(path for path in sys.path if path)
    builders = []
    for k, count in enumerate(counts):
        builder = ShardBuilder(
            tree=thaw(shard_config(resolved, sum(counts[:k]), count).tree),
            task_name=resolved.task_name,
            kwargs=rest,
            folder=os.getcwd(),
            paths=paths,
            varied=resolved.varied,
        )
        builders.append(builder)
    source = RayShards(builders, sim.ray.cpus, sim.ray.address)
    template = None
    try:
        if compiled_scene is None:
            compiled_scene = compile_scene_of(resolved)
        template = build_env(shard_config(resolved, 0, 1), compiled_scene, **rest)
        pool = _Disconnecting(source, counts, sim.ray.save_every)
        return ShardedEnv(template, pool, run_dir)
    except BaseException:
        if template is not None:
            template.close()
        source.disconnect()
        raise
