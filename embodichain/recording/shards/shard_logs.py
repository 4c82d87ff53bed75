"""The logs of a batch in shards: one for each shard, and a manifest that joins them.

`rollout.mcap` of one process becomes `rollout.shard0.mcap`, `rollout.shard1.mcap`, ... and
`rollout.shards.json`. A shard's log is a log like any other; a new file begins in it whenever the
shard is saved. If a shard is lost, its files since the last save are renamed to `*.lostN.mcap`, and
the rebuilt shard writes these steps again.
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
        """Begin the log, or continue it at a place and rename a lost shard's files from there."""
        if self.losses:
            self._rename_lost_files(0 if place is None else place.part)
        self._recorder = McapRecorder(
            self.path,
            env,
            config=self.config,
            overrides=self.overrides,
            options=self.options,
            task=self.task,
            policy=self.policy,
            place=place,
            quota=self.quota,
        )
        env.add_observer(self._recorder)

    def _rename_lost_files(self, part: int) -> None:
        path = self.path.with_name(part_name(self.path.name, part))
        while path.exists():
            path.rename(path.with_name(f"{path.stem}.lost{self.losses}{path.suffix}"))
            part += 1
            path = self.path.with_name(part_name(self.path.name, part))

    def save(self) -> LogPlace | None:
        """Write everything so far, and continue in another file."""
        if self._recorder is None:
            return None
        return self._recorder.begin_part()


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
            ShardEntry(shard_log(path.name, shard), first, count)
            for shard, (first, count) in enumerate(zip(pool.firsts, pool.counts, strict=True))
        ]
        recorders = [
            ShardRecorder(
                path.with_name(entry.log).resolve(),
                _local_options(options, entry),
                config=config_of(entry.first_env, entry.num_envs),
                overrides=overrides,
                task=task,
                policy=policy,
                quota=_local_quota(quota, entry),
            )
            for entry in self.entries
        ]
        self._write(complete=False)
        pool.record(lambda shard, losses: replace(recorders[shard], losses=losses))
        env.at_close.append(lambda: self._write(complete=True))

    @property
    def manifest(self) -> Path:
        """The manifest's path."""
        return self._path.with_name(self._path.stem + SHARDS_SUFFIX)

    @property
    def stats(self) -> RecordStats:
        """What has been recorded: the manifest, steps, and bytes of all files of the logs."""
        nbytes = 0
        for entry in self.entries:
            for file in self._path.parent.glob(f"{Path(entry.log).stem}*.mcap"):
                if ".lost" not in file.name:
                    nbytes += file.stat().st_size
        return RecordStats(self.manifest, steps=self._env.pool.steps, nbytes=nbytes)

    def _write(self, complete: bool) -> None:
        pool = self._env.pool
        shards = [
            {
                "log": entry.log,
                "first_env": entry.first_env,
                "num_envs": entry.num_envs,
                "node": node,
            }
            for entry, node in zip(self.entries, pool.nodes, strict=True)
        ]
        content = {
            "num_envs": self._env.num_envs,
            "complete": complete,
            "shards": shards,
            "rebuilt": pool.rebuilt,
        }
        write_text(self.manifest, json.dumps(content, indent=1) + "\n")


def _local_options(options: RecordOptions, entry: ShardEntry) -> RecordOptions:
    """The options with the shard's own numbers of environments."""
    images = options.images
    if images is not None:
        envs = numbers_in_shard(images.envs, entry.first_env, entry.num_envs)
        images = replace(images, envs=envs) if envs else None
    view_envs = numbers_in_shard(options.view_envs, entry.first_env, entry.num_envs)
    return replace(options, view_envs=view_envs, images=images)


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
            raise ConfigError(f"{path} is not a manifest of shards: it is too large")
        content: Any = json.loads(path.read_text())
        entries = tuple(
            ShardEntry(
                log=str(shard["log"]),
                first_env=int(shard["first_env"]),
                num_envs=int(shard["num_envs"]),
            )
            for shard in content["shards"]
        )
        total = int(content["num_envs"])
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}") from error
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not a manifest of shards: {error!r}") from error
    num_envs = 0
    for entry in entries:
        if entry.first_env != num_envs or entry.num_envs < 1 or not _NAME.match(entry.log):
            raise ConfigError(f"{path} is not a manifest of shards: {entry} does not continue it")
        num_envs += entry.num_envs
    if not entries or num_envs != total:
        raise ConfigError(f"{path} is not a manifest of shards: {num_envs} of {total} environments")
    return entries
