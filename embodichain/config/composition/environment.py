"""Variables of the environment in a config: how OmegaConf reads them, and how they are recorded.

`value_of` resolves a value and notes what it read from the environment. Numbers and flags are then
plain values, so that a record repeats the run; text becomes an `EnvText`, of which a record keeps
the interpolation. `taken_today` resolves the text of a record again, for what rebuilds its task.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from omegaconf.resolvers import oc

from embodichain.utils.env_text import (
    EnvText,
    env_texts,
    escaped,
    is_escaped,
    is_from_env,
    names_in,
    remember,
    shown,
)
from embodichain.utils.errors import ConfigError, Problem

__all__ = [
    "as_reader",
    "for_omegaconf",
    "not_taken",
    "notes_of_today",
    "register_env_resolvers",
    "taken_today",
    "value_of",
]

_PART = "embodichain.part"
"""Resolver of one value in a list or a map: ``${embodichain.part:${oc.decode:...},0,name}``."""
_ALLOWED = re.compile(rf"\$\{{(oc\.env|oc\.decode|{re.escape(_PART)}):")
_PLAIN_NAME = re.compile(r"[A-Za-z_]\w*")
_TOKEN = re.compile("\ue000(\\d+)\ue001")
_NOT_READ = ("output_dir", "dataset", "wandb")
"""Keys of a config that do not change its environment."""
_UNSET: Any = object()


@dataclass
class _Reading:
    """What resolving one value reads from the environment.

    Attributes:
        names: Variable -> its value.
        touched: Whether a variable was asked for, also one that is not set and has a default.
        tokens: None while values are resolved. While texts are written it has the value and the
            interpolation for each token; the resolvers return tokens then.
    """

    names: dict[str, str] = field(default_factory=dict)
    touched: bool = False
    tokens: list[tuple[Any, str]] | None = None

    def token(self, value: Any, written: str) -> str:
        """Note a value with its interpolation, and return what stands for it."""
        if self.tokens is None:
            raise ValueError("no text is being written")
        self.tokens.append((value, written))
        return f"\ue000{len(self.tokens) - 1}\ue001"

    def values(self, text: Any) -> Any:
        """Text with values for its tokens; the value itself if it is one token."""
        if not isinstance(text, str) or self.tokens is None:
            return text
        tokens = self.tokens
        token = _TOKEN.fullmatch(text)
        if token is not None:
            return tokens[int(token[1])][0]
        return _TOKEN.sub(lambda match: str(tokens[int(match[1])][0]), text)

    def interpolations(self, text: str) -> str:
        """Text with interpolations for its tokens, in which nothing else is one."""
        tokens = self.tokens or []
        parts = _TOKEN.split(text)  # text, number, text, number, ...
        written = []
        for index, part in enumerate(parts):
            is_number = index % 2 == 1
            written.append(tokens[int(part)][1] if is_number else escaped(part))
        return "".join(written)

    def argument(self, value: Any) -> str:
        """An argument of a resolver, as it is written in an interpolation."""
        if value is None:
            return "null"
        if isinstance(value, bool):
            return str(value).lower()
        if not isinstance(value, str):
            return str(value)
        if _TOKEN.fullmatch(value) or _PLAIN_NAME.fullmatch(value):
            return self.interpolations(value)
        # A backslash before a quote, or at the end, is written twice.
        quoted = re.sub(r"(\\*)'", lambda match: f"{match[1] * 2}\\'", self.interpolations(value))
        quoted = re.sub(r"\\+$", lambda match: match[0] * 2, quoted)
        return f"'{quoted}'"


_reading: ContextVar[_Reading | None] = ContextVar("reading", default=None)


@contextmanager
def _noting(reading: _Reading | None) -> Iterator[None]:
    token = _reading.set(reading)
    try:
        yield
    finally:
        _reading.reset(token)


def register_env_resolvers() -> None:
    """Register OmegaConf's ``oc.env`` and ``oc.decode`` so that what they read can be noted.

    Their results are the same.
    """
    OmegaConf.register_new_resolver("oc.env", _env, replace=True)
    OmegaConf.register_new_resolver("oc.decode", _decode, replace=True)
    OmegaConf.register_new_resolver(_PART, _part, replace=True)


def _env(key: str, default: Any = _UNSET) -> str | None:
    """OmegaConf's ``oc.env``; notes the variable."""
    arguments: list[Any] = [key]
    if default is not _UNSET:
        arguments.append(default)
    reading = _reading.get()
    if reading is None:
        return oc.env(*arguments)
    reading.touched = True
    if reading.tokens is None:
        if key in os.environ:
            reading.names[key] = os.environ[key]
        return oc.env(*arguments)
    value = oc.env(*map(reading.values, arguments))
    if value is None:
        return None
    written = ",".join(map(reading.argument, arguments))
    return reading.token(value, f"${{oc.env:{written}}}")


