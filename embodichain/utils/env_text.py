"""Text whose value comes from variables of the environment: its records, and what is shown of it.

A run uses the value. Its records keep the interpolation, ``${oc.env:NAME}``, since they are what
people publish and a variable may be a secret. Messages show ``<env NAME>``.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

__all__ = [
    "EnvText",
    "as_written",
    "env_texts",
    "escaped",
    "hidden",
    "hidden_in",
    "is_escaped",
    "is_from_env",
    "known_values",
    "names_in",
    "recorded_texts",
    "remember",
    "shown",
]

_OURS = r"\$\{(?:oc\.env:|oc\.decode:|embodichain\.part:)"
_INTERPOLATION = re.compile(rf"(?P<slashes>\\*){_OURS}")
_NAME = re.compile(r"oc\.env:\s*['\"]?([A-Za-z_]\w*)")
_SHORTEST = 4
"""Values with fewer characters are not looked for in messages: they are parts of many words."""
_LONG = 8
"""Values with fewer characters are looked for as whole words."""
_values: dict[str, str] = {}
"""What this process took from the environment -> the variable."""


class EnvText(str):
    """Text with values of variables of the environment.

    It is its value for everything but a record: `dump_yaml` writes `written`.

    Attributes:
        written: The interpolation that gives the value: ``${oc.env:ROBOTS}/arm.urdf``.
    """

    __slots__ = ("written",)
    written: str

    def __new__(cls, value: str, written: str) -> EnvText:
        """Make a text with this value."""
        text = super().__new__(cls, value)
        text.written = written
        return text

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle and copy both, with what messages of another process have to hide."""
        names = self.names
        known = {value: name for value, name in _values.items() if name in names}
        return _again, (str(self), self.written, known)

    @property
    def names(self) -> tuple[str, ...]:
        """The variables."""
        return names_in(self.written)

    def __repr__(self) -> str:
        """Show the variable instead of the value."""
        return repr(shown(self.written))


def _again(value: str, written: str, known: Mapping[str, str]) -> EnvText:
    for text, name in known.items():
        remember(name, text)
    return EnvText(value, written)


def remember(name: str, value: str) -> None:
    """Note a value that this process took from a variable, so that messages hide it."""
    if len(value) >= _SHORTEST and value not in os.environ:  # names of variables are not secret
        _values[value] = name


def known_values() -> Mapping[str, str]:
    """Return what this process took from the environment: value -> the variable."""
    return dict(_values)


def hidden(text: str) -> str:
    """Return a message with ``<env NAME>`` for each value that was taken from the environment.

    Values of up to three characters are not hidden, those of up to seven only as whole words.
    """
    if not _values:
        return text
    forms: dict[str, str] = {}
    for value, name in _values.items():
        forms |= dict.fromkeys((value, repr(value)[1:-1], json.dumps(value)[1:-1]), name)
    patterns = (
        re.escape(form) if len(form) >= _LONG else rf"(?<!\w){re.escape(form)}(?!\w)"
        for form in sorted(forms, key=len, reverse=True)
    )
    return re.sub("|".join(patterns), lambda found: f"<env {forms[found[0]]}>", text)


def is_from_env(text: object) -> bool:
    """Whether a value of a record is an interpolation of variables of the environment."""
    if not isinstance(text, str) or isinstance(text, EnvText):
        return False
    return any(len(found["slashes"]) % 2 == 0 for found in _INTERPOLATION.finditer(text))


def is_escaped(text: str) -> bool:
    r"""Whether a text of a record is what a person wrote as text: ``\${oc.env:NAME}``."""
    return not is_from_env(text) and _INTERPOLATION.search(text) is not None


def names_in(written: str) -> tuple[str, ...]:
    """Return the variables that an interpolation names, each once, in order."""
    return tuple(dict.fromkeys(_NAME.findall(written)))


def escaped(text: str) -> str:
    """Return text in which nothing is an interpolation for OmegaConf."""
    return re.sub(r"(\\*)\$\{", lambda found: f"{found[1] * 2}\\${{", text)


def as_written(value: Any) -> Any:
    """Return a value, a list or a map as a record has it: with interpolations for values."""
    return _mapped(value, lambda text: text.written if isinstance(text, EnvText) else text)


def hidden_in(value: Any) -> Any:
    """Return a list or a map with `hidden` texts."""
    return _mapped(value, hidden)


def shown(value: Any) -> Any:
    """Return a value of a record, a list or a map with ``<env NAME>`` for each interpolation."""
    return _mapped(value, _shown)


def _mapped(value: Any, change: Callable[[str], str]) -> Any:
    if isinstance(value, str):
        return change(value)
    if isinstance(value, Mapping):
        return {key: _mapped(item, change) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_mapped(item, change) for item in value]
    return value


def _shown(text: str) -> str:
    if isinstance(text, EnvText):
        text = text.written
    parts: list[str] = []
    at = 0
    for found in _INTERPOLATION.finditer(text):
        if found.start() < at:
            continue  # inside of the one before
        slashes = found["slashes"]
        parts.append(text[at : found.start()] + slashes[: len(slashes) // 2])
        begin = found.end("slashes")
        if len(slashes) % 2:  # escaped: it is text
            parts.append("${")
            at = begin + 2
            continue
        at = _end(text, begin)
        parts.append(f"<env {', '.join(names_in(text[begin:at])) or '?'}>")
    return "".join([*parts, text[at:]])


def _end(text: str, begin: int) -> int:
    """The place after the bracket that closes an interpolation."""
    depth = 0
    for place in range(begin, len(text)):
        depth += {"{": 1, "}": -1}.get(text[place], 0)
        if text[place] == "}" and not depth:
            return place + 1
    return len(text)


def env_texts(tree: Any, path: str = "") -> Iterator[tuple[str, EnvText]]:
    """Yield key path and text of each value that comes from the environment.

    Args:
        tree: A resolved config's tree.
        path: Its key path.
    """
    return ((where, text) for where, text in _texts(tree, path) if isinstance(text, EnvText))


def recorded_texts(tree: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield key path and text of each interpolation in a record.

    Args:
        tree: The YAML of a record.
        path: Its key path.
    """
    return ((where, text) for where, text in _texts(tree, path) if is_from_env(text))


def _texts(value: Any, path: str) -> Iterator[tuple[str, str]]:
    if isinstance(value, str):
        yield path, value
    items: Iterable[tuple[Any, Any]] = value.items() if isinstance(value, Mapping) else ()
    if isinstance(value, (list, tuple)):
        items = enumerate(value)
    for key, item in items:
        yield from _texts(item, f"{path}.{key}" if path else str(key))
