"""`embodichain augment`: collect episodes that repeat recorded ones in other starts."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from embodichain.cli.jobs.job import execute, output_overrides
from embodichain.cli.jobs.resuming import COLLECTION_KEYS, parse_changes, with_changes
from embodichain.cli.jobs.work.collect_job import collect_job
from embodichain.cli.terminal.last import announce_last
from embodichain.cli.verb import OverrideOptions, command_line, complete_last, overrides, verb
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved

__all__ = ["command"]

_POLICY = "embodichain.recording.demos.augmentation:Augmented"


@dataclass(frozen=True, kw_only=True)
class AugmentOptions(OverrideOptions):
    """What was typed after `augment`.

    Attributes:
        source: The log or folder with the episodes to repeat, or ``last``.
    """

    source: str


@verb(
    "augment",
    ("augment last episodes=100", "from the newest run or collection"),
    ("augment outputs/latest episodes=1000 num_envs=64", "more of them"),
    ("augment rollout.mcap task.events.place_cube.params.position_range=...", "in other starts"),
    options=AugmentOptions,
    keys=True,
    quiet=True,
)
@click.argument("source", metavar="FOLDER|FILE|last", shell_complete=complete_last)
@overrides("[KEY=VALUE]...", config="collect")
def command(options: AugmentOptions) -> None:
    """Collect into a new run folder."""
    path = _find_source(options.source)
    lines = [*options.words, *output_overrides(options)]
    execute(_resolve_log(path, lines), collect_job, command_line(), verb="collect")


def _find_source(name: str) -> Path:
    """Find the log or folder with the episodes to repeat.

    Raises:
        ConfigError: There is no such file or folder.
    """
    from embodichain.config.run_folder import LOG, newest_run, perhaps_last

    path = newest_run("outputs", LOG) if name == "last" else Path(name)
    if path is None:
        raise ConfigError("no run in outputs has a log yet: embodichain collect task=NAME")
    if name == "last":
        announce_last(path)
    if not path.exists():
        raise ConfigError(f"there is no {name!r}{perhaps_last(name)}")
    return path.resolve()


def _resolve_log(path: Path, lines: list[str]) -> Resolved:
    """Return the config of the log's task, to collect with `Augmented`.

    Raises:
        ConfigError: The log has no config, or an override is wrong.
    """
    from embodichain.config.resolved import resolve_tree
    from embodichain.recording.read.recorded_log import RecordedLog

    bare_words = [line for line in lines if "=" not in line]
    if bare_words:
        raise ConfigError(f"values are given as key=value: {', '.join(bare_words)}")
    changes = parse_changes(lines, (*COLLECTION_KEYS, "seed", "task"), "an augmented collection")
    if "resume" in changes:
        raise ConfigError("to continue an augmented collection: embodichain collect resume=FOLDER")
    with RecordedLog(path) as log:
        recorded_tree = dict(log.written_config)
        task = log.task
    if "task" not in recorded_tree:
        raise ConfigError(f"{path} contains no config: it was not recorded by `run` or `collect`")
    tree = with_changes({**recorded_tree, **_root_values(recorded_tree)}, changes)
    resolved = resolve_tree(tree, f"{path}: config.yaml", "collect", task_name=task)
    policy = {"func": _POLICY, "params": {"demonstrations": str(path)}}
    return dataclasses.replace(resolved.changed(policy=policy), overrides=tuple(lines))


def _root_values(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Root keys that do not carry over from the run to the collection of it."""
    record = {**tree.get("record", {}), "format": "mcap", "state": "all", "every": 1}
    return {
        "quiet": False,
        "json": False,
        "traceback": False,
        "resume": None,
        "num_envs": None,
        "episodes": None,
        "seed": None,
        "policy": None,
        "algo": None,
        "viewer": {"name": "none"},
        "record": record,
        "output_dir": "outputs",
        "video": None,
        "max_steps": None,
        "trust": False,
    }
