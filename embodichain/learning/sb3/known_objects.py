"""`rebuild`: objects of a pickle that are data, made of a register instead of by the pickle.

The register has the classes of networks that Stable-Baselines3 and this package have, by their
names. From an `Inert` pickle, which runs nothing, `rebuild` makes spaces, arrays, plain values, and
classes of the register. Everything else is refused.
"""

from __future__ import annotations

import sys
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common import torch_layers
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.sb2_compat.rmsprop_tf_like import RMSpropTFLike
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from embodichain.config.keys.algorithms import ALGORITHMS
from embodichain.learning.checkpoints.inert_pickle import Inert
from embodichain.learning.sb3.algorithms import algorithm_class
from embodichain.learning.sb3.asymmetric import ASYMMETRIC
from embodichain.learning.sb3.extractors import EXTRACTORS
from embodichain.learning.sb3.symmetry import SymmetricActorCriticPolicy
from embodichain.utils.errors import ConfigError

__all__ = ["NotData", "is_usual", "known_classes", "rebuild"]

_SPACES = (
    *(spaces.Box, spaces.Dict, spaces.Tuple),
    *(spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary),
)
_ARRAY_STATE = 5
"""Length of the state of a pickled array: version, shape, type, order, bytes."""
_GENERATORS = ("_np_random", "np_random")
"""Attributes of spaces that are not needed: of Gymnasium, and of the old Gym."""
_NUMPY = ("numpy._core", "numpy.core")
# Beginnings of names that checkpoints have for what is not needed to act: schedules, buffers,
# noise, random generators. It is never read; other names are worth a word.
_USUAL = (
    *("collections.deque", "collections.OrderedDict"),
    *("gymnasium.spaces.", "gym.spaces.", "stable_baselines3.", "sb3_contrib."),
    *("embodichain.learning.", "torch.nn.", "torch.optim."),
)
_NUMPY_NAMES = (
    *("numpy.dtype", "numpy.ndarray", "numpy.bool", "numpy.bool_", "numpy.float32"),
    *("numpy.float64", "numpy.int64", "numpy.int32", "numpy.uint8"),
    *("numpy.random._", "numpy.random.bit_generator.", "numpy.random.mtrand."),
    *(f"{core}.{part}" for core in _NUMPY for part in ("numeric._frombuffer", "multiarray._recon")),
    *(f"{core}.multiarray.scalar" for core in _NUMPY),
)


_LEARNING = "embodichain.learning"
_FORMER = {
    f"{_LEARNING}.sb3.asymmetric": f"{_LEARNING}.asymmetric",
    f"{_LEARNING}.sb3.extractors": f"{_LEARNING}.extractors",
    f"{_LEARNING}.sb3.symmetry": f"{_LEARNING}.symmetry",
    f"{_LEARNING}.cloning.chunk_policy": f"{_LEARNING}.chunk_policy",
}
"""Module -> where it was when release 0.1 wrote its checkpoints."""


