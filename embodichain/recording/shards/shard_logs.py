"""The logs of a batch in shards: one for each shard, and a manifest that joins them.

`rollout.mcap` of one process becomes `rollout.shard0.mcap`, `rollout.shard1.mcap`, ... and
`rollout.shards.json`. A shard's log is one like any other, in several files where the shard was
saved. The files of a lost shard since it was saved last are kept as `*.lostN.mcap`; the rebuilt
shard writes these steps again.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.lab.gym.shards.splitting import numbers_in_shard
from embodichain.recording.format.options import RecordOptions
from embodichain.recording.format.parts import LogPlace, part_name
from embodichain.recording.write.recorder import McapRecorder, RecordStats
from embodichain.utils.errors import ConfigError
from embodichain.utils.system.atomic import write_text

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.shards.sharded_env import ShardedEnv

__all__ = ["SHARDS_SUFFIX", "ShardEntry", "ShardLogs", "ShardRecorder", "read_shards", "shard_log"]

SHARDS_SUFFIX = ".shards.json"
"""Suffix of the manifest's name."""
_LARGEST = 2**26
_NAME = re.compile(r"[^/\\\0]{1,255}\Z")


def shard_log(name: str, shard: int) -> str:
    """Name of a shard's log: ``rollout.shard0.mcap``."""
    path = Path(name)
    return f"{path.stem}.shard{shard}{path.suffix}"


@dataclass(slots=True)
class ShardRecorder:
    """Records a shard, where it runs: a `ShardLog`.

    Attributes:
        path: The shard's log; the folder is the same on all nodes.
        options: What to record, with the shard's own numbers of environments.
        config: The shard's config as YAML.
        overrides: The command line's overrides.
        task: The task's name.
        policy: The source of the actions.
        losses: How often the shard was rebuilt.
        quota: (N,) how many episodes of each of its environments count; None if not known.
    """

    path: Path
    options: RecordOptions
    config: str = ""
    overrides: str | Sequence[str] = ()
    task: str = ""
    policy: str = ""
    losses: int = 0
    quota: Sequence[int] | None = None
    _recorder: McapRecorder | None = field(default=None, repr=False)

    def begin(self, env: BaseEnv, place: LogPlace | None) -> None:
        """Begin the log, or continue it at a place; what a lost shard wrote there is renamed."""
        if self.losses:
            self._set_aside(0 if place is None else place.part)
        about = self.config, self.overrides, self.options, self.task, self.policy
        self._recorder = McapRecorder(self.path, env, *about, place, self.quota)
        env.add_observer(self._recorder)

    def _set_aside(self, part: int) -> None:
        while (path := self.path.with_name(part_name(self.path.name, part))).exists():
            path.rename(path.with_name(f"{path.stem}.lost{self.losses}{path.suffix}"))
            part += 1

    def save(self) -> LogPlace | None:
        """Write everything so far, and continue in another file."""
        return None if self._recorder is None else self._recorder.begin_part()


@dataclass(frozen=True, slots=True)
class ShardEntry:
    """The manifest's entry of a shard.

    Attributes:
        log: Name of its log in the manifest's folder.
        first_env: Its first environment in the batch.
        num_envs: Number of its environments.
    """

    log: str
    first_env: int
    num_envs: int


class ShardLogs:
    """Records all shards of a batch, and writes the manifest.

    Args:
        path: The name that the log of one process would have, in an existing folder.
        env: The batch.
        options: What to record; environments are those of the batch.
        config_of: Function from a shard's first environment and number of environments to its
            config as YAML.
        overrides: The command line's overrides.
        task: The task's name.
        policy: The source of the actions.
        quota: (N,) how many episodes of each environment count; None if not known.
    """

    def __init__(
        self,
        path: Path,
        env: ShardedEnv,
        options: RecordOptions,
        config_of: Callable[[int, int], str],
        overrides: str | Sequence[str] = (),
        task: str = "",
        policy: str = "",
        quota: Sequence[int] | None = None,
    ) -> None:
        self._path = path
        self._env = env
        pool = env.pool
        self.entries = [
            ShardEntry(shard_log(path.name, k), first, count)
            for k, (first, count) in enumerate(zip(pool.firsts, pool.counts, strict=True))
        ]
        about = overrides, task, policy
        recorders = [
            ShardRecorder(
                path.with_name(entry.log).resolve(),
                _local_options(options, entry),
                config_of(entry.first_env, entry.num_envs),
                *about,
                quota=_local_quota(quota, entry),
            )
            for entry in self.entries
        ]
        self._write(complete=False)
        pool.record(lambda k, losses: replace(recorders[k], losses=losses))
        env.at_close.append(lambda: self._write(complete=True))

    @property
    def manifest(self) -> Path:
        """The manifest's path."""
        return self._path.with_name(self._path.stem + SHARDS_SUFFIX)

    @property
    def stats(self) -> RecordStats:
        """What has been recorded: the manifest, steps, and bytes of all files of the logs."""
        names = [Path(entry.log).stem for entry in self.entries]
        files = [file for name in names for file in self._path.parent.glob(f"{name}*.mcap")]
        written = sum(file.stat().st_size for file in files if ".lost" not in file.name)
        return RecordStats(self.manifest, self._env.pool.steps, written)

    def _write(self, complete: bool) -> None:
        pool = self._env.pool
        shards = [
            {"log": entry.log, "first_env": entry.first_env, "num_envs": entry.num_envs}
            for entry in self.entries
        ]
        content = {
            "num_envs": self._env.num_envs,
            "complete": complete,
            "shards": [{**s, "node": n} for s, n in zip(shards, pool.nodes, strict=True)],
            "rebuilt": pool.rebuilt,
        }
        write_text(self.manifest, json.dumps(content, indent=1) + "\n")


def _local_options(options: RecordOptions, entry: ShardEntry) -> RecordOptions:
    """The options with the shard's own numbers of environments."""
    span = (entry.first_env, entry.num_envs)
    images = options.images
    if images is not None:
        mine = numbers_in_shard(images.envs, *span)
        images = replace(images, envs=mine) if mine else None
    viewed = numbers_in_shard(options.view_envs, *span)
    return replace(options, view_envs=viewed, images=images)


def _local_quota(quota: Sequence[int] | None, entry: ShardEntry) -> Sequence[int] | None:
    """The quota of the shard's own environments."""
    if quota is None:
        return None
    return quota[entry.first_env : entry.first_env + entry.num_envs]


def read_shards(path: Path) -> tuple[ShardEntry, ...]:
    """Read a manifest.

    Args:
        path: The manifest.

    Raises:
        ConfigError: If it cannot be read, or does not describe all environments of a batch.
    """
    try:
        if path.stat().st_size > _LARGEST:
            raise ConfigError(f"{path} is no manifest of shards: it is too large")
        found: Any = json.loads(path.read_text())
        entries = tuple(
            ShardEntry(str(s["log"]), int(s["first_env"]), int(s["num_envs"]))
            for s in found["shards"]
        )
        total = int(found["num_envs"])
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}") from error
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is no manifest of shards: {error!r}") from error
    at = 0
    for entry in entries:
        if entry.first_env != at or entry.num_envs < 1 or not _NAME.match(entry.log):
            raise ConfigError(f"{path} is no manifest of shards: {entry} does not continue it")
        at += entry.num_envs
    if not entries or at != total:
        raise ConfigError(f"{path} is no manifest of shards: {at} of {total} environments")
    return entries
