"""Options of Hydra's groups for learners and viewers of packages outside.

Ours have a file in ``conf/algo`` or ``conf/viewer``, for people to read and to override. What a
package outside registers needs none: ``algo=NAME`` is then the config ``{name: NAME}``, whose other
keys have the defaults of its class. A file of that name comes first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from hydra.core.object_type import ObjectType
from hydra.plugins.config_source import ConfigResult, ConfigSource
from omegaconf import OmegaConf

from embodichain.config.keys.learners import LEARNERS
from embodichain.config.keys.viewers import VIEWERS

__all__ = ["PLACE", "RegisteredOptions"]

_SCHEME = "embodichain-register"
PLACE = f"{_SCHEME}://"
"""Where Hydra finds these options, for its search path."""
_GROUPS: Mapping[str, Callable[[], tuple[str, ...]]] = {
    "algo": LEARNERS.entry_names,
    "viewer": VIEWERS.entry_names,
}


class RegisteredOptions(ConfigSource):
    """A place of Hydra's search path with an option for each entry point of our registers."""

    @staticmethod
    def scheme() -> str:
        """The first part of `PLACE`."""
        return _SCHEME

    def available(self) -> bool:
        """Whether the place exists."""
        return True

    def is_group(self, config_path: str) -> bool:
        """Whether there are options in a group."""
        return config_path.strip("/") in ("", *_GROUPS)

    def is_config(self, config_path: str) -> bool:
        """Whether there is an option ``GROUP/NAME``."""
        group, name = _parts(config_path)
        return group in _GROUPS and name in _GROUPS[group]()

    def load_config(self, config_path: str) -> ConfigResult:
        """Return the option ``GROUP/NAME``."""
        name = _parts(config_path)[1]
        return ConfigResult(
            config=OmegaConf.create({"name": name}),
            path=PLACE,
            provider=self.provider,
            header={"package": None},
        )

    def list(self, config_path: str, results_filter: ObjectType | None) -> list[str]:
        """Return the options of a group, or the groups."""
        group = config_path.strip("/")
        if not group:
            return [] if results_filter == ObjectType.CONFIG else sorted(_GROUPS)
        if results_filter == ObjectType.GROUP or group not in _GROUPS:
            return []
        return sorted(_GROUPS[group]())


def _parts(config_path: str) -> tuple[str, str]:
    """Group and name of a path, which may have a suffix."""
    group, _, name = config_path.strip("/").rpartition("/")
    return group, name.removesuffix(".yaml")
