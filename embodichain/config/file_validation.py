"""Checking one file where it lies: a task, another group's option, a dumped or a gym config."""

from __future__ import annotations

import tempfile
from pathlib import Path

import yaml

from embodichain.config.composed import compose
from embodichain.config.derive import Verb
from embodichain.config.gym_config import load_gym_config, override_of
from embodichain.config.hydra_errors import explain_yaml
from embodichain.config.locate import ConfigFile, Locator, display_path
from embodichain.config.problems import LocatedProblem
from embodichain.config.validation import check_tree, validate
from embodichain.lab.gym.gym_config.file import is_gym_config, read_gym_config
from embodichain.utils.errors import ConfigError

__all__ = ["notes_on_file", "validate_file"]

_GROUPS = ("task", "sim", "record", "viewer", "algo", "experiment")
_ANY_TASK = "task=random_reach"


def validate_file(path: str | Path, verb: Verb = "run") -> list[LocatedProblem]:
    """Return every mistake of a file; empty is good.

    A file with a map ``task`` in it is a whole config, as run folders hold; one with a map ``env``
    is EmbodiChain's gym config; one in a folder named like a group is an option of that group; any
    other is a task.

    Args:
        path: The file.
        verb: Whose suggested values count.
    """
    file = Path(path)
    if not file.is_file():
        return [LocatedProblem("", f"no such file: {path}")]
    if file.suffix == ".json":
        return validate(compose([override_of(str(file))], verb), verb)
    try:
        parsed = ConfigFile.read(file, "")
        tree = yaml.safe_load(file.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        return [explain_yaml(error, file)]
    except (OSError, UnicodeDecodeError) as error:
        return [LocatedProblem("", f"cannot be read: {error}", source=display_path(file))]
    if is_gym_config(tree):
        return validate(compose([override_of(str(file))], verb), verb)
    if isinstance(tree, dict) and isinstance(tree.get("task"), dict):
        source = Locator([parsed]).source
        found = check_tree(tree, verb)
        return [LocatedProblem.of(p, source(p.path)) for p in found]
    return _validate_option(file.resolve(), verb)


def notes_on_file(path: str | Path) -> tuple[LocatedProblem, ...]:
    """Return what of a file is left out or read otherwise: of a gym config, or else nothing.

    Args:
        path: The file; one with mistakes has no notes.
    """
    try:
        return load_gym_config(path).notes if is_gym_config(read_gym_config(path)) else ()
    except ConfigError:
        return ()


def _validate_option(file: Path, verb: Verb) -> list[LocatedProblem]:
    group = file.parent.name
    if group in _GROUPS:
        return _composed(group, file.stem, file.parent.parent, verb)
    with tempfile.TemporaryDirectory() as folder:
        link = Path(folder, "task", file.name).with_suffix(".yaml")
        link.parent.mkdir()
        link.symlink_to(file)
        return _composed("task", file.stem, Path(folder), verb)


def _composed(group: str, name: str, folder: Path, verb: Verb) -> list[LocatedProblem]:
    lines = [f"{group}={name}"] if group == "task" else [_ANY_TASK, f"{group}={name}"]
    verb = "train" if group == "algo" else verb
    return validate(compose(lines, verb, folder), verb)
