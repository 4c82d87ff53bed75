"""`Locator`: finds where a key was set, a line of a YAML file or the command line.

The lines come from the marks that YAML's parser adds to keys.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from os.path import commonprefix
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import yaml
from hydra.core.override_parser.types import Override

from embodichain.config.composition.yaml_words import (
    Misread,
    compose_nodes,
    misread,
    node_kind,
    scalar_text,
)
from embodichain.utils.errors import Problem

__all__ = [
    "COMMAND_LINE",
    "ConfigFile",
    "KeyPlace",
    "Locator",
    "TooDeepError",
    "depth_of",
    "display_path",
]

COMMAND_LINE = "command line"
"""The source of a key that no file sets."""
_MERGE = "tag:yaml.org,2002:merge"


class KeyPlace(NamedTuple):
    """Where a key is in a file.

    Attributes:
        line: Its line, from 1.
        kind: Whether its value is a ``map``, a ``list``, ``null`` or another ``scalar``.
        text: A flag, number or interpolation as written, else empty.
    """

    line: int
    kind: str
    text: str = ""


@dataclass(frozen=True)
class ConfigFile:
    """A composed file.

    Attributes:
        path: The file, with links resolved.
        package: The key under which its content is placed; empty for the root.
        keys: Dotted key path, from the root of the config -> its place. Names are as written.
        misread: Keys and numbers that YAML 1.1 does not read as written.
    """

    path: Path
    package: str
    keys: dict[str, KeyPlace]
    misread: tuple[Misread, ...] = ()

    @classmethod
    def read(cls, path: Path, package: str) -> ConfigFile:
        """Read a file.

        Raises:
            yaml.YAMLError: The file is malformed, or has a tag (``!!python/...``, ``!!set``).
            TooDeepError: It nests too deeply, or contains itself by an alias.
        """
        try:
            return cls._read(path, package)
        except RecursionError as error:
            raise TooDeepError(path) from error

    @classmethod
    def _read(cls, path: Path, package: str) -> ConfigFile:
        with path.open(encoding="utf-8") as stream:  # error marks have a stream's name
            if "!" in stream.read():
                stream.seek(0)
                _refuse_tags(stream)
            stream.seek(0)
            return cls.of(path, package, compose_nodes(stream))

    @classmethod
    def of(cls, path: Path, package: str, root: yaml.Node | None) -> ConfigFile:
        """Take a file's keys from its nodes; None is an empty file."""
        keys: dict[str, KeyPlace] = {}
        if root is not None:
            names = package.split(".") if package else []
            for depth in range(bool(names), len(names) + 1):
                keys[".".join(names[:depth])] = KeyPlace(root.start_mark.line + 1, "map")
            keys.update(_keys_below(root, f"{package}." if package else ""))
        return cls(path.resolve(), package, keys, tuple(misread(root, package)))

    def problems(self) -> list[Problem]:
        """Return a problem for each key and number that YAML 1.1 does not read as written."""
        name = display_path(self.path)
        return [
            Problem(m.path, m.message, source=f"{name}:{m.line}")
            for m in self.misread
            if m.is_refused
        ]

    def find(self, parts: Sequence[str]) -> tuple[int, int]:
        """Return how many parts of a path are set here, and the line of the last (0 for none).

        A name may contain dots. A key below a scalar was set elsewhere.
        """
        for depth in range(len(parts), -1, -1):
            place = self.keys.get(".".join(parts[:depth]))
            if place is None:
                continue
            is_leaf = place.kind in ("scalar", "null")
            if not is_leaf or depth == len(parts):
                return depth, place.line
        return 0, 0


