"""The register of learners, the algorithms that `algo.name` names: `LEARNERS`, `learner`.

What is registered is the class of the config, which imports no torch; it says where the algorithm
is, so that a config can be checked without importing it::

    @learner("cem", builds="my_package.cem:Cem")
    @configclass
    class CemCfg(TensorAlgoCfg):
        name: Literal["cem"] = "cem"
        population: int = 16

A package outside names its module with an entry point of the group ``embodichain.learners``, called
as the learner, which is then an option of the group `algo` too.
"""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.register import Register

__all__ = ["LEARNERS", "Demonstrations", "Learning", "learner"]

Demonstrations = Literal["none", "more", "only"]
Config = TypeVar("Config", bound=type)


@dataclass(frozen=True)
class Learning:
    """A learner as a config names it.

    Attributes:
        name: As in ``algo.name``.
        config: The class of its config: an `AlgoCfg` for a class of Stable-Baselines3, a
            `TensorAlgoCfg` for a `Learner` on the environment's tensors.
        builds: ``package.module:Class`` of the algorithm.
        package: A module that must be installed; empty is the first part of `builds`.
        requires: What pip installs then.
        demonstrations: Whether it learns from none, from some besides its own steps, or only from
            them.
    """

    name: str
    config: type[Any]
    builds: str
    package: str = ""
    requires: str = ""
    demonstrations: Demonstrations = "none"

    def require(self) -> None:
        """Check that its package is installed, without importing it.

        Raises:
            ConfigError: If it is not; says how to install it.
        """
        package = self.package or self.builds.partition(":")[0].partition(".")[0]
        if importlib.util.find_spec(package) is None:
            requires = shlex.quote(self.requires or package.replace("_", "-"))
            message = f"{self.name} needs a package: pip install {requires}"
            raise ConfigError([Problem("algo.name", message)])

    def load(self) -> Any:
        """Import the algorithm.

        Raises:
            ConfigError: If its package is not installed, see `require`.
        """
        self.require()
        module, _, attribute = self.builds.partition(":")
        return getattr(importlib.import_module(module), attribute)


LEARNERS: Register[Learning] = Register(
    "algorithm",
    group="embodichain.learners",
    modules=(
        "embodichain.config.keys.algorithms",
        "embodichain.config.keys.tensor_algorithms",
    ),
)
"""``algo.name`` -> the learner."""


def learner(
    name: str,
    *,
    builds: str,
    package: str = "",
    requires: str = "",
    demonstrations: Demonstrations = "none",
) -> Callable[[Config], Config]:
    """Register the class of a learner's config, a configclass; arguments as of `Learning`.

    Returns:
        A decorator that returns its argument.

    Raises:
        ValueError: If another learner has the name, the config's key ``name`` is another, or the
            class is not a config of a learner.
    """

    def decorate(config: Config) -> Config:
        if not dataclasses.is_dataclass(config) or not hasattr(config, "arguments"):
            raise ValueError(f"{config!r} is not a configclass made of AlgoCfg or TensorAlgoCfg")
        fields = {field.name: field for field in dataclasses.fields(config)}
        config_name = fields["name"].default
        if config_name != name:
            raise ValueError(f"the config of the learner {name!r} has the name {config_name!r}")
        entry = Learning(
            name=name,
            config=config,
            builds=builds,
            package=package,
            requires=requires,
            demonstrations=demonstrations,
        )
        LEARNERS.add(name, describes=config)(entry)
        return config

    return decorate
