"""``resume=RUN``: the config of an earlier run, in which only few keys may change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from embodichain.cli.app import split_overrides
from embodichain.cli.jobs.job import job_options
from embodichain.cli.terminal.last import take_last
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["parsed_changes", "resumed_folder", "resumption", "with_changes"]

_ALWAYS = ("record", "sim", "output_dir", "allow_changed", "quiet", "json", "traceback")
"""Keys that may change in every resumption."""


def resumption(options: Any) -> list[str] | None:
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
    return [*split_overrides(words), *job_options(options)]


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

    found = newest if name == "last" else Path(name)
    if found is None:
        raise ConfigError([Problem("resume", f"there is no {what} to resume yet")])
    if not (found / CONFIG).is_file():
        message = f"{name!r} is no {what}'s folder: it has no {CONFIG}{perhaps_last(name)}"
        raise ConfigError([Problem("resume", message)])
    if name == "last":
        take_last(found)
    for folder in (found, found / Path(CHECKPOINT).parent):
        remove_abandoned(folder)
    return found.resolve()


def with_changes(tree: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a run's config with changed keys; an option of the group `record` sets the format."""
    found = dict(tree)
    for key, value in changes.items():
        path = "record.format" if key == "record" and isinstance(value, str) else key
        *parents, last = path.split(".")
        node = found
        for parent in parents:
            node[parent] = dict(node.get(parent) or {})
            node = node[parent]
        node[last] = value
    return found
