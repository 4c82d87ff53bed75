"""Checks of one file: a task, an option of another group, a dumped config, or a gym config."""

from __future__ import annotations

import tempfile
from pathlib import Path

import yaml

from embodichain.compat.gym_config.file import is_gym_config, read_gym_config
from embodichain.config.checks.validation import check_tree
from embodichain.config.composition.composed import Composed, compose, list_options
from embodichain.config.composition.gym_config import load_gym_config, override_of
from embodichain.config.composition.hydra_loader import explain_yaml, user_configs
from embodichain.config.composition.locate import ConfigFile, Locator, display_path
from embodichain.config.composition.study_files import STUDY_GROUP, SUITE_GROUP, tasks_of_suite
from embodichain.config.keys.schema import JobVerb
from embodichain.config.resolved import Checked, Resolved, check_config, compile_scene_of
from embodichain.config.study import check_jobs, resolve_study
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["checked_file", "is_of_study", "notes_on_file", "resolve_file", "validate_file"]

_GROUPS = ("task", "scene", "variation", "sim", "record", "viewer", "algo", "experiment")
_ANY_TASK = "task=random_reach"
_PLACES = {"embodiment": "_here_", "object": "objects.{option}"}
"""Group whose options have no place of their own -> where a task puts one."""


def validate_file(path: str | Path, verb: JobVerb = "run") -> list[Problem]:
    """Return every mistake of a file that can be found without building; empty if there is none.

    Args:
        path: See `resolve_file`.
        verb: The verb for which the task's suggestions are used.
    """
    try:
        if is_of_study(path):
            _check_study_file(Path(path))
        else:
            compile_scene_of(resolve_file(path, verb))
    except ConfigError as error:
        return list(error.problems)
    return []


def is_of_study(path: str | Path) -> bool:
    """Whether a file is a study or a suite, by its folder: it has tasks, and is not one."""
    return Path(path).resolve().parent.name in (STUDY_GROUP, SUITE_GROUP)


def _check_study_file(path: Path) -> None:
    """Check a study with every stage of its jobs, or the tasks of a suite.

    Raises:
        ConfigError: There is no such file, or it has mistakes.
    """
    if not path.is_file():
        raise ConfigError([Problem("", f"no such file: {path}")])
    group = path.resolve().parent
    with user_configs(group.parent):
        if group.name == STUDY_GROUP:
            check_jobs(resolve_study(path.stem))
            return
        known_tasks = list_options("task")
        for task in tasks_of_suite(path.stem):
            if task not in known_tasks:
                message = f"there is no task {task!r}; there are: {listing(known_tasks, task)}."
                hint = did_you_mean(task, known_tasks).strip()
                raise ConfigError([Problem("tasks", message, hint, display_path(path))])


def resolve_file(path: str | Path, verb: JobVerb = "run") -> Resolved:
    """Check a whole file and fill in defaults and derived values; see `checked_file`.

    Raises:
        ConfigError: Lists every mistake with its place.
    """
    return checked_file(path, verb).resolved()


def checked_file(path: str | Path, verb: JobVerb = "run") -> Checked:
    """Check a whole file.

    A file with a map ``task`` is a whole config, as in run folders; one with a map ``env`` is
    EmbodiChain's gym config; one in a folder with the name of a group is an option of that group;
    any other is a task.

    Args:
        path: The file.
        verb: The verb for which the task's suggestions are used.

    Raises:
        ConfigError: It cannot be read, or is not YAML.
    """
    file = Path(path)
    if not file.is_file():
        raise ConfigError([Problem("", f"no such file: {path}")])
    if file.suffix == ".json":
        return check_config(compose([override_of(str(file))], verb), verb)
    try:
        parsed = ConfigFile.read(file, "")
        tree = yaml.safe_load(file.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise ConfigError([explain_yaml(error, file)]) from error
    except (OSError, UnicodeDecodeError) as error:
        problem = Problem("", f"cannot be read: {error}", source=display_path(file))
        raise ConfigError([problem]) from error
    if is_gym_config(tree):
        return check_config(compose([override_of(str(file))], verb), verb)
    if isinstance(tree, dict) and isinstance(tree.get("task"), dict):
        if parsed.misread:
            raise ConfigError(parsed.problems())
        source = Locator([parsed]).source
        return Checked(check_tree(tree, source, verb), verb, "task", source)
    return check_config(_composed_option(file.resolve(), verb), _verb_of(file.resolve(), verb))


def notes_on_file(path: str | Path) -> tuple[Problem, ...]:
    """Return notes on parts of a gym config that were left out or changed in the conversion.

    Args:
        path: The file; there are no notes for other configs, or for a file with mistakes.
    """
    try:
        if is_gym_config(read_gym_config(path)):
            return load_gym_config(path).notes
    except ConfigError:
        pass  # the check of the file reports it
    return ()


def _composed_option(file: Path, verb: JobVerb) -> Composed:
    """Compose a file as an option of the group that its folder names, or as a task."""
    group = file.parent.name
    verb = _verb_of(file, verb)
    if group in _GROUPS:
        name = "scene@task.scene" if group == "scene" else group
        option = f"[{file.stem}]" if group == "variation" else file.stem
        overrides = [f"{name}={option}"]
        if group != "task":
            overrides.insert(0, _ANY_TASK)
        return compose(overrides, verb, file.parent.parent)
    with tempfile.TemporaryDirectory() as folder:
        task = Path(folder, "task", file.name).with_suffix(".yaml")
        task.parent.mkdir()
        if group in _PLACES:
            Path(folder, group).symlink_to(file.parent.resolve())
            place = _PLACES[group].format(option=file.stem)
            task.write_text(
                f"defaults:\n  - /{group}@{place}: {file.stem}\ndescription: {file.stem}\n"
            )
        else:
            task.symlink_to(file)
        return compose([f"task={file.stem}"], verb, folder)


def _verb_of(file: Path, verb: JobVerb) -> JobVerb:
    """``train`` for an algorithm, which only trainings have; else `verb`."""
    return "train" if file.parent.name == "algo" else verb
