"""Types of parameters in words, with the ranges that their annotations declare."""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, Any, Literal, Union, get_args, get_origin

__all__ = ["type_words"]

_WORDS: dict[Any, str] = {
    Any: "anything",
    bool: "true or false",
    float: "number",
    int: "integer",
    str: "text",
    type(None): "null",
    dict: "map",
    list: "list",
    tuple: "list",
}
_NAMED = {
    "NamedEntity": "entity",
    "ResolvedEntity": "entity",
    "SceneEntityCfg": "entity",
    "TermCfg": "term",
}
_LIMITS = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))


def type_words(hint: Any) -> str:
    """Return what a value of this type looks like in YAML.

    Args:
        hint: An evaluated annotation: ``Annotated[float, Field(gt=0)]`` gives ``number > 0``.
    """
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _annotated(arguments[0], list(_flat(arguments[1:])))
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(type_words(one) for one in arguments))
    if origin is Literal:
        return " or ".join(map(str, arguments))
    if origin is not None:
        return _container(origin, arguments, [])
    name = getattr(hint, "__name__", str(hint))
    if name in _NAMED:
        return _NAMED[name]
    if dataclasses.is_dataclass(hint):
        return f"map with {', '.join(field.name for field in dataclasses.fields(hint))}"
    return _WORDS.get(hint, name)


def _flat(metadata: Iterable[Any]) -> Iterator[Any]:
    """Constraints, those inside pydantic's `Field` too."""
    for item in metadata:
        inner = getattr(item, "metadata", None)
        if isinstance(inner, list):
            yield from inner
        else:
            yield item


def _annotated(hint: Any, metadata: list[Any]) -> str:
    if get_origin(hint) is Annotated:
        inner, *more = get_args(hint)
        return _annotated(inner, [*_flat(more), *metadata])
    origin = get_origin(hint)
    if origin is not None and origin not in (Union, types.UnionType, Literal):
        return _container(origin, get_args(hint), metadata)
    limits = [
        f"{sign} {getattr(item, name):g}"
        for item in metadata
        for name, sign in _LIMITS
        if getattr(item, name, None) is not None
    ]
    return " ".join([type_words(hint), " and ".join(limits)]).strip()


def _container(origin: Any, arguments: tuple[Any, ...], metadata: list[Any]) -> str:
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return f"map of {type_words(arguments[-1])}" if arguments else "map"
    if origin is tuple and arguments and arguments[-1] is not Ellipsis:
        same = len(set(map(str, arguments))) == 1
        words = type_words(arguments[0])
        return _several(len(arguments), words, False) if same else _listed(arguments)
    if not (isinstance(origin, type) and issubclass(origin, Iterable)):
        return str(getattr(origin, "__name__", origin))
    item = type_words(arguments[0]) if arguments else "anything"
    least = _length(metadata, "min_length")
    most = _length(metadata, "max_length")
    if least is not None and least == most:
        return _several(least, item, any(hasattr(m, "func") for m in metadata))
    return f"list of {item}" + (f", at least {least}" if least else "")


def _length(metadata: list[Any], name: str) -> int | None:
    found = [getattr(item, name) for item in metadata if getattr(item, name, None) is not None]
    return int(found[-1]) if found else None


def _several(count: int, item: str, ordered: bool) -> str:
    """Pairs that are checked beyond their length are bounds."""
    if count == 2 and ordered:
        return "[low, high]" if item == "number" else f"[low, high], each {item}"
    return f"{count} {item.replace('number', 'numbers', 1)}"


def _listed(arguments: tuple[Any, ...]) -> str:
    return f"[{', '.join(map(type_words, arguments))}]"