def _decode(expr: str | None, _parent_: Any, _node_: Any) -> Any:
    """OmegaConf's ``oc.decode``; notes text that was read from the environment."""
    reading = _reading.get()
    if reading is None or reading.tokens is None or not _TOKEN.search(expr or ""):
        return oc.decode(expr, _parent_, _node_)
    with _noting(None):
        value = oc.decode(reading.values(expr), _parent_, _node_)
    if value is None or isinstance(value, (bool, int, float)):
        return value
    return reading.token(value, f"${{oc.decode:{reading.argument(expr)}}}")


def _part(value: Any, *keys: Any) -> Any:
    """The value at keys of a list or a map."""
    reading = _reading.get()
    part = value if reading is None else reading.values(value)
    for key in keys:
        part = part[key]
    if reading is None or part is value or not isinstance(value, str):
        return part
    arguments = ",".join(map(reading.argument, (value, *keys)))
    return reading.token(part, f"${{{_PART}:{arguments}}}")


def value_of(node: DictConfig | ListConfig, key: Any) -> Any:
    """Return a value of a config with its interpolations resolved.

    Args:
        node: A map or a list.
        key: Key or index.

    Returns:
        A node if it is a map or a list of the config itself; plain values, with `EnvText` for
        text, if it was read from the environment.

    Raises:
        OmegaConfBaseException: It cannot be resolved.
    """
    reading = _Reading()
    with _noting(reading):
        value = node[key]
        if reading.touched and isinstance(value, (DictConfig, ListConfig)):
            value = OmegaConf.to_container(value, resolve=True)
    if isinstance(value, str) and not reading.touched and is_from_env(value):
        return EnvText(value, escaped(value))  # text that a record must not resolve
    if not reading.touched or not isinstance(value, (str, list, dict)):
        return value
    for variable, text in reading.names.items():
        remember(variable, text)
    name = next(iter(reading.names), None)
    if isinstance(value, str):
        if name is not None and value not in reading.names.values():
            _remember_decoded(name, value, reading)
        return EnvText(value, _written(node, key, value))
    return _parts(value, _written(node, key, value), name)


def _remember_decoded(name: str, value: str, reading: _Reading) -> None:
    """Note text that was decoded: it is not a part of a variable that has escapes."""
    if not any(text in value for text in reading.names.values() if text):
        remember(name, value)


def _written(node: DictConfig | ListConfig, key: Any, value: Any) -> str:
    """The interpolation that gives a value, without references to other keys where possible."""
    reading = _Reading(tokens=[])
    raw: Any = OmegaConf.to_container(node, resolve=False)
    try:
        with _noting(reading):
            text = node[key]
    except (OmegaConfBaseException, LookupError, TypeError, ValueError):
        return str(raw[key])  # a resolver that does not take a token
    if isinstance(text, str) and _TOKEN.search(text) and reading.values(text) == value:
        return reading.interpolations(text)
    return str(raw[key])


def _parts(value: Any, written: str, name: str | None, keys: Sequence[Any] = ()) -> Any:
    """A list or a map that was read from the environment, with `EnvText` for each text in it."""
    if isinstance(value, str):
        if name is not None:
            remember(name, value)
        arguments = ",".join(map(_Reading(tokens=[]).argument, keys))
        return EnvText(value, f"${{{_PART}:{written},{arguments}}}")
    if isinstance(value, Mapping):
        return {key: _parts(item, written, name, (*keys, key)) for key, item in value.items()}
    if isinstance(value, list):
        return [_parts(item, written, name, (*keys, i)) for i, item in enumerate(value)]
    return value


