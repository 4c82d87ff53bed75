"""EmbodiChain's gym config as a task: converted, every key with the file and line it came from.

What keys mean is `compat.gym_config`'s; here the result takes the place of an option of `task`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from embodichain.compat.gym_config.conversion import CLASSES, Conversion, convert
from embodichain.compat.gym_config.file import read_gym_config
from embodichain.config.locate import ConfigFile, LocatedProblem, Locator, display_path
from embodichain.utils.errors import ConfigError

__all__ = ["GymConfig", "load_gym_config", "override_of"]


@dataclass(frozen=True)
class GymConfig:
    """A converted gym config.

    Attributes:
        name: What the task is called: its `id`, or the file's stem if that is the generic one.
        task: The task, not checked.
        file: Its keys, each at the line of the gym config that it came from.
        notes: What was left out or is read otherwise.
        problems: What is wrong in it.
    """

    name: str
    task: dict[str, Any]
    file: ConfigFile
    notes: tuple[LocatedProblem, ...]
    problems: tuple[LocatedProblem, ...]


def load_gym_config(path: str | Path) -> GymConfig:
    """Read and convert a file.

    Args:
        path: YAML or JSON.

    Raises:
        ConfigError: It cannot be read; says why and where.
    """
    file = Path(path)
    content = read_gym_config(file)
    converted = convert(content, _registered(content.get("id")))
    root = _nodes(file)
    source = Locator(lambda: [ConfigFile(file, "", root)]).source if root is not None else None

    def located(problem: Any) -> LocatedProblem:
        place = source(problem.path) if source is not None else display_path(file)
        return LocatedProblem.of(problem, place)

    return GymConfig(
        converted.name or file.stem,
        converted.task,
        ConfigFile(file, "task", _placed(converted.task, (), converted, root)),
        tuple(sorted(map(located, converted.notes), key=_line)),
        tuple(sorted(map(located, converted.problems), key=_line)),
    )


def override_of(path: str) -> str:
    """Return the override that means ``--gym-config PATH``, quoted for Hydra's grammar."""
    quoted = path.replace("\\", "\\\\").replace("'", "\\'")
    return f"gym_config='{quoted}'"


def _registered(env_id: Any) -> tuple[str, ...]:
    """The id, if it is one of EmbodiChain's that a package of the user's brings the class of."""
    if env_id not in CLASSES:
        return ()
    from embodichain.config.plugins import require_registered  # Gymnasium: only when needed

    return (env_id,) if require_registered(env_id) is None else ()


def _line(problem: LocatedProblem) -> int:
    line = problem.source.rpartition(":")[2]
    return int(line) if line.isdigit() else 0


def _nodes(file: Path) -> yaml.Node | None:
    """The file as YAML nodes, which know their lines; None where YAML cannot read the JSON."""
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".json":
        text = text.replace("\t", " ")  # JSON may be indented by them, YAML may not
    try:
        return yaml.compose(text, Loader=yaml.CSafeLoader)
    except yaml.YAMLError as error:
        if file.suffix != ".json":
            raise ConfigError(f"{file}: malformed YAML: {error}") from error
        return None


def _placed(
    value: Any, path: tuple[str, ...], converted: Conversion, root: yaml.Node | None
) -> yaml.Node:
    """A part of the task as nodes, each at the mark of where it came from."""
    mark = _mark(root, converted.origin(path))
    if isinstance(value, dict):
        entries = [
            (
                yaml.ScalarNode("", str(key), _mark(root, converted.origin((*path, str(key))))),
                _placed(item, (*path, str(key)), converted, root),
            )
            for key, item in value.items()
        ]
        return yaml.MappingNode("", entries, mark)
    if isinstance(value, list):
        parts = [_placed(item, (*path, str(i)), converted, root) for i, item in enumerate(value)]
        return yaml.SequenceNode("", parts, mark)
    return yaml.ScalarNode("", str(value), mark)


def _mark(root: yaml.Node | None, path: tuple[str, ...]) -> yaml.Mark:
    """The mark of a path's key, or of its nearest ancestor's; the file's beginning if unknown."""
    found = root.start_mark if root is not None else yaml.Mark("", 0, 0, 0, None, 0)
    node = root
    for part in path:
        if isinstance(node, yaml.SequenceNode) and part.isdigit() and int(part) < len(node.value):
            node = node.value[int(part)]
            found = node.start_mark
            continue
        pairs = node.value if isinstance(node, yaml.MappingNode) else []
        entry = next(((k, v) for k, v in reversed(pairs) if k.value == part), None)
        if entry is None:
            break
        found, node = entry[0].start_mark, entry[1]
    return found
