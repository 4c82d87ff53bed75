"""`train resume=RUN`: the config of a training that goes on, from the run's own `config.yaml`.

It is the same experiment, so only few keys may change. The run goes on in a folder of its own: what
was written before stays as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved

__all__ = ["resolve_resumed"]

MAY_CHANGE = (
    *("total_timesteps", "checkpoint", "eval", "record", "video", "sim", "output_dir"),
    *("wandb", "allow_changed", "quiet", "json", "traceback"),
)
"""Keys (and what is below them) that may differ from the run's own."""


def resolve_resumed(overrides: Sequence[str]) -> Resolved:
    """Return the config of a training that goes on.

    Args:
        overrides: As typed: ``resume=RUN`` (or ``last``) and what may change.

    Raises:
        ConfigError: There is no such run, none of its checkpoints can be resumed, or something
            else is asked to change.
    """
    import dataclasses

    from embodichain.config.rerun import read_config
    from embodichain.config.resolved import resolve_tree
    from embodichain.config.run_folder import CONFIG
    from embodichain.learning.checkpoint import read_note
    from embodichain.learning.keeper import find_resumable
    from embodichain.learning.train import check_training

    changes = _parsed(overrides)
    folder = _folder(changes.pop("resume"), changes.get("output_dir", "outputs"))
    problems = [
        Problem(key, f"a training goes on as it was; what may change: {', '.join(MAY_CHANGE)}")
        for key in changes
        if key.partition(".")[0] not in MAY_CHANGE
    ]
    if problems:
        raise ConfigError(problems)
    checkpoint, state = find_resumable(folder)
    fresh: dict[str, Any] = {"quiet": False, "json": False, "traceback": False}
    fresh |= {"allow_changed": False, "resume": str(folder)}
    tree = {**read_config(folder / CONFIG), **fresh}
    for key, value in changes.items():
        # An option of the group `record` is its format: the rest of the run's own stays.
        _put(tree, "record.format" if key == "record" and isinstance(value, str) else key, value)
    found = resolve_tree(
        tree,
        str(folder / CONFIG),
        "train",
        task_name=str(read_note(checkpoint).get("task", "task")),
        allow_import=True,
    )
    check_training(found)
    done, wanted = state["env_steps"], found.root.total_timesteps or 0
    if done >= wanted:
        message = f"{checkpoint} has {done} steps already: give more, total_timesteps=N"
        raise ConfigError([Problem("total_timesteps", message)])
    return dataclasses.replace(found, overrides=tuple(overrides))


def _parsed(overrides: Sequence[str]) -> dict[str, Any]:
    """Key and value of each override, in Hydra's grammar."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import OverrideParseException

    try:
        parsed = OverridesParser.create().parse_overrides(list(overrides))
    except OverrideParseException as error:
        raise ConfigError(str(error)) from error
    wrong = [o.input_line or "" for o in parsed if o.is_delete() or o.is_sweep_override()]
    if wrong:
        raise ConfigError([Problem("resume", f"takes no {line!r} beside it") for line in wrong])
    return {o.key_or_group: o.value() for o in parsed}


def _folder(name: Any, output_dir: Any) -> Path:
    """The run's folder; ``last`` is the newest training that has a checkpoint."""
    from embodichain.config.run_folder import CONFIG, newest_run

    if name == "last":
        found = newest_run(str(output_dir), "checkpoints/*.zip")
        if found is None:
            message = f"there is no training in {output_dir} yet: embodichain train task=NAME"
            raise ConfigError([Problem("resume", message)])
        return found
    folder = Path(str(name))
    if not (folder / CONFIG).is_file():
        message = f"{str(name)!r} is no training's folder: it holds no {CONFIG}"
        raise ConfigError([Problem("resume", message)])
    return folder.resolve()


def _put(tree: dict[str, Any], key: str, value: Any) -> None:
    *parents, last = key.split(".")
    for parent in parents:
        tree = tree.setdefault(parent, {})
    tree[last] = value