def _keys_below(node: yaml.Node, prefix: str) -> Iterator[tuple[str, KeyPlace]]:
    """All keys of maps and indices of lists below a node; a map's own keys win over merged ones."""
    entries: dict[str, tuple[yaml.Node, yaml.Node]] = {}
    if isinstance(node, yaml.SequenceNode):
        entries = {str(i): (item, item) for i, item in enumerate(node.value)}
    elif isinstance(node, yaml.MappingNode):
        merged: list[yaml.Node] = []
        for key, value in node.value:
            if key.tag != _MERGE:
                entries[str(key.value)] = (key, value)
            elif isinstance(value, yaml.SequenceNode):
                merged += value.value
            else:
                merged.append(value)
        for part in merged:
            if isinstance(part, yaml.MappingNode):
                entries = {str(k.value): (k, v) for k, v in part.value} | entries
    for name, (key, value) in entries.items():
        text = scalar_text(value)
        if isinstance(value, yaml.ScalarNode) and "${" in value.value:  # an interpolation
            text = str(value.value)
        place = KeyPlace(key.start_mark.line + 1, node_kind(value), text)
        yield f"{prefix}{name}", place
        yield from _keys_below(value, f"{prefix}{name}.")


def _refuse_tags(stream: TextIO) -> None:
    for event in yaml.parse(stream, Loader=yaml.CSafeLoader):
        tag = getattr(event, "tag", None)
        if tag is not None:
            mark: Any = event.start_mark  # libyaml's class, with the same members
            raise yaml.MarkedYAMLError(
                problem=f"tags are not used here, found {tag}", problem_mark=mark
            )


def depth_of(path: Path) -> int:
    """Return the largest depth of nested maps and lists of a file.

    Raises:
        yaml.YAMLError: It is malformed.
    """
    depth = 0
    deepest = 0
    with path.open(encoding="utf-8") as stream:
        for event in yaml.parse(stream, Loader=yaml.CSafeLoader):
            if isinstance(event, yaml.CollectionStartEvent):
                depth += 1
                deepest = max(deepest, depth)
            elif isinstance(event, yaml.CollectionEndEvent):
                depth -= 1
    return deepest


def display_path(path: Path) -> str:
    """Return a path for messages: relative if it is below the working directory."""
    resolved = path.resolve()
    folder = Path.cwd().resolve()
    if resolved.is_relative_to(folder):
        return str(resolved.relative_to(folder))
    return str(resolved)


class TooDeepError(yaml.MarkedYAMLError):
    """A file nests too deeply, or contains itself by an alias."""

    def __init__(self, path: Path) -> None:
        mark = yaml.Mark(str(path), 0, 0, 0, None, 0)
        super().__init__(
            problem="nested too deeply, or an alias contains itself", problem_mark=mark
        )


