"""Mistakes in the `defaults:` of files, for which Hydra does not name the file: words, circles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import yaml

from embodichain.config.composition.locate import display_path
from embodichain.config.composition.yaml_words import compose_nodes, quoting, scalar_text
from embodichain.utils.errors import Problem

__all__ = ["chosen_twice", "explain_defaults"]


class _Entry(NamedTuple):
    """An entry of a `defaults:`: the file's name that it chooses, and its place."""

    name: str
    source: str
    written: str
    """The option as written, if YAML reads it as a flag or a number; else empty."""
    key: str = ""
    """The group as written: ``/scene@scene``, ``override /scene@scene``."""


def explain_defaults(folders: Sequence[Path], *, circles: bool) -> list[Problem]:
    """Return the mistakes in the `defaults:` of all files of some folders.

    Args:
        folders: Folders with groups, in the order in which they are searched.
        circles: Whether to look for circles, else for entries that are not read as text.
    """
    found: dict[str, list[_Entry]] = {}
    for folder in folders:
        for path in sorted(folder.rglob("*.yaml")):
            name = path.relative_to(folder).with_suffix("").as_posix()
            if name not in found:
                found[name] = list(_entries(path, name))
    if circles:
        return list(_circles(found))
    return [
        Problem("defaults", "expected a name.", quoting(entry.written), entry.source)
        for entries in found.values()
        for entry in entries
        if entry.written
    ]


def chosen_twice(folders: Sequence[Path], group: str, option: str) -> list[Problem]:
    """Return a problem for each file that chooses an option where another file has chosen one.

    Args:
        folders: Folders with groups, in the order in which they are searched; those of the first
            folder with such a file are returned.
        group: The group, with its package after ``@``.
        option: The option that Hydra refuses.
    """
    name = f"{group.partition('@')[0]}/{option}"
    for folder in folders:
        paths = [(p, p.relative_to(folder).with_suffix("")) for p in sorted(folder.rglob("*.yaml"))]
        entries = [e for path, own in paths for e in _entries(path, own.as_posix())]
        found = [e for e in entries if e.name == name and e.key and not e.key.startswith("over")]
        if found:
            message = "another file has chosen an option: write `override {}: {}`"
            return [
                Problem("defaults", message.format(e.key, option), source=e.source) for e in found
            ]
    return []


def _entries(path: Path, name: str) -> Iterator[_Entry]:
    try:
        root = compose_nodes(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError):
        return  # another file than the one that failed
    group = name.rpartition("/")[0]
    for key, value in root.value if isinstance(root, yaml.MappingNode) else ():
        if key.value != "defaults" or not isinstance(value, yaml.SequenceNode):
            continue
        for item in value.value:
            source = f"{display_path(path)}:{item.start_mark.line + 1}"
            if isinstance(item, yaml.ScalarNode) and item.value != "_self_":
                yield _Entry(_absolute(item.value, group), source, scalar_text(item))
            elif isinstance(item, yaml.MappingNode):
                for of, option in item.value:
                    chosen = option.value if isinstance(option, yaml.SequenceNode) else [option]
                    for one in chosen:
                        below = _absolute(str(of.value), group)
                        word = scalar_text(one)
                        yield _Entry(f"{below}/{one.value}", source, word, str(of.value))


def _absolute(name: str, group: str) -> str:
    """The name of a file from the root: ``/viewer@x`` is viewer, ``other`` of `group` group/other.

    Words before it (``override``, ``optional``) and a package after it are left out.
    """
    bare = name.split()[-1].partition("@")[0] if name.split() else name
    return bare.lstrip("/") if bare.startswith("/") or not group else f"{group}/{bare}"


def _circles(entries: Mapping[str, Sequence[_Entry]]) -> Iterator[Problem]:
    """A problem for each circle, at the entry that closes it."""
    done: set[str] = set()

    def walk(name: str, way: tuple[str, ...]) -> Iterator[Problem]:
        for entry in entries.get(name, ()):
            if entry.name in way:
                circle = [*way[way.index(entry.name) :], entry.name]
                message = f"a circle of files that take each other in: {' -> '.join(circle)}"
                yield Problem("defaults", message, source=entry.source)
            elif entry.name not in done:
                yield from walk(entry.name, (*way, entry.name))
        done.add(name)

    for name in entries:
        if name not in done:
            yield from walk(name, (name,))
