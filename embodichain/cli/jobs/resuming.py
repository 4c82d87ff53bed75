"""``resume=RUN``: the config of an earlier run, in which only few keys may change."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.cli.jobs.job import output_overrides
from embodichain.cli.terminal.last import announce_last
from embodichain.cli.verb import JobOptions
from embodichain.cli.words import split_overrides
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved

__all__ = [
    "COLLECTION_KEYS",
    "ResumedCollection",
    "find_resumed_folder",
    "parse_changes",
    "resolve_resumed_collection",
    "resolve_resumed_training",
    "resuming_overrides",
    "with_changes",
]

COLLECTION_KEYS = ("episodes", "num_envs", "max_steps", "collect", "viewer", "video", "device")
"""Keys (and what is below them) that may change in a resumed collection, besides `_ALWAYS`."""
TRAINING_KEYS = ("total_timesteps", "dataset", "checkpoint", "eval", "video", "wandb")
"""Keys (and what is below them) that may change in a resumed training, besides `_ALWAYS`."""
_ALWAYS = ("record", "sim", "output_dir", "allow_changed", "quiet", "json", "traceback")
"""Keys that may change in every resumption."""


def resuming_overrides(options: JobOptions) -> list[str] | None:
    """Return the overrides of a command that resumes a run, or None if it does not.

    Raises:
        ConfigError: It has flags that a resumption cannot have.
    """
    words = options.words
    if not any(word.lstrip("+").startswith("resume=") for word in words):
        return None
    has_hydra_key = any(word.lstrip("+~").startswith(("hydra.", "hydra/")) for word in words)
    has_flag = (
        options.multirun
        or options.cfg is not None
        or options.info is not None
        or options.gym_config is not None
    )
    if has_flag or has_hydra_key:
        raise ConfigError(
            "resume continues one run: no --multirun, no --gym-config, no key of Hydra's"
        )
    return [*split_overrides(words), *output_overrides(options)]


def parse_changes(
    overrides: Sequence[str], may_change: Sequence[str], run_kind: str
) -> dict[str, Any]:
    """Return the values of overrides by key.

    Args:
        overrides: As typed: ``key=value``.
        may_change: Keys that may change (and what is below them), besides those of any run.
        run_kind: The kind of run with its article, for messages.

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
    problems: list[Problem] = []
    for override in parsed:
        if override.is_delete() or override.is_sweep_override():
            line = override.input_line or ""
            message = f"{run_kind} takes no deletions and no sweeps: {line!r}"
            problems.append(Problem("", message))
    if problems:
        raise ConfigError(problems)
    changes = {override.key_or_group: override.value() for override in parsed}
    allowed_keys = (*may_change, *_ALWAYS)
    for key in changes:
        root_key = key.partition(".")[0]
        if root_key not in (*allowed_keys, "resume"):
            message = f"{run_kind} keeps its config; what may change: {', '.join(allowed_keys)}"
            problems.append(Problem(key, message))
    if problems:
        raise ConfigError(problems)
    return changes


def find_resumed_folder(name: str, newest: Path | None, run_kind: str) -> Path:
    """Return the folder of the run to resume; temporary files of killed processes are removed.

    Args:
        name: As typed; ``last`` is `newest`.
        newest: The newest run of this kind, or None.
        run_kind: The kind of run, for messages.

    Raises:
        ConfigError: There is none, or it has no config.
    """
    from embodichain.config.run_folder import CHECKPOINT, CONFIG, perhaps_last
    from embodichain.utils.system.atomic import remove_abandoned

    folder = newest if name == "last" else Path(name)
    if folder is None:
        raise ConfigError([Problem("resume", f"there is no {run_kind} to resume yet")])
    if not (folder / CONFIG).is_file():
        hint = perhaps_last(name)
        message = f"{name!r} is not a {run_kind}'s folder: it has no {CONFIG}{hint}"
        raise ConfigError([Problem("resume", message)])
    if name == "last":
        announce_last(folder)
    remove_abandoned(folder)
    remove_abandoned(folder / Path(CHECKPOINT).parent)
    return folder.resolve()


def with_changes(tree: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a run's config with changed keys; an option of the group `record` sets the format."""
    changed = dict(tree)
    for key, value in changes.items():
        path = key
        if key == "record" and isinstance(value, str):
            path = "record.format"
        *parents, last = path.split(".")
        node = changed
        for parent in parents:
            node[parent] = dict(node.get(parent) or {})  # the tree's own maps do not change
            node = node[parent]
        node[last] = value
    return changed


@dataclass(frozen=True, slots=True)
class ResumedCollection:
    """A collection that is resumed.

    Attributes:
        resolved: Its config, with what was changed.
        folder: Its folder, to which episodes are added.
        num_successes: Episodes in it that succeeded.
    """

    resolved: Resolved
    folder: Path
    num_successes: int


def resolve_resumed_collection(overrides: Sequence[str]) -> ResumedCollection:
    """Return the collection that is resumed.

    Args:
        overrides: As typed: ``resume=FOLDER`` (or ``last``) and keys that may change.

    Raises:
        ConfigError: There is no such collection, or a key may not change.
    """
    from embodichain.config.rerun import read_config, task_of
    from embodichain.config.resolved import resolve_tree
    from embodichain.config.run_folder import CONFIG, newest_run
    from embodichain.recording.demos.collection import SUCCESSES, read_collection

    changes = parse_changes(overrides, (*COLLECTION_KEYS, "trust"), "a resumed collection")
    name = str(changes.pop("resume"))
    newest = newest_run(changes.get("output_dir", "outputs"), SUCCESSES)
    folder = find_resumed_folder(name, newest, "collection")
    num_successes = len(read_collection(folder))
    root_values = {
        "quiet": False,
        "json": False,
        "traceback": False,
        "resume": str(folder),
        "trust": False,  # a folder does not decide which code this machine runs
    }
    tree = with_changes({**read_config(folder / CONFIG), **root_values}, changes)
    source = str(folder / CONFIG)
    resolved = resolve_tree(tree, source, "collect", task_name=task_of(folder), allow_import=True)
    resolved = dataclasses.replace(resolved, overrides=tuple(overrides))
    return ResumedCollection(resolved, folder, num_successes)


def resolve_resumed_training(overrides: Sequence[str]) -> Resolved:
    """Return the config of a training that is resumed.

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

    changes = parse_changes(overrides, TRAINING_KEYS, "a resumed training")
    name = str(changes.pop("resume"))
    newest = newest_run(changes.get("output_dir", "outputs"), "checkpoints/*.zip")
    folder = find_resumed_folder(name, newest, "training")
    checkpoint, state = find_resumable(folder)
    root_values = {
        "quiet": False,
        "json": False,
        "traceback": False,
        "allow_changed": False,
        "trust": False,
        "resume": str(folder),
    }
    tree = with_changes({**read_config(folder / CONFIG), **root_values}, changes)
    task = str(read_note(checkpoint).get("task", "task"))
    source = str(folder / CONFIG)
    resolved = resolve_tree(tree, source, "train", task_name=task, allow_import=True)
    check_training(resolved)
    check_unfinished(checkpoint, state["env_steps"], resolved.root.total_timesteps or 0)
    return dataclasses.replace(resolved, overrides=tuple(overrides))
