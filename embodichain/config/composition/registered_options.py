"""Options of Hydra's groups for learners, viewers and launchers of packages outside.

Ours have a file in ``conf/algo``, ``conf/viewer`` or ``conf/hydra/launcher``, for people to read
and to override. What a package outside registers needs none: ``algo=NAME`` is then the config
``{name: NAME}``, whose other keys have the defaults of its class; that of a launcher has its class
and the defaults of its arguments. A file of that name comes first.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from hydra.core.object_type import ObjectType
from hydra.plugins.config_source import ConfigResult, ConfigSource
from omegaconf import OmegaConf

from embodichain.config.keys.launchers import LAUNCHERS
from embodichain.config.keys.learners import LEARNERS
from embodichain.config.keys.viewers import VIEWERS
from embodichain.utils.register import Register

__all__ = ["PLACE", "RegisteredOptions", "hydras_name"]

_SCHEME = "embodichain-register"
PLACE = f"{_SCHEME}://"
"""Where Hydra finds these options, for its search path."""
_LAUNCHERS = "hydra/launcher"
_GROUPS: Mapping[str, Register[Any]] = {
    "algo": LEARNERS,
    "viewer": VIEWERS,
    _LAUNCHERS: LAUNCHERS,
}
_PARENTS = {"": ("algo", "hydra", "viewer"), "hydra": ("launcher",)}
"""Group -> the groups in it."""


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
        return config_path.strip("/") in (*_PARENTS, *_GROUPS)

    def is_config(self, config_path: str) -> bool:
        """Whether there is an option ``GROUP/NAME``."""
        group, name = _parts(config_path)
        return group in _GROUPS and name in _GROUPS[group].entry_names()

    def load_config(self, config_path: str) -> ConfigResult:
        """Return the option ``GROUP/NAME``."""
        group, name = _parts(config_path)
        values = _launcher(name) if group == _LAUNCHERS else {"name": name}
        return ConfigResult(
            config=OmegaConf.create(values),
            path=PLACE,
            provider=self.provider,
            header={"package": None},
        )

    def list(self, config_path: str, results_filter: ObjectType | None) -> list[str]:
        """Return the options of a group, or the groups."""
        group = config_path.strip("/")
        if group in _PARENTS:
            return [] if results_filter == ObjectType.CONFIG else list(_PARENTS[group])
        if results_filter == ObjectType.GROUP or group not in _GROUPS:
            return []
        return sorted(_GROUPS[group].entry_names())


def _parts(config_path: str) -> tuple[str, str]:
    """Group and name of a path, which may have a suffix."""
    group, _, name = config_path.strip("/").rpartition("/")
    return group, name.removesuffix(".yaml")


def hydras_name(launcher: type) -> str:
    """Return the name that Hydra finds a launcher's class by: it must be in `hydra_plugins`."""
    return f"hydra_plugins.embodichain.{launcher.__name__}"


def _launcher(name: str) -> dict[str, Any]:
    """The config of a launcher: its class, and the defaults of its arguments."""
    launcher = LAUNCHERS[name].launcher
    defaults = {
        parameter.name: parameter.default
        for parameter in inspect.signature(launcher).parameters.values()
        if parameter.default is not inspect.Parameter.empty
    }
    return {"_target_": hydras_name(launcher), **defaults}