def taken_today(tree: Mapping[str, Any], source: str = "") -> dict[str, Any]:
    """Return a record's tree with today's values of the variables that its texts name.

    Args:
        tree: The YAML of a run's `config.yaml`; texts that are resolved already stay.
        source: The record, for messages.

    Returns:
        A tree with `EnvText`.

    Raises:
        ConfigError: A variable is not set, or a text asks for more than the environment.
    """
    register_env_resolvers()
    problems: list[Problem] = []

    def today(value: Any, path: str) -> Any:
        if isinstance(value, Mapping):
            return {k: today(item, f"{path}.{k}" if path else str(k)) for k, item in value.items()}
        if isinstance(value, (list, tuple)):
            return [today(item, f"{path}.{i}") for i, item in enumerate(value)]
        if not isinstance(value, str) or isinstance(value, EnvText):
            return value
        if is_escaped(value):
            return EnvText(OmegaConf.create({"value": value})["value"], value)
        if not is_from_env(value):
            return value
        try:
            return _today(value)
        except (OmegaConfBaseException, ValueError, LookupError, TypeError) as error:
            problems.append(not_taken(path, value, str(error).splitlines()[0], source))
            return value

    resolved_tree: dict[str, Any] = today(tree, "")
    if problems:
        raise ConfigError(problems)
    return resolved_tree


def not_taken(path: str, text: object, reason: str, source: str) -> Problem:
    """Return the problem of a record's text that cannot be resolved today.

    Args:
        path: Its key.
        text: The text.
        reason: OmegaConf's message.
        source: The record.
    """
    unset = [name for name in names_in(str(text)) if name not in os.environ]
    message = f"cannot resolve {text!r}, as the record has it: {reason}"
    if unset and "not found" in reason:
        message = f"{unset[0]} is not set in the environment, and the record has {text!r}"
    return Problem(path, message, source=source)


def _today(text: str) -> Any:
    """The value of a record's text today."""
    _check_asks(text)
    return value_of(OmegaConf.create({"value": text}), "value")


def _check_asks(text: str) -> None:
    """Raise `ValueError` if a text of a record asks for more than the environment."""
    for begin in re.finditer(r"(\\*)\$\{", text):
        if len(begin[1]) % 2 == 0 and not _ALLOWED.match(text, begin.end(1)):
            raise ValueError("a record takes only variables of the environment (oc.env)")


def for_omegaconf(tree: Mapping[str, Any], source: str = "") -> dict[str, Any]:
    """Return a record's tree for OmegaConf: nothing but the environment is resolved in it.

    Args:
        tree: The YAML of a run's `config.yaml`.
        source: The record, for messages.

    Raises:
        ConfigError: A text asks for more than the environment.
    """

    def safe(value: Any, path: str) -> Any:
        if isinstance(value, Mapping):
            return {k: safe(item, f"{path}.{k}" if path else str(k)) for k, item in value.items()}
        if isinstance(value, list):
            return [safe(item, f"{path}.{i}") for i, item in enumerate(value)]
        if not isinstance(value, str) or is_escaped(value):
            return value
        if not is_from_env(value):
            return escaped(value)
        try:
            _check_asks(value)
        except ValueError as error:
            raise ConfigError([Problem(path, f"{value!r}: {error}", source=source)]) from error
        return value

    escaped_tree: dict[str, Any] = safe(tree, "")
    return escaped_tree


def as_reader(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Return a record's tree in which texts that no environment reads show ``<env NAME>``.

    Their variables need not be set to read the record.

    Args:
        tree: The YAML of a run's `config.yaml`.
    """
    readable = dict(tree)
    for name in _NOT_READ:
        if name in tree:
            readable[name] = shown(tree[name])
    task = readable.get("task")
    if isinstance(task, Mapping) and "description" in task:
        readable["task"] = {**task, "description": shown(task["description"])}
    return readable


def notes_of_today(tree: Any) -> tuple[Problem, ...]:
    """Return a note for each variable whose value of today a tree has.

    Args:
        tree: A result of `taken_today`.
    """
    first_paths: dict[str, str] = {}
    for path, text in env_texts(tree):
        for name in text.names:
            if name in os.environ:
                first_paths.setdefault(name, path)
    return tuple(
        Problem(path, f"{name} is taken from today's environment")
        for name, path in first_paths.items()
    )
