"""`rebuild`: objects of a pickle that are data, made from a register instead of by the pickle.

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
    spaces.Box,
    spaces.Dict,
    spaces.Tuple,
    spaces.Discrete,
    spaces.MultiDiscrete,
    spaces.MultiBinary,
)
_ARRAY_STATE = 5
"""Length of the state of a pickled array: version, shape, type, order, bytes."""
_GENERATORS = ("_np_random", "np_random")
"""Attributes of spaces that are not needed: of Gymnasium, and of the old Gym."""
_NUMPY_CORES = ("numpy._core", "numpy.core")
"""Where numpy's functions are: of version 2, and of version 1."""

# Beginnings of names that checkpoints have for parts that are not needed to act: schedules,
# buffers, noise, random generators. These are never read; other names are worth a warning.
_USUAL_PREFIXES = (
    "collections.deque",
    "collections.OrderedDict",
    "gymnasium.spaces.",
    "gym.spaces.",
    "stable_baselines3.",
    "sb3_contrib.",
    "embodichain.learning.",
    "torch.nn.",
    "torch.optim.",
)
_USUAL_NUMPY_PREFIXES = (
    "numpy.dtype",
    "numpy.ndarray",
    "numpy.bool",
    "numpy.bool_",
    "numpy.float32",
    "numpy.float64",
    "numpy.int64",
    "numpy.int32",
    "numpy.uint8",
    "numpy.random._",
    "numpy.random.bit_generator.",
    "numpy.random.mtrand.",
    "numpy._core.numeric._frombuffer",
    "numpy._core.multiarray._recon",
    "numpy._core.multiarray.scalar",
    "numpy.core.numeric._frombuffer",
    "numpy.core.multiarray._recon",
    "numpy.core.multiarray.scalar",
)

_FORMER_MODULES = {
    "embodichain.learning.sb3.asymmetric": "embodichain.learning.asymmetric",
    "embodichain.learning.sb3.extractors": "embodichain.learning.extractors",
    "embodichain.learning.sb3.symmetry": "embodichain.learning.symmetry",
    "embodichain.learning.cloning.chunk_policy": "embodichain.learning.chunk_policy",
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
        return name.startswith(_USUAL_NUMPY_PREFIXES)
    # A name may lead through a module to one that it imports: `stable_baselines3.x.os.system`.
    imported_modules = sys.stdlib_module_names.intersection(name.split(".")[1:])
    return name.startswith(_USUAL_PREFIXES) and not imported_modules


@cache
def known_classes() -> dict[str, type]:
    """Return the register: ``module.name`` -> class of a network, an optimizer or a policy."""
    classes: list[type] = [
        *_subclasses(torch_layers, BaseFeaturesExtractor),
        *EXTRACTORS.values(),
        *_subclasses(torch.nn.modules.activation, torch.nn.Module),
        *_subclasses(torch.optim, torch.optim.Optimizer),
        RMSpropTFLike,
        *ASYMMETRIC.values(),
        SymmetricActorCriticPolicy,
        *_policies(),
    ]
    register = {f"{cls.__module__}.{cls.__qualname__}": cls for cls in classes}
    for cls in classes:
        former_module = _FORMER_MODULES.get(cls.__module__)
        if former_module is not None:
            register[f"{former_module}.{cls.__qualname__}"] = cls
    return register


def _subclasses(module: Any, base: type) -> Iterator[type]:
    """Yield the subclasses of a class that a module has."""
    for value in vars(module).values():
        if isinstance(value, type) and issubclass(value, base):
            yield value


def _policies() -> Iterator[type[BasePolicy]]:
    """Yield the policies of every algorithm whose package is installed."""
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
        return _rebuild(value)
    except NotData:
        raise
    except Exception as error:  # parts that do not fit may raise anything
        raise ValueError(f"{type(error).__name__}: {error}") from error


def _rebuild(value: Any) -> Any:
    if isinstance(value, type) and issubclass(value, Inert):
        return _find_class(value.made_by)
    if isinstance(value, Inert):
        return _make_object(value)
    if isinstance(value, dict):
        return {_rebuild(key): _rebuild(item) for key, item in value.items()}
    if type(value) in (list, tuple, set, frozenset):
        return type(value)(_rebuild(item) for item in value)
    return value


def _find_class(name: str) -> Any:
    classes: dict[str, Any] = {**known_classes(), **_scalar_types()}
    if name not in classes:
        raise NotData(name)
    return classes[name]


@cache
def _scalar_types() -> dict[str, Any]:
    """Return the types of numbers that a space may have instead of a dtype, by their names."""
    types = (np.bool_, np.float32, np.float64, np.int64, np.int32, np.uint8)
    names: dict[str, Any] = {f"numpy.{scalar.__name__}": scalar for scalar in types}
    names["numpy.bool_"] = np.bool_  # its name in numpy 1; in numpy 2 it is "bool"
    return names


def _make_object(inert: Inert) -> Any:
    maker = _makers().get(inert.made_by)
    if maker is None:
        raise NotData(inert.made_by)
    return maker(inert)


@cache
def _makers() -> dict[str, Callable[[Inert], Any]]:
    """Return ``module.name`` in a pickle -> the function here that makes the object."""
    makers: dict[str, Callable[[Inert], Any]] = {
        "numpy.dtype": _make_dtype,
        "collections.OrderedDict": _make_ordered_dict,
    }
    for core in _NUMPY_CORES:
        makers[f"{core}.numeric._frombuffer"] = _make_array_of_buffer
        makers[f"{core}.multiarray._reconstruct"] = _make_array
        makers[f"{core}.multiarray.scalar"] = _make_scalar
    for cls in _SPACES:
        name = f"{cls.__module__}.{cls.__qualname__}"
        name_in_gym = name.replace("gymnasium.", "gym.", 1)
        makers[name] = _space_maker(cls)
        makers[name_in_gym] = makers[name]
    return makers


def _space_maker(cls: Any) -> Callable[[Inert], Any]:
    def make_space(inert: Inert) -> Any:
        state = {}
        for key, value in inert.state.items():
            state[key] = None if key in _GENERATORS else _rebuild(value)
        space = cls.__new__(cls)
        space.__setstate__(state)
        return space

    return make_space


def _make_ordered_dict(inert: Inert) -> OrderedDict[Any, Any]:
    pairs: Iterable[Any] = inert.arguments[0] if inert.arguments else ()
    return OrderedDict(_rebuild([*map(tuple, pairs), *inert.entries.items()]))


def _make_dtype(inert: Inert) -> np.dtype[Any]:
    code = str(inert.arguments[0])
    byte_order: Any = inert.state[1] if inert.state is not None else "="
    dtype = np.dtype(code)
    if dtype.hasobject:
        raise NotData(f"an array of objects ({code})")
    if byte_order in ("|", "="):
        return dtype
    return dtype.newbyteorder(byte_order)


def _make_array_of_buffer(inert: Inert) -> np.ndarray[Any, Any]:
    data, dtype, shape, order = inert.arguments
    return np.frombuffer(data, _rebuild(dtype)).reshape(shape, order=order).copy(order="K")


def _make_array(inert: Inert) -> np.ndarray[Any, Any]:
    if inert.state is None or len(inert.state) != _ARRAY_STATE:
        raise ValueError("a pickled array is damaged")
    _, shape, dtype, is_fortran, data = inert.state
    order: Any = "F" if is_fortran else "C"
    return np.frombuffer(data, _rebuild(dtype)).reshape(shape, order=order).copy(order="K")


def _make_scalar(inert: Inert) -> Any:
    dtype, data = inert.arguments
    return np.frombuffer(data, _rebuild(dtype))[0]
