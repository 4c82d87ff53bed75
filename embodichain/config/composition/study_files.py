"""Composes a study: its file of the group `study`, the files that it extends, and overrides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from hydra.types import RunMode
from omegaconf import OmegaConf

from embodichain.config.composition.composed import (
    apply_values,
    parse,
    plain_values,
    search_path,
)
from embodichain.config.composition.hydra_loader import (
    COMPOSING,
    config_loader,
    explain,
    folder_of_source,
    register_resolvers,
    searched,
)
from embodichain.config.composition.locate import COMMAND_LINE, ConfigFile, Locator
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["STUDY_GROUP", "SUITE_GROUP", "ComposedStudy", "compose_study", "tasks_of_suite"]

STUDY_GROUP = "study"
SUITE_GROUP = "suite"
_PLACE = f"{STUDY_GROUP}@_global_"


@dataclass(frozen=True)
class ComposedStudy:
    """A composed study, not yet checked.

    Attributes:
        name: The option of the group `study`.
        overrides: As typed.
        tree: Plain dicts and lists.
        locator: Finds where each key was set.
        problems: The mistakes found so far.
    """

    name: str
    overrides: tuple[str, ...]
    tree: dict[str, Any]
    locator: Locator
    problems: tuple[Problem, ...]


def compose_study(name: str, overrides: Sequence[str] = ()) -> ComposedStudy:
    """Compose a study with overrides in Hydra's grammar.

    Args:
        name: An option of the group `study`.
        overrides: E.g. ``["seeds=[0,1]", "~arms.sac"]``. Those of Hydra's own keys are left out.

    Raises:
        ConfigError: There is no such study, or its files cannot be composed.
    """
    lines = tuple(overrides)
    places, mistakes = search_path(lines)
    register_resolvers()
    with searched(places), config_loader() as loader:
        options = loader.get_group_options(STUDY_GROUP)
        if name not in options:
            message = f"there is no study {name!r}; there are: {listing(options, name)}."
            raise ConfigError([Problem("", message, did_you_mean(name, options).strip())])
        parsed = parse(lines, loader)
        try:
            config = loader.load_configuration(STUDY_GROUP, [f"{_PLACE}={name}"], RunMode.RUN)
        except COMPOSING as error:
            raise ConfigError(explain(error, loader)) from error
        sources = config.hydra.runtime.config_sources
        folders = [folder_of_source(source.schema, source.path) for source in sources]
        files = _files_of(loader.merged, folders)
    OmegaConf.set_struct(config, False)
    del config["hydra"]
    problems = [*mistakes, *parsed.problems, *apply_values(config, parsed.values)]
    problems += [_refuse_option(line) for line in parsed.for_hydra if not _is_hydras(line)]
    locator = Locator(files, parsed.values)
    for file in files:
        problems += file.problems()
    tree, unresolved = plain_values(config, locator)
    problems += unresolved
    return ComposedStudy(name, lines, _without_null_entries(tree), locator, tuple(problems))


def tasks_of_suite(name: str) -> list[str]:
    """Return the tasks of a file of the group `suite`.

    Raises:
        ConfigError: There is no such suite, or it has no list of tasks.
    """
    with config_loader() as loader:
        options = loader.get_group_options(SUITE_GROUP)
        if name not in options:
            message = f"there is no suite {name!r}; there are: {listing(options, name)}."
            raise ConfigError([Problem("suite", message, did_you_mean(name, options).strip())])
        loaded = loader.repository.load_config(f"{SUITE_GROUP}/{name}")
    tree = OmegaConf.to_container(loaded.config) if loaded is not None else None
    tasks = tree.get("tasks") if isinstance(tree, dict) else None
    if not isinstance(tasks, list) or not all(isinstance(task, str) for task in tasks):
        message = f"{SUITE_GROUP}/{name}.yaml must have a list `tasks` of names of tasks"
        raise ConfigError([Problem("suite", message)])
    return tasks


def _without_null_entries(tree: dict[str, Any]) -> dict[str, Any]:
    """Return a study without the arms and variations that are null: inherited and taken out."""
    remaining = dict(tree)
    if isinstance(remaining.get("arms"), dict):
        remaining["arms"] = _given(remaining["arms"])
    evaluate = remaining.get("evaluate")
    if isinstance(evaluate, dict) and isinstance(evaluate.get("variations"), dict):
        remaining["evaluate"] = {**evaluate, "variations": _given(evaluate["variations"])}
    return remaining


def _given(entries: dict[str, Any]) -> dict[str, Any]:
    return {name: entry for name, entry in entries.items() if entry is not None}


def _is_hydras(line: str) -> bool:
    return line.lstrip("+~").startswith(("hydra.", "hydra/"))


def _refuse_option(line: str) -> Problem:
    """The problem of a choice such as ``task=reach``, which is a key of jobs."""
    key = line.lstrip("+~").partition("=")[0].partition("@")[0]
    message = "not a key of a study."
    hint = "Add it to the overrides of all trainings (train=[...]) or of an arm."
    if key == "task":
        hint = f"Write tasks=[{line.partition('=')[2]}]."
    return Problem(key, message, hint, COMMAND_LINE)


def _files_of(merged: Sequence[Any], folders: Sequence[Path | None]) -> list[ConfigFile]:
    """The files of a study in the order of merging."""
    files: list[ConfigFile] = []
    for default in merged:
        name = default.config_path
        if name is None or name.startswith("hydra/") or name == STUDY_GROUP:
            continue
        paths = [folder / f"{name}.yaml" for folder in folders if folder is not None]
        path = next((path for path in paths if path.is_file()), None)
        if path is None:
            continue
        try:
            files.append(ConfigFile.read(path, default.package or ""))
        except yaml.YAMLError as error:
            raise ConfigError(f"{path}: {error}") from error
    return files
