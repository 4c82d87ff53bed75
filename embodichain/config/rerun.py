"""The config of an earlier run, changed by overrides, for playing a policy trained there.

It is read from the run's `config.yaml`, as the files that it was composed of may have changed.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from hydra.types import RunMode
from omegaconf import OmegaConf

from embodichain.config.composition.composed import (
    ParsedOverrides,
    apply_values,
    parse,
    plain_values,
)
from embodichain.config.composition.environment import as_reader, for_omegaconf, not_taken
from embodichain.config.composition.given_last import keep_last_given
from embodichain.config.composition.hydra_loader import config_loader
from embodichain.config.composition.locate import COMMAND_LINE, Locator
from embodichain.config.composition.removed_entries import remove_null_entries
from embodichain.config.resolved import Resolved, resolve_tree
from embodichain.config.run_folder import CONFIG, SUMMARY
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["read_config", "resolve_run", "task_of"]

_FOLDER = re.compile(r"\d\d-\d\d-\d\d_(.+?)(_\d+)?")  # see `run_folder.claim`
_GROUPS = ("record", "viewer", "sim")


def resolve_run(
    folder: Path,
    overrides: Sequence[str] = (),
    values: Mapping[str, Any] | None = None,
    *,
    only_reads: bool = False,
) -> Resolved:
    """Return a run's config as a config of the verb `run`.

    Args:
        folder: The run's folder.
        overrides: ``key=value``, and options of the groups record, viewer and sim.
        values: Keys of the root to set before the overrides.
        only_reads: Whether variables of the environment are not needed where no environment reads
            them; see `as_reader`.

    Raises:
        ConfigError: The folder has no config, or overrides or the config are wrong.
    """
    source = folder / CONFIG
    # Whoever made the folder has written its config: it does not say whom to trust.
    tree = {**read_config(source), "trust": False, **(values or {})}
    if only_reads:
        tree = as_reader(tree)
    warp = (tree.get("sim") or {}).get("warp")
    if isinstance(warp, dict):  # the run's choice was for what that run needed
        tree["sim"] = {**tree["sim"], "warp": {**warp, "arrays": "auto"}}
    with config_loader() as loader:
        parsed = parse(overrides, loader)
        problems = [*parsed.problems, *_unfit(parsed)]
        if problems:
            raise ConfigError(problems)
        options = [line for line in parsed.for_hydra if not line.startswith("~")]
        chosen = loader.load_configuration("run", [*options, "~task"], RunMode.RUN)
        for line in options:
            group = line.partition("=")[0]
            tree[group] = OmegaConf.to_container(chosen[group], resolve=True)
    config = OmegaConf.create(for_omegaconf(tree, str(source)))
    problems = apply_values(config, parsed.values)
    if problems:
        raise ConfigError(problems)
    locator = Locator((), parsed.values)
    changed, problems = plain_values(config, locator)
    if problems:
        raise ConfigError(
            problem
            if _is_typed(problem, parsed)
            else not_taken(
                problem.path,
                _value(tree, problem.path),
                reason=problem.message,
                source=str(source),
            )
            for problem in problems
        )
    changed, problems = remove_null_entries(changed, lambda path: _gives(tree, path))
    problems += keep_last_given(changed, locator.rank)
    if problems:
        raise ConfigError(problem.at(COMMAND_LINE) for problem in problems)
    try:
        resolved = resolve_tree(
            changed, str(source), "run", task_name=task_of(folder), allow_import=True
        )
    except ConfigError as error:
        raise ConfigError(
            dataclasses.replace(problem, source=COMMAND_LINE)
            if _is_typed(problem, parsed)
            else problem
            for problem in error.problems
        ) from error
    return dataclasses.replace(resolved, overrides=tuple(overrides))


def _is_typed(problem: Problem, parsed: ParsedOverrides) -> bool:
    """Whether a mistake is at the key of an override, or below it."""
    for override in parsed.values:
        key = override.key_or_group
        if problem.path == key or problem.path.startswith(f"{key}."):
            return True
    return False


def _gives(tree: Any, path: str) -> bool:
    """Whether a config sets a key path to something but null."""
    return _value(tree, path) is not None


def _value(tree: Any, path: str) -> Any:
    """The value of a config at a key path; None if there is none."""
    for part in path.split("."):
        if isinstance(tree, list) and part.isdecimal() and int(part) < len(tree):
            tree = tree[int(part)]
        else:
            tree = tree.get(part) if isinstance(tree, dict) else None
    return tree


def task_of(folder: Path) -> str:
    """Return the name of a run's task, from its summary, else from the name of its folder."""
    try:
        task = json.loads((folder / SUMMARY).read_text(encoding="utf-8")).get("task")
    except (OSError, ValueError, AttributeError):
        task = None
    if isinstance(task, str):
        return task
    match = _FOLDER.fullmatch(folder.name)
    return match[1] if match is not None else "task"


def read_config(path: Path) -> dict[str, Any]:
    """Read a run's `config.yaml`.

    Raises:
        ConfigError: The file cannot be read, or is not a map.
    """
    try:
        tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"cannot read {path}: {error}") from error
    if not isinstance(tree, dict):
        raise ConfigError(f"{path} has no config")
    return tree


def _unfit(parsed: ParsedOverrides) -> list[Problem]:
    """A problem for each override that is not allowed for an earlier run."""
    problems = []
    for line in parsed.for_hydra:
        group = line.lstrip("+~").partition("=")[0]
        if group not in _GROUPS or line.startswith("~"):
            message = f"{line!r} does not change a run that was made; groups: {', '.join(_GROUPS)}"
            problems.append(Problem(group, message, source=COMMAND_LINE))
    return problems
