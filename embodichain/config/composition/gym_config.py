"""Converts EmbodiChain's gym config to a task; every key keeps the file and line it came from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from embodichain.compat.gym_config.conversion import CLASSES, Conversion, convert
from embodichain.compat.gym_config.file import read_gym_config
from embodichain.config.composition.locate import ConfigFile, KeyPlace, display_path
from embodichain.config.composition.yaml_words import compose_nodes
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["GymConfig", "load_gym_config", "override_of"]


@dataclass(frozen=True)
class GymConfig:
    """A converted gym config.

    Attributes:
        name: The task's name: the config's `id`, or the file's stem if the id is generic.
        task: The task, not checked.
        file: The task's keys, each with the line of the gym config that it came from.
        notes: What was left out or changed in the conversion.
        problems: The mistakes in the gym config.
    """

    name: str
    task: dict[str, Any]
    file: ConfigFile
    notes: tuple[Problem, ...]
    problems: tuple[Problem, ...]


def load_gym_config(path: str | Path) -> GymConfig:
    """Read and convert a file.

    Args:
        path: YAML or JSON.

    Raises:
        ConfigError: The file cannot be read; gives the reason and the line.
    """
    file = Path(path)
    content = read_gym_config(file)
    converted = convert(content, _registered(content.get("id")))
    source = ConfigFile.of(file, "", _nodes(file))

    def located(problem: Problem) -> Problem:
        _, line = source.find(problem.path.split("."))
        place = display_path(file)
        if line:
            place += f":{line}"
        return problem.at(place)

    def line_of(problem: Problem) -> int:
        line = problem.source.rpartition(":")[2]
        return int(line) if line.isdigit() else 0

    problems = [*map(located, converted.problems), *source.problems()]
    places = dict(_placed(converted.task, (), converted, source))
    return GymConfig(
        name=converted.name or file.stem,
        task=converted.task,
        file=ConfigFile(file, "task", places),
        notes=tuple(sorted(map(located, converted.notes), key=line_of)),
        problems=tuple(sorted(problems, key=line_of)),
    )


def override_of(path: str) -> str:
    """Return the override for ``--gym-config PATH``, quoted for Hydra's grammar."""
    quoted = path.replace("\\", "\\\\").replace("'", "\\'")
    return f"gym_config='{quoted}'"


def _registered(env_id: Any) -> tuple[str, ...]:
    """The id, if it is one of EmbodiChain's and an installed package registers its class."""
    if env_id not in CLASSES:
        return ()
    from embodichain.config.composition.plugins import (
        require_registered,  # Gymnasium: only when needed
    )

    if require_registered(env_id) is not None:
        return ()
    return (env_id,)


def _nodes(file: Path) -> yaml.Node | None:
    """The file as YAML nodes, which have line numbers; None if YAML cannot read the JSON."""
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".json":
        text = text.replace("\t", " ")  # JSON may be indented with tabs, YAML may not
    try:
        return compose_nodes(text)
    except yaml.YAMLError as error:
        if file.suffix != ".json":
            raise ConfigError(f"{file}: malformed YAML: {error}") from error
        return None


def _placed(
    value: Any, path: tuple[str, ...], converted: Conversion, source: ConfigFile
) -> Iterator[tuple[str, KeyPlace]]:
    """The keys of a part of the task, each with the line of the gym config that it came from."""
    items: Iterable[tuple[Any, Any]] = ()
    if isinstance(value, dict):
        kind = "map"
        items = value.items()
    elif isinstance(value, list):
        kind = "list"
        items = enumerate(value)
    else:
        kind = "scalar"
    _, line = source.find(converted.origin(path))
    yield ".".join(("task", *path)), KeyPlace(line or 1, kind)
    for key, item in items:
        yield from _placed(item, (*path, str(key)), converted, source)
