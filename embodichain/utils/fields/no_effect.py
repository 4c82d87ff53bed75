"""`NoEffect`: marks fields of a config that are accepted and change nothing.

`config_nodes` visits a config beside the values it was read from, whose keys are those given.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, get_args, get_type_hints

from embodichain.utils.fields.defaults import is_given

__all__ = [
    "NO_EFFECT",
    "NoEffect",
    "changed_without_effect",
    "config_nodes",
    "no_effect_fields",
]


@dataclass(frozen=True)
class NoEffect:
    """Metadata of an annotation: the field changes nothing.

    Attributes:
        why: The reason, for messages; may be empty.
    """

    why: str = ""

    @property
    def message(self) -> str:
        """What a user is told."""
        return f"has no effect: {self.why}" if self.why else "has no effect"


NO_EFFECT = NoEffect()


def no_effect_fields(cfg: Any) -> Mapping[str, NoEffect]:
    """Return the fields of a config that change nothing, by name."""
    kind: Any = type(cfg)
    return _marked(kind)


@cache
def _marked(cls: Any) -> Mapping[str, NoEffect]:
    hints = get_type_hints(cls, include_extras=True)
    marks = {
        name: [m for m in get_args(hint) if isinstance(m, NoEffect)] for name, hint in hints.items()
    }
    return {name: found[0] for name, found in marks.items() if found}


def changed_without_effect(cfg: Any) -> list[tuple[str, NoEffect]]:
    """Return the fields of a config made in Python that differ from the default and change nothing.

    Such a config cannot say whether a value that equals its default was given; that one changes
    nothing either way.
    """
    usual = type(cfg)()
    return [
        (name, mark)
        for name, mark in no_effect_fields(cfg).items()
        if is_given(getattr(cfg, name))
        and (not is_given(getattr(usual, name)) or getattr(cfg, name) != getattr(usual, name))
    ]


def config_nodes(
    value: Any, tree: Any, path: str = ""
) -> Iterator[tuple[str, Any, Mapping[str, Any]]]:
    """Yield each config in a config, with its key path and the plain values it was read from.

    Args:
        value: A config, or a map or list of configs.
        tree: What it was read from: its keys are those that were given.
        path: Its key path.
    """
    below = f"{path}." if path else ""
    if dataclasses.is_dataclass(value) and isinstance(tree, Mapping):
        yield path, value, tree
        for key, given in tree.items():
            yield from config_nodes(getattr(value, str(key), None), given, f"{below}{key}")
    elif isinstance(value, Mapping) and isinstance(tree, Mapping):
        for key, given in tree.items():
            yield from config_nodes(value.get(key), given, f"{below}{key}")
    elif isinstance(value, Sequence) and isinstance(tree, Sequence) and not isinstance(value, str):
        for number, (item, given) in enumerate(zip(value, tree, strict=False)):
            yield from config_nodes(item, given, f"{below}{number}")