@dataclass(frozen=True)
class Locator:
    """Finds the source of dotted key paths.

    Attributes:
        files: The composed files; if two set a key, the later wins.
        overrides: Value overrides, applied after all files.
        origins: Key path of what a variation has set -> where the variation has it.
    """

    files: Sequence[ConfigFile]
    overrides: Sequence[Override] = ()
    origins: Mapping[str, str] = field(default_factory=dict)

    def source(self, path: str) -> str:
        """Return ``FILE:LINE`` or ``command line`` of a key, or of its nearest ancestor.

        Args:
            path: Dotted, with list indices as numbers; a name may itself contain dots. Missing keys
                are located at the deepest ancestor that something sets.
        """
        parts = self._origin(path).split(".")
        best = -1.0
        place: tuple[Path, int] | None = None
        for file in self.files:
            depth, line = file.find(parts)
            if depth >= best and line:
                best = depth
                place = file.path, line
        for override in self.overrides:
            reached = _depth_of_override(override, parts)
            if reached == len(parts) - 0.5 and not any(
                file.keys.get(path, KeyPlace(0, "")).kind == "map" for file in self.files
            ):
                reached = len(parts)  # the override made a map of a value
            if reached > 0 and reached >= best:
                best = reached
                place = None
        if place is None:
            return COMMAND_LINE
        path_of_file, line = place
        return f"{display_path(path_of_file)}:{line}"

    def _origin(self, path: str) -> str:
        """The path at which files and overrides have a key that a variation has set."""
        parts = path.split(".")
        for depth in range(len(parts), 0, -1):
            origin = self.origins.get(".".join(parts[:depth]))
            if origin is not None:
                return ".".join([origin, *parts[depth:]])
        return path

    def sets(self, path: str) -> bool:
        """Whether a file sets exactly this key."""
        return any(path in file.keys for file in self.files)

    def written(self, path: str) -> str:
        """Return the flag, number or interpolation that sets exactly this key, as written.

        It is empty if the key is set in another way, or by nothing.
        """
        parts = path.split(".")
        text = ""
        for file in self.files:
            if path in file.keys:
                text = file.keys[path].text
        for override in self.overrides:
            if _depth_of_override(override, parts) < len(parts):
                continue
            if _parts_of_key(override) == parts:
                line = override.input_line or ""
                text = line.partition("=")[2]
            else:  # the value of a key above it has this one
                text = ""
        return text

    def misread(self, *, keys: bool = True) -> set[str]:
        """Return the paths at which YAML 1.1 does not read numbers, or keys, as written."""
        refused = [m for file in self.files for m in file.misread if m.is_refused]
        return {m.path for m in refused if keys or not m.name}

    def names(self) -> dict[str, str]:
        """Return the names that files write otherwise: the config's key path -> the name there."""
        return {m.read: m.name for file in self.files for m in file.misread if m.read}

    def gives(self, path: str) -> bool:
        """Whether a file or override sets this key, or one below it, to something but null."""
        parts = path.split(".")
        if any(path in file.keys and file.keys[path].kind != "null" for file in self.files):
            return True
        for override in self.overrides:
            depth = _depth_of_override(override, parts)
            if depth == len(parts) - 0.5:
                return True
            if depth == len(parts) and _value_below(override, parts) is not None:
                return True
        return False

    def rank(self, path: str) -> int:
        """Return the number of the last file or override that sets exactly this key; -1 is none.

        They are numbered in the order in which they are merged, files before overrides.
        """
        parts = path.split(".")
        sets_key = [path in file.keys for file in self.files]
        for override in self.overrides:
            sets_key.append(_depth_of_override(override, parts) == len(parts))
        return max((i for i, sets in enumerate(sets_key) if sets), default=-1)

    def chosen(self, path: str, package: str) -> bool:
        """Whether a file or override, other than the group option at `package`, sets this key."""
        parts = path.split(".")
        others = [file for file in self.files if file.package != package]
        return any(path in file.keys for file in others) or any(
            _depth_of_override(override, parts) == len(parts) for override in self.overrides
        )


def _parts_of_key(override: Override) -> list[str]:
    """The key of an override as a path; ``a[0]`` is ``a.0``."""
    return override.key_or_group.replace("[", ".").replace("]", "").split(".")


def _depth_of_override(override: Override, parts: Sequence[str]) -> float:
    """Number of parts of a path that an override sets; less a half if it sets a key below."""
    key = _parts_of_key(override)
    common = len(commonprefix([key, list(parts)]))
    if common < len(key):
        return max(0.0, common - 0.5)
    if override.is_delete():
        return len(parts)
    return len(key) + len(_walk(override, parts[len(key) :]))


def _value_below(override: Override, parts: list[str]) -> Any:
    """The value that an override gives a path; None for null and for a deletion."""
    if override.is_delete():
        return None
    depth = len(_parts_of_key(override))
    values = [override.value(), *_walk(override, parts[depth:])]
    return values[-1]


def _walk(override: Override, parts: Sequence[str]) -> list[Any]:
    """The values of an override's value along a path, as far as it has them."""
    value: Any = override.value()
    values: list[Any] = []
    for part in parts:
        if isinstance(value, dict) and part in value:
            value = value[part]
        elif isinstance(value, list) and part.isdigit() and int(part) < len(value):
            value = value[int(part)]
        else:
            break
        values.append(value)
    return values