class NotData(Exception):
    """An object is not of the register.

    Attributes:
        name: ``module.name`` of what would make it.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.name = name


def is_usual(name: str) -> bool:
    """Whether checkpoints of Stable-Baselines3 have this name usually, as part of their data."""
    if name.startswith("numpy."):
        return name.startswith(_NUMPY_NAMES)
    # A name may lead through a module to one that it imports: `stable_baselines3.x.os.system`.
    led = sys.stdlib_module_names.intersection(name.split(".")[1:])
    return name.startswith(_USUAL) and not led


@cache
def known_classes() -> dict[str, type]:
    """Return the register: ``module.name`` -> class of a network, an optimizer or a policy."""
    found: list[type] = [
        *_subclasses(torch_layers, BaseFeaturesExtractor),
        *EXTRACTORS.values(),
        *_subclasses(torch.nn.modules.activation, torch.nn.Module),
        *_subclasses(torch.optim, torch.optim.Optimizer),
        RMSpropTFLike,
        *ASYMMETRIC.values(),
        SymmetricActorCriticPolicy,
        *_policies(),
    ]
    named = {f"{cls.__module__}.{cls.__qualname__}": cls for cls in found}
    for cls in found:
        if cls.__module__ in _FORMER:
            named[f"{_FORMER[cls.__module__]}.{cls.__qualname__}"] = cls
    return named


def _subclasses(module: Any, base: type) -> Iterator[type]:
    """The subclasses of a class that a module has."""
    for value in vars(module).values():
        if isinstance(value, type) and issubclass(value, base):
            yield value


def _policies() -> Iterator[type[BasePolicy]]:
    """The policies of every algorithm whose package is installed."""
    for name in ALGORITHMS:
        try:
            yield from algorithm_class(name).policy_aliases.values()
        except ConfigError:  # of a package that is not installed, nothing can be loaded
            continue


def rebuild(value: Any) -> Any:
    """Return the value of an inert pickle, with the objects in it.

    Args:
        value: `InertPickle.value`.

    Raises:
        NotData: If an object is not of the register.
        ValueError: If an object of the register has wrong parts.
    """
    try:
        return _rebuilt(value)
    except NotData:
        raise
    except Exception as error:  # parts that do not fit may raise anything
        raise ValueError(f"{type(error).__name__}: {error}") from error


def _rebuilt(value: Any) -> Any:
    if isinstance(value, type) and issubclass(value, Inert):
        return _class(value.made_by)
    if isinstance(value, Inert):
        return _object(value)
    if isinstance(value, dict):
        return {_rebuilt(k): _rebuilt(v) for k, v in value.items()}
    if type(value) in (list, tuple, set, frozenset):
        return type(value)(_rebuilt(part) for part in value)
    return value


def _class(name: str) -> Any:
    found: dict[str, Any] = {**known_classes(), **_scalar_types()}
    if name not in found:
        raise NotData(name)
    return found[name]


@cache
def _scalar_types() -> dict[str, Any]:
    """Types of numbers that a space may have instead of a dtype."""
    kinds = (np.bool_, np.float32, np.float64, np.int64, np.int32, np.uint8)
    return {f"numpy.{kind.__name__}": kind for kind in kinds} | {"numpy.bool_": np.bool_}


def _object(made: Inert) -> Any:
    maker = _makers().get(made.made_by)
    if maker is None:
        raise NotData(made.made_by)
    return maker(made)


@cache
def _makers() -> dict[str, Callable[[Inert], Any]]:
    """``module.name`` in a pickle -> the function here that makes the object."""
    found: dict[str, Callable[[Inert], Any]] = {
        "numpy.dtype": _dtype,
        "collections.OrderedDict": _ordered,
    }
    for core in _NUMPY:
        found[f"{core}.numeric._frombuffer"] = _from_buffer
        found[f"{core}.multiarray._reconstruct"] = _array
        found[f"{core}.multiarray.scalar"] = _scalar
    for cls in _SPACES:
        name = f"{cls.__module__}.{cls.__qualname__}"
        found[name] = found[name.replace("gymnasium.", "gym.", 1)] = _maker_of_space(cls)
    return found


def _maker_of_space(cls: Any) -> Callable[[Inert], Any]:
    def make(made: Inert) -> Any:
        state = {
            key: None if key in _GENERATORS else _rebuilt(part) for key, part in made.state.items()
        }
        space = cls.__new__(cls)
        space.__setstate__(state)
        return space

    return make


def _ordered(made: Inert) -> OrderedDict[Any, Any]:
    pairs: Iterable[Any] = made.arguments[0] if made.arguments else ()
    return OrderedDict(_rebuilt([*map(tuple, pairs), *made.entries.items()]))


def _dtype(made: Inert) -> np.dtype[Any]:
    kind = str(made.arguments[0])
    order: Any = made.state[1] if made.state is not None else "="
    found = np.dtype(kind)
    if found.hasobject:
        raise NotData(f"an array of objects ({kind})")
    return found if order in ("|", "=") else found.newbyteorder(order)


def _from_buffer(made: Inert) -> np.ndarray[Any, Any]:
    data, dtype, shape, order = made.arguments
    return np.frombuffer(data, _rebuilt(dtype)).reshape(shape, order=order).copy(order="K")


def _array(made: Inert) -> np.ndarray[Any, Any]:
    if made.state is None or len(made.state) != _ARRAY_STATE:
        raise ValueError("a pickled array is damaged")
    _, shape, dtype, by_columns, data = made.state
    order: Any = "F" if by_columns else "C"
    return np.frombuffer(data, _rebuilt(dtype)).reshape(shape, order=order).copy(order="K")


def _scalar(made: Inert) -> Any:
    dtype, data = made.arguments
    return np.frombuffer(data, _rebuilt(dtype))[0]
