"""Mistakes in the `defaults:` of files, for which Hydra does not name the file: words, circles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import yaml

from embodichain.config.composition.locate import ConfigFile, display_path
from embodichain.config.composition.yaml_words import compose_nodes, quoting, scalar_text
from embodichain.utils.errors import Problem

__all__ = [
    "chosen_twice",
    "explain_defaults",
    "explain_lists",
    "place_of_choice",
    "place_of_entry",
    "place_of_override",
]


class _Entry(NamedTuple):
    """An entry of a `defaults:`.

    Attributes:
        name: Name of the file that it chooses.
        source: Its place, ``FILE:LINE``.
        written: The option as written, if YAML reads it as a flag or a number; else empty.
        key: The group as written: ``/scene@scene``, ``override /scene@scene``.
        is_list: Whether it chooses a list of options.
    """

    name: str
    source: str
    written: str
    key: str = ""
    is_list: bool = False


def explain_defaults(folders: Sequence[Path], *, circles: bool) -> list[Problem]:
    """Return the mistakes in the `defaults:` of all files of some folders.

    Args:
        folders: Folders with groups, in the order in which they are searched.
        circles: Whether to look for circles, else for entries that are not read as text.
    """
    entries_of: dict[str, list[_Entry]] = {}
    for folder in folders:
        for path in sorted(folder.rglob("*.yaml")):
            name = _name_of(path, folder)
            if name not in entries_of:
                entries_of[name] = list(_entries(path, name))
    if circles:
        return list(_circles(entries_of))
    problems = []
    for entries in entries_of.values():
        for entry in entries:
            if entry.written:
                hint = quoting(entry.written)
                problems.append(Problem("defaults", "expected a name.", hint, entry.source))
    return problems


def explain_lists(folders: Sequence[Path]) -> list[Problem]:
    """Return a problem for each list of options that is chosen without ``override``.

    Hydra refuses it, without a word, where another file has chosen a list for the group.

    Args:
        folders: Folders with groups.
    """
    problems: dict[str, Problem] = {}
    for folder in folders:
        for path in sorted(folder.rglob("*.yaml")):
            for entry in _entries(path, _name_of(path, folder)):
                if entry.is_list and not entry.key.startswith("over"):
                    message = (
                        "another file has chosen a list of options: write "
                        f"`override {entry.key}: [...]`"
                    )
                    problems.setdefault(
                        entry.source, Problem("defaults", message, source=entry.source)
                    )
    return list(problems.values())


def chosen_twice(
    folders: Sequence[Path], group: str, option: str, names: Sequence[str]
) -> list[Problem]:
    """Return the problem that a composed file chooses an option where another one has chosen one.

    Args:
        folders: Folders with groups, in the order in which they are searched.
        group: The group, with its package after ``@``.
        option: The option that Hydra refuses.
        names: The files with which composing begins, as Hydra calls them: ``task/mine``.

    Returns:
        One problem, or none where no composed file has such an entry.
    """
    bare_group = group.partition("@")[0]
    choices = [
        entry
        for entry in _composed_entries(folders, names)
        if entry.name.rpartition("/")[0] == bare_group
        and entry.key
        and not entry.key.startswith("override")
    ]
    # A file comes before those that it names: the first one is refused.
    refused = next((entry for entry in choices if entry.name == f"{bare_group}/{option}"), None)
    if refused is None:
        return []
    earlier = [entry.source for entry in choices if entry.source != refused.source]
    place = earlier[-1] if earlier else "another file"
    message = f"{place} chooses an option already: write `override {refused.key}: {option}`"
    return [Problem("defaults", message, source=refused.source)]


def _composed_entries(folders: Sequence[Path], names: Sequence[str]) -> list[_Entry]:
    """The entries of files and of the files that they name; those of a file before the others'."""
    entries: list[_Entry] = []
    waiting = list(names)
    visited: set[str] = set()
    while waiting:
        name = waiting.pop(0)
        if name in visited:
            continue
        visited.add(name)
        path = _path_of(folders, name)
        if path is not None:
            of_file = list(_entries(path, name))
            entries += of_file
            waiting += [entry.name for entry in of_file]
    return entries


