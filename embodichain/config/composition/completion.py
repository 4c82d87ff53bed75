"""Completion of overrides on the command line: groups, their options and keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from embodichain.config.composition.composed import compose
from embodichain.config.composition.hydra_loader import config_loader
from embodichain.config.keys.check_types import key_names, schema_at

__all__ = ["complete_override"]


def complete_override(
    typed: str,
    before: Sequence[str] = (),
    config_name: str = "run",
    config_dir: str | Path | None = None,
) -> list[str]:
    """Return the completions of an override: ``task=NAME``, ``algo=``, ``task.physics.``...

    Args:
        typed: The word so far.
        before: The overrides before it.
        config_name: The root config.
        config_dir: A folder with the user's groups.
    """
    prefix = typed[: len(typed) - len(typed.lstrip("+~"))]
    key, has_value, value = typed[len(prefix) :].partition("=")
    with config_loader(config_dir) as loader:
        if has_value:
            options = loader.get_group_options(key)
            return [f"{prefix}{key}={name}" for name in options if name.startswith(value)]
        group, slash, _ = key.rpartition("/")
        if slash:
            groups = [f"{group}/{name}" for name in loader.list_groups(group)]
        else:
            groups = [name for name in loader.list_groups("") if name != "hydra"]
        words = [f"{name}=" for name in groups if loader.get_group_options(name)]
    parent, dot, _ = key.rpartition(".")
    tree: Any = compose(before, config_name, config_dir).tree
    parts = parent.split(".") if dot else []
    node = tree
    for part in parts:
        node = node.get(part) if isinstance(node, Mapping) else None
    names = list(node) if isinstance(node, Mapping) else []
    names += key_names(schema_at(parts, tree))
    for name in map(str, dict.fromkeys(names)):
        path = f"{parent}{dot}{name}"
        is_map = isinstance(node, Mapping) and isinstance(node.get(name), Mapping)
        keys = key_names(schema_at([*parts, name], tree))
        words.append(f"{path}." if is_map or keys else f"{path}=")
    return [f"{prefix}{word}" for word in dict.fromkeys(words) if word.startswith(key)]
