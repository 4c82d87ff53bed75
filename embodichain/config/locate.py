"""Who set a key, and mistakes with that place: a line of a YAML file, or the command line.

Works on the marks that YAML's parser leaves, over the files that were composed, in their order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from os.path import commonprefix
from pathlib import Path
from typing import Any, TextIO

import yaml
from hydra.core.override_parser.types import Override

from embodichain.utils.errors import Problem

__all__ = ["COMMAND_LINE", "ConfigFile", "LocatedProblem", "Locator", "display_path"]

_MERGE = "tag:yaml.org,2002:merge"


@dataclass(frozen=True)
class ConfigFile:
    """A composed file.

    Attributes:
        path: The file, not a link to it.
        package: The key that its content hangs under; empty for the root.
        root: Its YAML nodes, or None for an empty file.
    """

    path: Path
    package: str
    root: yaml.Node | None

    @classmethod
    def read(cls, path: Path, package: str) -> ConfigFile:
        """Read a file.

        Raises:
            yaml.YAMLError: It is malformed, or has a tag (``!!python/...``, ``!!set``).
        """
        with path.open(encoding="utf-8") as stream:  # a stream's name stands in error marks
            if "!" in stream.read():
                stream.seek(0)
                _refuse_tags(stream)
            stream.seek(0)
            return cls(path.resolve(), package, yaml.compose(stream, Loader=yaml.CSafeLoader))


def _refuse_tags(stream: TextIO) -> None:
    for event in yaml.parse(stream, Loader=yaml.CSafeLoader):
        tag = getattr(event, "tag", None)
        if tag is not None:
            mark: Any = event.start_mark  # libyaml's own class, of the same members
            raise yaml.MarkedYAMLError(
                problem=f"tags are not used here, found {tag}", problem_mark=mark
            )


def display_path(path: Path) -> str:
    """Return a path as people read it: relative where it lies below the working directory."""
    resolved = path.resolve()
    here = Path.cwd().resolve()
    return str(resolved.relative_to(here)) if resolved.is_relative_to(here) else str(resolved)


class Locator:
    """Finds the source of dotted key paths.

    Args:
        files: Reads the composed files when a place is first asked for; of two that set a key,
            the later wins.
        overrides: Value overrides, applied after all files.
    """

    def __init__(
        self, files: Callable[[], Sequence[ConfigFile]], overrides: Sequence[Override] = ()
    ) -> None:
        self._read = files
        self.overrides = tuple(overrides)

    @cached_property
    def files(self) -> tuple[ConfigFile, ...]:
        """The composed files."""
        return tuple(self._read())

    def source(self, path: str) -> str:
        """Return ``FILE:LINE`` or ``command line`` of a key, or of its nearest ancestor.

        Args:
            path: Dotted, with list indices as numbers; a name may itself contain dots. Missing keys
                are located at the deepest ancestor that something sets.
        """
        parts = path.split(".")
        best, source = -1.0, ""
        for file in self.files:
            known, line = _find(file, parts)
            if known >= best and line:
                best, source = known, f"{display_path(file.path)}:{line}"
        for override in self.overrides:
            depth = _depth_of_override(override, parts)
            if depth == len(parts) - 0.5 and not self._is_map(parts):
                depth = len(parts)  # the override made a map of a value
            if depth > 0 and depth >= best:
                best, source = depth, COMMAND_LINE
        return source or COMMAND_LINE

    def _is_map(self, parts: Sequence[str]) -> bool:
        return any(isinstance(_node(file, parts), yaml.MappingNode) for file in self.files)

    def sets(self, path: str) -> bool:
        """Whether a file has this very key."""
        parts = path.split(".")
        return any(_find(file, parts)[0] == len(parts) for file in self.files)

    def chosen(self, path: str, package: str) -> bool:
        """Whether someone set this key besides the group option mounted at `package`."""
        parts = path.split(".")
        others = [file for file in self.files if file.package != package]
        return any(_find(file, parts)[0] == len(parts) for file in others) or any(
            _depth_of_override(override, parts) == len(parts) for override in self.overrides
        )


def _find(file: ConfigFile, parts: Sequence[str]) -> tuple[int, int]:
    """How many parts of a path a file knows, and the line of the deepest one (0 for none)."""
    package = file.package.split(".") if file.package else []
    common = package[: len(parts)]
    if file.root is None or parts[: len(common)] != common:
        return 0, 0
    depth, line = _descend(file.root, parts[len(package) :])
    return len(common) + depth, line


def _node(file: ConfigFile, parts: Sequence[str]) -> yaml.Node | None:
    """The node of a path of plain keys, or None."""
    package = file.package.split(".") if file.package else []
    if list(parts[: len(package)]) != package:
        return file.root if package[: len(parts)] == list(parts) else None
    node = file.root
    for part in parts[len(package) :]:
        entry = _entry(node, part) if isinstance(node, yaml.MappingNode) else None
        node = entry[1] if entry else None
    return node


def _descend(node: yaml.Node, parts: Sequence[str]) -> tuple[int, int]:
    line = node.start_mark.line + 1
    if not parts:
        return 0, line
    if isinstance(node, yaml.SequenceNode) and parts[0].isdigit():
        items = node.value
        if int(parts[0]) < len(items):
            depth, found = _descend(items[int(parts[0])], parts[1:])
            return depth + 1, found
    if isinstance(node, yaml.MappingNode):
        for count in range(len(parts), 0, -1):  # a name may contain dots: the longest match first
            entry = _entry(node, ".".join(parts[:count]))
            if entry is not None:
                key, value = entry
                if isinstance(value, yaml.ScalarNode) and parts[count:]:
                    return 0, line  # a value holds no keys: whoever made it a map is meant
                depth, found = _descend(value, parts[count:])
                at_key = key.start_mark.line + 1
                return depth + count, found if depth else at_key
    return 0, line


def _entry(node: yaml.MappingNode, name: str) -> tuple[yaml.Node, yaml.Node] | None:
    """The last entry of this name; else one of the maps that ``<<`` merges in."""
    merged: list[yaml.Node] = []
    for key, value in reversed(node.value):
        if key.tag == _MERGE:
            merged += value.value if isinstance(value, yaml.SequenceNode) else [value]
        elif key.value == name:
            return key, value
    for value in merged:
        found = _entry(value, name) if isinstance(value, yaml.MappingNode) else None
        if found is not None:
            return found
    return None


def _depth_of_override(override: Override, parts: Sequence[str]) -> float:
    """How many parts of a path an override sets; half a part less where it sets something below."""
    key = override.key_or_group.replace("[", ".").replace("]", "").split(".")
    common = len(commonprefix([key, list(parts)]))
    if common < len(key):
        return max(0.0, common - 0.5)
    if override.is_delete():
        return len(parts)
    value: Any = override.value()
    depth = len(key)
    for part in parts[depth:]:
        if isinstance(value, dict) and part in value:
            value = value[part]
        elif isinstance(value, list) and part.isdigit() and int(part) < len(value):
            value = value[int(part)]
        else:
            break
        depth += 1
    return depth


COMMAND_LINE = "command line"
"""The source of what no file says."""


@dataclass(frozen=True, slots=True)
class LocatedProblem(Problem):
    """A mistake whose place is known.

    Attributes:
        source: ``FILE:LINE``, ``FILE``, or ``command line``; empty where nobody wrote it.
    """

    source: str = ""

    @classmethod
    def of(cls, problem: Problem, source: str) -> LocatedProblem:
        """Give a problem its place; a hint begins a sentence of its own."""
        message = problem.message.rstrip()
        if problem.hint and not message.endswith((".", "?", "!")):
            message += "."
        return cls(problem.path, message, problem.hint.strip(), source)

    def as_dict(self) -> dict[str, str]:
        """Return the four texts by name, for JSON."""
        return {
            "path": self.path,
            "message": self.message,
            "hint": self.hint,
            "source": self.source,
        }

    def __str__(self) -> str:
        """Return ``source: path: message hint``."""
        text = Problem.__str__(self)
        return f"{self.source}: {text}" if self.source else text
