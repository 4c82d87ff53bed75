"""`@configclass`: dataclasses with inline mutable defaults.

The interface follows EmbodiChain's decorator of the same name: un-annotated members become fields,
mutable defaults are deep-copied per instance, and `to_dict`, `from_dict`, `replace`, `copy` and
`validate` are added. `embodichain.config` checks YAML against these classes.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Mapping
from functools import partial, wraps
from types import FunctionType
from typing import Any, TypeVar, dataclass_transform, overload

__all__ = ["MISSING", "config_to_dict", "configclass", "is_configclass"]

T = TypeVar("T")

MISSING: Any = dataclasses.MISSING
"""Marks a required field; `validate()` lists those that are unset."""

# Unknown keys are errors: pydantic reads this when it validates YAML against the class.
_PYDANTIC_CONFIG = {"extra": "forbid", "arbitrary_types_allowed": True}
_PLAIN = (int, float, complex, str, bytes, bool, type(None), tuple, frozenset, type, FunctionType)


@overload
def configclass(cls: type[T], /) -> type[T]: ...
@overload
def configclass(*, kw_only: bool = False) -> Callable[[type[T]], type[T]]: ...


@dataclass_transform(field_specifiers=(dataclasses.field,))
def configclass(
    cls: type[T] | None = None, /, *, kw_only: bool = False
) -> type[T] | Callable[[type[T]], type[T]]:
    """Turn a class into a configuration dataclass.

    Args:
        cls: The class; its annotations (and un-annotated public members) become fields.
        kw_only: Whether the class's own fields are keyword-only.

    Returns:
        The dataclass, with `to_dict`, `from_dict`, `replace`, `copy` and `validate` added unless it
        has them.
    """
    if cls is None:
        return lambda c: _process(c, kw_only)
    return _process(cls, kw_only)


def _process(cls: type[T], kw_only: bool) -> type[T]:
    annotations = dict(cls.__dict__.get("__annotations__", {}))
    for name, value in list(vars(cls).items()):
        if name.startswith("__") or isinstance(value, (property, classmethod, staticmethod)):
            continue
        if name not in annotations:
            if callable(value) or isinstance(value, dataclasses.Field):
                continue
            annotations[name] = "Any" if value is None else type(value).__name__
        if "ClassVar" in str(annotations[name]):
            continue
        if value is MISSING:  # unset until the user sets it: reported by `validate`
            setattr(cls, name, dataclasses.field(default_factory=lambda: MISSING))
        elif not isinstance(value, (*_PLAIN, dataclasses.Field)):
            fresh = partial(copy.deepcopy, value)
            setattr(cls, name, dataclasses.field(default_factory=fresh))
    cls.__annotations__ = annotations
    result = dataclasses.dataclass(kw_only=kw_only)(cls)
    setattr(result, "__pydantic_config__", _PYDANTIC_CONFIG)  # noqa: B010  (not a declared member)
    if getattr(result, "other_names", None):
        _take_other_names(result)
    for name, method in _METHODS.items():
        if name not in vars(result) and not hasattr(result, name):
            setattr(result, name, method)
    return result


def _take_other_names(cls: Any) -> None:
    """Let the constructor take other names of fields, those in the class's ``other_names``."""
    init = cls.__init__

    @wraps(init)
    def __init__(self: Any, *args: Any, **values: Any) -> None:
        init(self, *args, **_renamed(cls, values))

    cls.__init__ = __init__


def _renamed(cls: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    """Values by field, where some are given by another name of theirs.

    Raises:
        TypeError: If a value is given by both names.
    """
    other_names = getattr(cls, "other_names", {})
    for name in values:
        field = other_names.get(name)
        if field in values:
            raise TypeError(f"{cls.__name__}: {name} means the same as {field}: leave one out")
    return {other_names.get(name, name): value for name, value in values.items()}


def config_to_dict(cfg: object) -> dict[str, Any]:
    """Return a config as nested plain dicts and lists (deep copy).

    Args:
        cfg: A configclass instance.

    Returns:
        One entry per field; nested configs become dicts, everything else is deep-copied.
    """
    return {f.name: _plain(getattr(cfg, f.name)) for f in dataclasses.fields(cfg)}  # type: ignore[arg-type]


def is_configclass(value: object) -> bool:
    """Whether this is a configclass or an instance of one."""
    return dataclasses.is_dataclass(value) and hasattr(value, "__pydantic_config__")


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return config_to_dict(value)
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return copy.deepcopy(value)


def _replace(self: Any, **changes: Any) -> Any:
    """Return a deep copy of this config with some fields changed."""
    return dataclasses.replace(copy.deepcopy(self), **_renamed(type(self), changes))


def _validate(self: Any, prefix: str = "") -> None:
    """Raise TypeError that lists every MISSING field, nested ones included."""
    missing = list(_missing(self, prefix or type(self).__name__))
    if missing:
        raise TypeError(f"Missing values: {', '.join(missing)}")


def _missing(value: Any, path: str) -> list[str]:
    if value is MISSING:
        return [path]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        entries = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    elif isinstance(value, Mapping):
        entries = dict(value)
    else:
        return []
    missing: list[str] = []
    for name, entry in entries.items():
        missing += _missing(entry, f"{path}.{name}")
    return missing


def _from_dict(cls: type[Any], init_dict: dict[str, Any]) -> Any:
    """Build a config from nested plain values; ConfigError lists every mistake."""
    from embodichain.utils.fields.type_errors import from_dict  # pydantic: only when it is called

    return from_dict(cls, init_dict)


_METHODS: dict[str, Any] = {
    "from_dict": classmethod(_from_dict),
    "to_dict": config_to_dict,
    "replace": _replace,
    "copy": _replace,
    "validate": _validate,
}