def _path_of(folders: Sequence[Path], name: str) -> Path | None:
    """The file that Hydra calls by a name, in the first folder that has it."""
    return next((p for folder in folders if (p := folder / f"{name}.yaml").is_file()), None)


def place_of_entry(folders: Sequence[Path], name: str, entry_name: str) -> str:
    """Return where the `defaults:` of a file names another file, ``FILE:LINE``; empty if nowhere.

    Args:
        folders: Folders with groups, in the order in which they are searched.
        name: The file, as Hydra calls it: ``embodiment/mine``.
        entry_name: The file that it names, likewise.
    """
    path = _path_of(folders, name)
    if path is None:
        return ""
    places = [entry.source for entry in _entries(path, name) if entry.name == entry_name]
    return places[0] if places else display_path(path)


def place_of_choice(files: Sequence[ConfigFile], group: str, option: str) -> str:
    """Return where files choose an option of a group, ``FILE:LINE``; empty if none does.

    Args:
        files: The composed files; the last one that chooses the option counts.
        group: The group, without a package.
        option: The option.
    """
    place = ""
    for file in files:
        # A root config is not in a group, and its entries have none before them.
        in_group = _entries(file.path, f"{file.path.parent.name}/{file.path.stem}")
        in_root = _entries(file.path, file.path.stem)
        for entry in (*in_group, *in_root):
            if entry.name == f"{group}/{option}" and entry.key:
                place = entry.source
    return place


def place_of_override(folders: Sequence[Path], name: str, choice: str) -> str:
    """Return where a file overrides a choice, ``FILE:LINE``; empty if there is no such file.

    Args:
        folders: Folders with groups, in the order in which they are searched.
        name: The file, as Hydra calls it: ``experiment/mine``.
        choice: The group with its package from the root: ``object@task.objects.mug``.
    """
    path = _path_of(folders, name)
    if path is None:
        return ""
    group, _, package = choice.partition("@")
    for entry in _entries(path, name):
        written_group, _, written_package = entry.key.partition("@")
        is_override = written_group.startswith("override ")
        is_group = written_group.split()[-1:] in ([f"/{group}"], [group])
        # A file's packages begin at its own: `objects.mug` in a task is `task.objects.mug`.
        if is_override and is_group and package.endswith(written_package.rpartition("_.")[2]):
            return entry.source
    return display_path(path)


def _name_of(path: Path, folder: Path) -> str:
    """The name of a file for Hydra: its path in a folder of groups, without the suffix."""
    return path.relative_to(folder).with_suffix("").as_posix()


def _entries(path: Path, name: str) -> Iterator[_Entry]:
    """The entries of the `defaults:` of a file with a name."""
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
                for group_node, node in item.value:
                    written_group = str(group_node.value)
                    chosen_group = _absolute(written_group, group)
                    options = node.value if isinstance(node, yaml.SequenceNode) else [node]
                    for option in options:
                        yield _Entry(
                            name=f"{chosen_group}/{option.value}",
                            source=source,
                            written=scalar_text(option),
                            key=written_group,
                            is_list=isinstance(node, yaml.SequenceNode),
                        )


def _absolute(name: str, group: str) -> str:
    """The name of a file from the root: ``/viewer@x`` is viewer, ``other`` of `group` group/other.

    Words before it (``override``, ``optional``) and a package after it are left out.
    """
    words = name.split()
    bare = words[-1].partition("@")[0] if words else name
    if bare.startswith("/") or not group:
        return bare.lstrip("/")
    return f"{group}/{bare}"


def _circles(entries: Mapping[str, Sequence[_Entry]]) -> Iterator[Problem]:
    """A problem for each circle, at the entry that closes it."""
    done: set[str] = set()

    def walk(name: str, including: tuple[str, ...]) -> Iterator[Problem]:
        for entry in entries.get(name, ()):
            if entry.name in including:
                circle = [*including[including.index(entry.name) :], entry.name]
                message = f"a circle of files that include each other: {' -> '.join(circle)}"
                yield Problem("defaults", message, source=entry.source)
            elif entry.name not in done:
                yield from walk(entry.name, (*including, entry.name))
        done.add(name)

    for name in entries:
        if name not in done:
            yield from walk(name, (name,))
