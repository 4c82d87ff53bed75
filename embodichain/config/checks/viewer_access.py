"""Who may use a config's viewer; and that no record has the token that a config gives."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from embodichain.config.composition.locate import COMMAND_LINE
from embodichain.config.keys.schema import ViewerCfg
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.system.access import AUTO, WITHHELD, Access, is_secret

__all__ = ["access_of", "refuse_token", "take_token", "without_token"]

_KEY = "viewer.token"
_REFERENCE = re.compile(r"""['"]?\$\{[^{}]*\}['"]?""")
"""A value that refers to another, such as ``${oc.env:TOKEN}``: not a secret itself."""


def access_of(viewer: ViewerCfg, token: str | None = None) -> Access:
    """Return who may use a viewer.

    Args:
        viewer: Its config.
        token: The token that `take_token` took out of the config; None is the config's own.
    """
    origins = viewer.allow_origins
    return Access(
        token=viewer.token if token is None else token,
        allow_hosts=tuple(viewer.allow_hosts),
        allow_origins=None if origins is None else tuple(origins),
    )


def take_token(tree: Mapping[str, Any]) -> tuple[Mapping[str, Any], str]:
    """Return a config with `WITHHELD` for a given token, and the token.

    In a config that was read from a record the token is `WITHHELD` already, which is `AUTO`.

    Args:
        tree: A checked config.
    """
    viewer = tree.get("viewer")
    if not isinstance(viewer, Mapping):
        return tree, AUTO
    token = viewer.get("token", AUTO)
    if token == WITHHELD:
        return tree, AUTO
    if not is_secret(token):
        return tree, token
    return {**tree, "viewer": {**viewer, "token": WITHHELD}}, token


def without_token(lines: Iterable[str]) -> tuple[str, ...]:
    """Return overrides, or the words of a command line, with `WITHHELD` for a given token."""
    return tuple(map(_withheld, lines))


def refuse_token(lines: Iterable[str]) -> None:
    """Refuse the overrides of a sweep that give a token: Hydra writes them to `multirun.yaml`.

    Raises:
        ConfigError: An override gives one.
    """
    if any(_withheld(line) != line for line in lines):
        message = "a sweep would write it to multirun.yaml"
        hint = "Name an environment variable: viewer.token='${oc.env:NAME}'."
        raise ConfigError([Problem(_KEY, message, hint, COMMAND_LINE)])


def _withheld(line: str) -> str:
    """An override with `WITHHELD` for the token that it gives."""
    key, _, value = line.partition("=")
    if key.lstrip("+~").strip() != _KEY or not is_secret(value) or _REFERENCE.fullmatch(value):
        return line
    return f"{key}='{WITHHELD}'"
