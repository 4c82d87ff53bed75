"""Names of other projects' functions that are not terms here, and what to write instead.

`register_translations` adds tables; `translation_of` answers an unknown name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

__all__ = ["register_translations", "translation_of"]

Tables = Callable[[], Mapping[str, Mapping[str, str]]]

_SOURCES: dict[str, Tables] = {}


def register_translations(tables: Tables) -> None:
    """Add a function that reads tables: project -> its name -> what to write here.

    It is called when a name is unknown. Classes are listed with the ending ``Cfg``, and are found
    without it, too.
    """
    _SOURCES[tables.__module__] = tables


def translation_of(name: str) -> str:
    """What to write for a name of another project, as sentences; empty if none has the name."""
    projects_of: dict[str, list[str]] = {}
    for tables in _SOURCES.values():
        for project, table in tables().items():
            text = table.get(name) or table.get(f"{name}Cfg")
            if text:
                projects_of.setdefault(text, []).append(project)
    return "".join(
        f" It is a name of {' and '.join(projects)}; here: {text}."
        for text, projects in projects_of.items()
    )
