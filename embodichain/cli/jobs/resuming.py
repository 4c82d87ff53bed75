"""``resume=RUN``: the config of an earlier run, in which only few keys may change."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.cli.jobs.job import output_overrides
from embodichain.cli.terminal.last import take_last
from embodichain.cli.verb import JobOptions
from embodichain.cli.words import split_overrides
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved

__all__ = [
    "COLLECTION_KEYS",
    "parsed_changes",
    "resumed_collection",
    "resumed_folder",
    "resumed_training",
    "resumption",
    "with_changes",
]

COLLECTION_KEYS = ("episodes", "num_envs", "max_steps", "collect", "viewer", "video", "device")
"""Keys (and what is below them) that may change in a resumed collection, besides `_ALWAYS`."""
TRAINING_KEYS = ("total_timesteps", "dataset", "checkpoint", "eval", "video", "wandb")
"""Keys (and what is below them) that may change in a resumed training, besides `_ALWAYS`."""
_ALWAYS = ("record", "sim", "output_dir", "allow_changed", "quiet", "json", "traceback")
"""Keys that may change in every resumption."""


def resumption(options: JobOptions) -> list[str] | None:
    """Return the overrides of a command that resumes a run, or None if it does not.

    Raises:
        ConfigError: It has flags that a resumption cannot have.
    """
    words = options.words
    if not any(line.lstrip("+").startswith("resume=") for line in words):
        return None
    hydras = any(line.lstrip("+~").startswith(("hydra.", "hydra/")) for line in words)
    flags = options.cfg, options.info, options.gym_config
    if options.multirun or hydras or any(flag is not None for flag in flags):
        only = "no --multirun, no --gym-config, no key of Hydra's"
        raise ConfigError(f"resume continues one run: {only}")
    return [*split_overrides(words), *output_overrides(options)]


def parsed_changes(
    overrides: Sequence[str], may_change: Sequence[str], what: str
) -> dict[str, Any]:
    """Return the values of overrides by key.

    Args:
        overrides: As typed: ``key=value``.
        may_change: Keys that may change (and what is below them), besides those of any run.
        what: The kind of run with its article, for messages.

    Raises:
        ConfigError: An override is malformed, or sets a key that may not change.
    """
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import OverrideParseException

    from embodichain.config.composition.override_text import readable

    try:
        parsed = OverridesParser.create().parse_overrides([*map(readable, overrides)])
    except OverrideParseException as error:
        raise ConfigError(str(error)) from error
    wrong = [o.input_line or "" for o in parsed if o.is_delete() or o.is_sweep_override()]
    if wrong:
        message = "takes no deletions and no sweeps"
        raise ConfigError([Problem("", f"{what} {message}: {line!r}") for line in wrong])
    changes = {o.key_or_group: o.value() for o in parsed}
    keys = (*may_change, *_ALWAYS)
    problems = [
        Problem(key, f"{what} keeps its config; what may change: {', '.join(keys)}")
        for key in changes
        if key.partition(".")[0] not in (*keys, "resume")
    ]
    if problems:
        raise ConfigError(problems)
    return changes


def resumed_folder(name: str, newest: Path | None, what: str) -> Path:
    """Return the folder of the run to resume, without temporary files of killed processes.

    Args:
        name: As typed; ``last`` is `newest`.
        newest: The newest run of this kind, or None.
        what: The kind of run, for messages.

    Raises:
        ConfigError: There is none, or it has no config.
    """
    from embodichain.config.run_folder import CHECKPOINT, CONFIG, perhaps_last
    from embodichain.utils.system.atomic import remove_abandoned

    folder = newest if name == "last" else Path(name)
    if folder is None:
        raise ConfigError([Problem("resume", f"there is no {what} to resume yet")])
    if not (folder / CONFIG).is_file():
        message = f"{name!r} is not a {what}'s folder: it has no {CONFIG}{perhaps_last(name)}"
        raise ConfigError([Problem("resume", message)])
    if name == "last":
        take_last(folder)
    for written in (folder, folder / Path(CHECKPOINT).parent):
        remove_abandoned(written)
    return folder.resolve()


def with_changes(tree: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a run's config with changed keys; an option of the group `record` sets the format."""
    changed = dict(tree)
    for key, value in changes.items():
        path = "record.format" if key == "record" and isinstance(value, str) else key
        *parents, last = path.split(".")
        node = changed
        for parent in parents:
            node[parent] = dict(node.get(parent) or {})
            node = node[parent]
        node[last] = value
    return changed


def resumed_collection(overrides: Sequence[str]) -> tuple[Resolved, Path, int]:
    """The config of a collection that is resumed, its folder, and how many successes it has.

    Raises:
        ConfigError: There is no such collection, or a key may not change.
    """
    from embodichain.config.rerun import read_config, task_of
    from embodichain.config.resolved import resolve_tree
    from embodichain.config.run_folder import CONFIG, newest_run
    from embodichain.recording.demos.collection import SUCCESSES, read_collection

    changes = parsed_changes(overrides, (*COLLECTION_KEYS, "trust"), "a resumed collection")
    name = str(changes.pop("resume"))
    newest = newest_run(changes.get("output_dir", "outputs"), SUCCESSES)
    folder = resumed_folder(name, newest, "collection")
    done = len(read_collection(folder))
    fresh = {"quiet": False, "json": False, "traceback": False, "resume": str(folder)}
    fresh |= {"trust": False}  # a folder does not decide which code this machine runs
    tree = with_changes({**read_config(folder / CONFIG), **fresh}, changes)
    source = str(folder / CONFIG)
    resumed = resolve_tree(tree, source, "collect", task_name=task_of(folder), allow_import=True)
    resumed = dataclasses.replace(resumed, overrides=tuple(overrides))
    return resumed, folder, done


def resumed_training(overrides: Sequence[str]) -> Resolved:
    """The config of a training that is resumed.

    Args:
        overrides: As typed: ``resume=RUN`` (or ``last``) and keys that may change.

    Raises:
        ConfigError: There is no such run, none of its checkpoints can be resumed, or an override
            sets a key that may not change.
    """
    from embodichain.config.rerun import read_config
    from embodichain.config.resolved import resolve_tree
    from embodichain.config.run_folder import CONFIG, newest_run
    from embodichain.learning.checkpoints.checkpoint import read_note
    from embodichain.learning.training.keeper import find_resumable
    from embodichain.learning.training.train import check_training, check_unfinished

    changes = parsed_changes(overrides, TRAINING_KEYS, "a resumed training")
    name = str(changes.pop("resume"))
    output_dir = changes.get("output_dir", "outputs")
    folder = resumed_folder(name, newest_run(output_dir, "checkpoints/*.zip"), "training")
    checkpoint, state = find_resumable(folder)
    fresh: dict[str, Any] = {"quiet": False, "json": False, "traceback": False}
    fresh |= {"allow_changed": False, "trust": False, "resume": str(folder)}
    tree = with_changes({**read_config(folder / CONFIG), **fresh}, changes)
    task = str(read_note(checkpoint).get("task", "task"))
    source = str(folder / CONFIG)
    resumed = resolve_tree(tree, source, "train", task_name=task, allow_import=True)
    check_training(resumed)
    check_unfinished(checkpoint, state["env_steps"], resumed.root.total_timesteps or 0)
    return dataclasses.replace(resumed, overrides=tuple(overrides))
