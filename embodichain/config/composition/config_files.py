"""The files that Hydra merges; a process parses each text once.

Hydra parses every file again for each composition, which is half of the time of composing. A
process that composes many configs (a sweep, a study, `validate` of a robot that a task cannot take)
meets the same texts again and again. They are remembered by content, not by path: a file that was
edited is read anew.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import yaml
from hydra._internal.config_repository import ConfigRepository
from hydra.core.object_type import ObjectType
from hydra.plugins.config_source import ConfigResult, ConfigSource
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from embodichain.config.composition.yaml_words import load_plain

__all__ = ["TextRepository"]

_HEADER = 512
"""Characters of a file in which Hydra looks for ``# @package PLACE``."""
_REFUSALS = (yaml.YAMLError, OmegaConfBaseException, ValueError, TypeError, RecursionError)
"""Exceptions of a text that cannot be read here: Hydra reads it, and raises its own."""


@dataclass(frozen=True)
class _Parsed:
    """What a text says.

    Attributes:
        config: Its content without the defaults list. It is shared: a merge has to copy it.
        defaults: The defaults list.
        header: What its first comment says: the package.
    """

    config: DictConfig
    defaults: ListConfig
    header: Mapping[str, str | None]


class TextRepository(ConfigRepository):
    """Hydra's repository of the configs on a search path, which parses each text once."""

    def load_config(self, config_path: str) -> ConfigResult | None:
        """Return a config, or None if no file has it; its content is shared, and stays as it is."""
        source = self._find_object_source(config_path, ObjectType.CONFIG)
        parsed = None if source is None else _parsed_file(source, config_path)
        if source is None or parsed is None:
            return super().load_config(config_path)
        return ConfigResult(
            provider=source.provider,
            path=f"{source.scheme()}://{source.path}",
            config=parsed.config,
            header=dict(parsed.header),
            defaults_list=self._create_defaults_list(config_path, parsed.defaults),
        )

    def __deepcopy__(self, memo: dict[int, Any]) -> TextRepository:
        """Copy the list of sources, which Hydra replaces, and none of the sources.

        A deep copy contains all of Hydra's structured configs, for 15 ms of a composition.
        """
        other = copy.copy(self)
        other.sources = list(self.sources)
        return other


def _parsed_file(source: ConfigSource, config_path: str) -> _Parsed | None:
    """Return a file's content, None if it is for Hydra to read: it is not a file, or malformed."""
    name = config_path if config_path.endswith(".yaml") else f"{config_path}.yaml"
    try:
        if source.scheme() == "file":
            return _parse(Path(source.path, name).read_text(encoding="utf-8"))
        if source.scheme() == "pkg":
            return _parse(resources.files(source.path).joinpath(name).read_text(encoding="utf-8"))
    except (OSError, *_REFUSALS):
        return None
    return None


@lru_cache(maxsize=1024)
def _parse(text: str) -> _Parsed | None:
    values = load_plain(text)
    if not isinstance(values, dict):
        return None
    config = OmegaConf.create(values)
    defaults = config.pop("defaults", OmegaConf.create([]))
    if not isinstance(defaults, ListConfig):
        return None
    header = ConfigSource._get_header_dict(text[:_HEADER])  # as Hydra's own sources do
    return _Parsed(config, defaults, header)
