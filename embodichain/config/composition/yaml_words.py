"""Words and numbers that YAML 1.1 does not read as they are written: `on`, `012`, `1:30`.

Hydra reads YAML 1.1. There `on`, `off`, `yes` and `no` are flags, `012` is 10 in base 8, `1:30` is
90 in base 60, and ``1e3`` is a number. Flags and ``1e3`` stay what they are where a flag or a
number is expected; as keys, and as numbers in another base, they are refused. The key `on` of a
term's parameters is a relation (``cube: {on: table}``), and is read as it is written.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, NamedTuple, TextIO

import yaml
from yaml.constructor import SafeConstructor

__all__ = [
    "Misread",
    "compose_nodes",
    "load_plain",
    "misread",
    "node_kind",
    "quoting",
    "scalar_text",
]

_RELATION = "on"
"""A flag in YAML 1.1, and what stands on something in English."""
_NULL = "tag:yaml.org,2002:null"
_MERGE = "tag:yaml.org,2002:merge"
_TEXT = "tag:yaml.org,2002:str"
_SCALARS = {f"tag:yaml.org,2002:{kind}" for kind in ("bool", "int", "float", "null")}
_BASE_8 = re.compile(r"[-+]?0[0-7_]+")
_BASE_60 = re.compile(r"[-+]?[0-9][0-9_]*(:[0-5]?[0-9])+(\.[0-9_]*)?")


_FLOAT = re.compile(
    r"""^(?:
     [-+]?[0-9]+(?:_[0-9]+)*\.[0-9_]*(?:[eE][-+]?[0-9]+)?
    |[-+]?[0-9]+(?:_[0-9]+)*(?:[eE][-+]?[0-9]+)
    |\.[0-9]+(?:_[0-9]+)*(?:[eE][-+][0-9]+)?
    |[-+]?[0-9]+(?:_[0-9]+)*(?::[0-5]?[0-9])+\.[0-9_]*
    |[-+]?\.(?:inf|Inf|INF)
    |\.(?:nan|NaN|NAN))$""",
    re.VERBOSE,
)
"""What OmegaConf reads as a number with a fraction: YAML 1.1 has no ``1e3``."""
_TIMESTAMP = "tag:yaml.org,2002:timestamp"


class _Loader(yaml.CSafeLoader):
    """Reads scalars as Hydra does (``1e3`` is a number, a date is text), with libyaml's speed."""

    yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in resolvers if tag != _TIMESTAMP]
        for first, resolvers in yaml.CSafeLoader.yaml_implicit_resolvers.items()
    }

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Refuse a key that is there twice, as Hydra does."""
        names = [key.value for key, _ in node.value if key.tag == _TEXT]
        if len(set(names)) < len(names):
            raise yaml.MarkedYAMLError(problem="duplicate key", problem_mark=node.start_mark)
        return super().construct_mapping(node, deep=deep)


_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+0123456789."))


class Misread(NamedTuple):
    """A word or number that is not read as it is written.

    Attributes:
        path: Dotted key path; the last part of a key is as written.
        line: Its line, from 1.
        message: What it is read as, and what to write.
        name: For a key, its name as written; else empty.
        read: For a key, the key path that the config has instead; else empty.
        is_refused: Whether it is a mistake; else the key is taken as it is written.
    """

    path: str
    line: int
    message: str
    name: str = ""
    read: str = ""
    is_refused: bool = True


def compose_nodes(stream: str | TextIO) -> yaml.Node | None:
    """Return the nodes of a YAML text as Hydra reads it; None if it is empty.

    Raises:
        yaml.YAMLError: It is malformed.
    """
    return yaml.compose(stream, Loader=_Loader)


def load_plain(text: str) -> Any:
    """Return a YAML text as Hydra reads it, fifteen times as fast.

    Raises:
        yaml.YAMLError: It is malformed, or has a tab, which libyaml takes where Hydra does not.
    """
    if "\t" in text:
        raise yaml.YAMLError("a tab")
    return yaml.load(text, Loader=_Loader)


def scalar_text(node: yaml.Node) -> str:
    """Return a flag or a number as written; empty for anything else."""
    if isinstance(node, yaml.ScalarNode) and node.tag in _SCALARS - {_NULL}:
        return str(node.value)
    return ""


def node_kind(node: yaml.Node) -> str:
    """Return whether a node is a ``map``, a ``list``, ``null`` or another ``scalar``."""
    if isinstance(node, yaml.SequenceNode):
        return "list"
    if isinstance(node, yaml.ScalarNode):
        return "null" if node.tag == _NULL else "scalar"
    return "map"


def quoting(text: str) -> str:
    """Return what to write for a word that was meant as text, as a sentence."""
    node = compose_nodes(text)
    read = "" if node is None else _shown(_value(node))
    reason = f"YAML 1.1 reads {text} as {read}"
    if read == text:
        reason = f"{text} is not text in YAML"
    return f"{reason}: for the text write '{text}', with the quotes."


def misread(root: yaml.Node | None, package: str = "") -> Iterator[Misread]:
    """Yield the keys of a file that are not read as written, and numbers in base 8 and 60.

    Args:
        root: The file's root.
        package: The key under which its content is placed; empty for the root.
    """
    if root is not None:
        yield from _misread_below(root, f"{package}." if package else "", set())


def _misread_below(node: yaml.Node, prefix: str, seen: set[int]) -> Iterator[Misread]:
    if id(node) in seen:  # an alias of a node that was visited
        return
    seen.add(id(node))
    if isinstance(node, yaml.SequenceNode):
        for i, item in enumerate(node.value):
            yield from _misread_below(item, f"{prefix}{i}.", seen)
    elif isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if key.tag == _MERGE:
                continue
            yield from _misread_key(key, prefix)
            yield from _misread_below(value, f"{prefix}{key.value}.", seen)
    elif node.tag in _SCALARS:
        yield from _misread_number(node, prefix.rstrip("."))


def _misread_key(key: yaml.Node, prefix: str) -> Iterator[Misread]:
    if key.tag not in _SCALARS:
        return
    text = str(key.value)
    value = _value(key)
    if str(value) == text and not isinstance(value, bool):
        return
    if not text:
        message = "a key is missing before the colon"
    else:
        message = (
            f"YAML 1.1 reads the key {text} as {_shown(value)}: write '{text}', with the quotes"
        )
    yield Misread(
        path=f"{prefix}{text}",
        line=key.start_mark.line + 1,
        message=message,
        name=text,
        read=f"{prefix}{value}",
        is_refused=text != _RELATION or ".params." not in f".{prefix}",
    )


def _misread_number(node: yaml.Node, path: str) -> Iterator[Misread]:
    text = str(node.value)
    if _BASE_8.fullmatch(text):
        base = 8
    elif _BASE_60.fullmatch(text):
        base = 60
    else:
        return
    number = _shown(_value(node))
    message = (
        f"YAML 1.1 reads {text} as {number}, in base {base}: write {number} for the number, "
        f"'{text}' with the quotes for the text"
    )
    yield Misread(path, node.start_mark.line + 1, message)


def _value(node: yaml.Node) -> Any:
    """The value that YAML 1.1 reads."""
    return SafeConstructor().construct_object(node)


def _shown(value: Any) -> str:
    """A value as it is written in YAML."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    return str(value)
