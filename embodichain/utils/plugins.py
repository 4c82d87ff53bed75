"""What higher layers have for lower ones, which may not import them.

The package's root, `embodichain/__init__.py`, lists their modules here by name.
"""

from __future__ import annotations

import importlib
from typing import TypeVar

__all__ = ["MISSING_NAMES", "TERM_MODULES", "missing_class", "with_missing_members"]

Class = TypeVar("Class", bound=type)

TERM_MODULES: list[str] = []
"""Modules imported with the built-in terms; importing one registers its terms."""
MISSING_NAMES: list[str] = []
"""Modules that answer for names of other projects which are missing here: their `CLASSES` by name,
and `members_of(NAME)`, methods for a class of ours."""


def with_missing_members(cls: Class) -> Class:
    """Decorate a class with methods that say why they are missing; see `MISSING_NAMES`."""
    for module in MISSING_NAMES:
        members = importlib.import_module(module).members_of(cls.__name__)
        for name, member in members.items():
            setattr(cls, name, member)
    return cls


def missing_class(name: str) -> type | None:
    """Return the class that says why a class of this name is missing; None if there is none."""
    for module in MISSING_NAMES:
        classes: dict[str, type] = importlib.import_module(module).CLASSES
        if name in classes:
            return classes[name]
    return None
