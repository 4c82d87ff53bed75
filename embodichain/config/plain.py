"""An OmegaConf tree becomes plain dicts and lists; every value that cannot be resolved is reported.

`_target_` is refused here: a config names functions as ``func``, and nothing instantiates classes.
"""

from __future__ import annotations

from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from embodichain.config.locate import Locator
from embodichain.config.problems import LocatedProblem

__all__ = ["resolve"]

_INSTANTIATE = ("_target_", "_recursive_", "_convert_", "_partial_", "_args_")


def resolve(config: DictConfig, locator: Locator) -> tuple[dict[str, Any], list[LocatedProblem]]:
    """Resolve interpolations everywhere.

    Args:
        config: The composed config.
        locator: Finds the source of what fails.

    Returns:
        The plain tree without the keys that failed, and one problem for each of these.
    """
    walk = _Walk(locator)
    return walk.mapping(config, ""), walk.problems


class _Walk:
    def __init__(self, locator: Locator) -> None:
        self.problems: list[LocatedProblem] = []
        self._locator = locator

    def mapping(self, config: DictConfig, path: str) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for key in config:
            where = f"{path}.{key!s}" if path else str(key)
            if key in _INSTANTIATE:
                self._report(where, f"{key} is not used here: name a function with func: NAME")
            elif self._readable(config, key, where):
                result[str(key)] = self._value(config[key], where)
        return result

    def _value(self, value: Any, path: str) -> Any:
        if isinstance(value, DictConfig):
            return self.mapping(value, path)
        if isinstance(value, ListConfig):
            indices = [i for i in range(len(value)) if self._readable(value, i, f"{path}.{i}")]
            return [self._value(value[i], f"{path}.{i}") for i in indices]
        return value

    def _readable(self, node: DictConfig | ListConfig, key: Any, path: str) -> bool:
        """Whether a value is there and resolves; reports it otherwise."""
        if OmegaConf.is_missing(node, key):
            self._report(path, "missing value (???): it must be set")
            return False
        try:
            node[key]
        except OmegaConfBaseException as error:
            reason = str(error).splitlines()[0]
            self._report(path, f"cannot resolve {_raw(node, key)!r}: {reason}")
            return False
        return True

    def _report(self, path: str, message: str) -> None:
        self.problems.append(LocatedProblem(path, message, source=self._locator.source(path)))


def _raw(node: DictConfig | ListConfig, key: Any) -> Any:
    child = node._get_node(key)  # the interpolation as written; OmegaConf has no public name for it
    return child._value() if child is not None and not isinstance(child, list) else None
