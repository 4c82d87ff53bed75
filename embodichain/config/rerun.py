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

from embodichain.config.checks.idle_keys import idle_keys
from embodichain.config.composition.composed import (
    ParsedOverrides,
    apply_values,
    compose_variations,
    parse,
    plain_values,
)
from embodichain.config.composition.environment import as_reader, for_omegaconf, not_taken
from embodichain.config.composition.given_last import keep_last_given
from embodichain.config.composition.hydra_loader import config_loader
from embodichain.config.composition.locate import COMMAND_LINE, Locator
from embodichain.config.composition.removed_entries import remove_null_entries
from embodichain.config.composition.variations import merge_variations
from embodichain.config.resolved import Resolved, resolve_tree
from embodichain.config.run_folder import CONFIG, SUMMARY
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["read_config", "resolve_run", "task_of"]

_FOLDER = re.compile(r"\d\d-\d\d-\d\d_(.+?)(_\d+)?")  # see `run_folder.claim`
_GROUPS = ("record", "viewer", "sim")
_VARIATION = "variation"
_VARIATIONS = "task.variations"


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
        overrides: ``key=value``, and options of the groups record, viewer, sim and variation.
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
        variation_lines = [line for line in parsed.for_hydra if _group_of(line) == _VARIATION]
        chosen_variations = compose_variations(variation_lines)
        options = [line for line in parsed.for_hydra if _group_of(line) in _GROUPS]
        chosen = loader.load_configuration("run", [*options, "~task"], RunMode.RUN)
        for line in options:
            group = line.partition("=")[0]
            tree[group] = OmegaConf.to_container(chosen[group], resolve=True)
    config = OmegaConf.create(for_omegaconf(tree, str(source)))
    if chosen_variations.entries:
        variations = OmegaConf.create(chosen_variations.entries)
        OmegaConf.update(config, "task.variations", variations, force_add=True)
    problems = apply_values(config, parsed.values)
    if problems:
        raise ConfigError(problems)
    locator = Locator(chosen_variations.files, parsed.values)
    changed, problems = plain_values(config, locator)
    if problems:
        raise ConfigError(
            problem
            if _is_typed(problem.path, parsed)
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

    def source_of(path: str) -> str:
        """Where a key was set: a variation or an override, else the run's config."""
        is_of_variation = any(_is_below(path, key) for key in (_VARIATIONS, *locator.origins))
        if is_of_variation or _is_typed(path, parsed):
            return locator.source(path)
        return str(source)

    merged = merge_variations(changed, source_of, is_of_run=True)
    if merged.problems:
        raise ConfigError(problem.at(source_of(problem.path)) for problem in merged.problems)
    locator = dataclasses.replace(locator, origins=merged.origins)
    try:
        resolved = resolve_tree(
            merged.tree, str(source), "run", task_name=task_of(folder), allow_import=True
        )
    except ConfigError as error:
        sources = [(problem, source_of(problem.path)) for problem in error.problems]
        raise ConfigError(
            problem if place == str(source) else dataclasses.replace(problem, source=place)
            for problem, place in sources
        ) from error
    return dataclasses.replace(
        resolved,
        overrides=tuple(overrides),
        notes=(
            *parsed.notes,
            *resolved.notes,
            *merged.notes,
            *idle_keys(resolved.root, parsed.values, "run"),
        ),
        varied=frozenset(merged.origins),
    )


def _is_typed(path: str, parsed: ParsedOverrides) -> bool:
    """Whether a key is that of an override, or below it."""
    return any(_is_below(path, override.key_or_group) for override in parsed.values)


def _is_below(path: str, key: str) -> bool:
    """Whether a key path is a key, or below it."""
    return path == key or path.startswith(f"{key}.")


def _group_of(line: str) -> str:
    """The group of which an override chooses an option, without its package."""
    return line.lstrip("+").partition("=")[0].partition("@")[0]


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
        group = _group_of(line.lstrip("~"))
        if group not in (*_GROUPS, _VARIATION) or line.startswith("~"):
            listed = ", ".join((*_GROUPS, _VARIATION))
            message = f"{line!r} does not change a run that was made; groups: {listed}"
            problems.append(Problem(group, message, source=COMMAND_LINE))
    return problems
