"""`load_plain`: a model of Stable-Baselines3 from its zip, without running code of the file.

Stable-Baselines3 loads every attribute of a model with cloudpickle. What acting needs are the
spaces, the class of the policy with its arguments, numbers, and weights: the first are read as data
(`inert_pickle`, `known_objects`), the weights with torch's reader of weights alone.
"""

from __future__ import annotations

import base64
import binascii
import json
import logging
import zipfile
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm

from embodichain.learning.checkpoints.inert_pickle import InertPickle, read_inert
from embodichain.learning.checkpoints.trust import listed, needs_trust
from embodichain.learning.sb3.known_objects import NotData, is_usual, rebuild
from embodichain.learning.sb3.training_state import load_parameters
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["UNUSED", "load_plain", "pickled_names"]

UNUSED = {"seed": None, "buffer_size": 1, "learning_starts": 0, "tensorboard_log": None}
"""Attributes that acting does not need; above all a replay buffer for a million steps."""
_NEEDED = ("policy_class", "policy_kwargs", "observation_space", "action_space")
_PICKLED = ":serialized:"
"""The key of a pickle in the JSON of Stable-Baselines3."""
_log = logging.getLogger(__name__)


class _Unbuilt(Protocol):
    """A model of Stable-Baselines3 whose networks are not made yet."""

    def _setup_model(self) -> None:
        """Make its networks, from its spaces and arguments."""


def load_plain(file: Path, algorithm: type[BaseAlgorithm]) -> BaseAlgorithm:
    """Load a model that can act; its random generators, buffers and schedules are new.

    Args:
        file: A zip of Stable-Baselines3.
        algorithm: The class of the model.

    Raises:
        NeedsTrust: If a part of the model is neither plain data nor a class of the register.
        ConfigError: If the file is damaged, or its parts do not fit.
    """
    data = _read_attributes(file)
    pickles = _read_pickles(data)
    needed = {name: _needed_value(file, name, data, pickles) for name in _NEEDED}
    _warn_of_unread_code(file, pickles)
    try:
        model = algorithm(
            policy=needed["policy_class"],
            env=None,
            device="cpu",
            _init_setup_model=False,  # type: ignore[call-arg]
        )
        attributes = vars(model)
        saved = {name: value for name, value in data.items() if name not in pickles}
        saved |= _read_numbers(pickles, set(attributes))
        saved |= UNUSED
        # Attributes that this algorithm does not have are left out: of another version, say.
        attributes |= {name: value for name, value in saved.items() if name in attributes}
        attributes |= needed
        attributes["n_envs"] = 1
        attributes["policy_kwargs"] = _policy_arguments(needed["policy_kwargs"])
        unbuilt: _Unbuilt = model
        unbuilt._setup_model()
    except Exception as error:  # parts that do not fit may raise anything
        raise _damaged(file, f"{type(error).__name__}: {error}") from error
    load_parameters(model, file, "policy")
    if model.use_sde:
        model.policy.reset_noise()  # type: ignore[operator]
    return model


def pickled_names(file: Path) -> list[str]:
    """Return the functions and classes that the pickles of a zip name, but for the usual ones.

    Nothing of the file is run.

    Raises:
        ConfigError: If the file is damaged.
    """
    pickles = _read_pickles(_read_attributes(file))
    return _unusual_names(pickles.values())


def _read_attributes(file: Path) -> dict[str, Any]:
    """Return the attributes of a model, as the JSON in its zip has them."""
    try:
        with zipfile.ZipFile(file) as archive:
            data = json.loads(archive.read("data"))
    except (OSError, KeyError, ValueError, RecursionError, zipfile.BadZipFile) as error:
        raise _damaged(file, str(error)) from error
    if not isinstance(data, dict):
        raise _damaged(file, "its data is not a map")
    return data


def _read_pickles(data: Mapping[str, Any]) -> dict[str, InertPickle]:
    """Return what the pickled ones of a model's attributes contain, by name."""
    pickles: dict[str, InertPickle] = {}
    for name, value in data.items():
        if isinstance(value, dict) and _PICKLED in value:
            pickles[name] = _read_pickle(value[_PICKLED])
    return pickles


def _read_pickle(encoded: Any) -> InertPickle:
    try:
        return read_inert(base64.b64decode(encoded))
    except (TypeError, ValueError, binascii.Error) as error:
        return InertPickle(damage=str(error))


def _needed_value(
    file: Path, name: str, data: Mapping[str, Any], pickles: Mapping[str, InertPickle]
) -> Any:
    """Return one of the attributes that are needed; errors as of `load_plain`."""
    if name not in data:
        raise _damaged(file, f"it has no {name}")
    if name not in pickles:
        return data[name]
    content = pickles[name]
    names = _unusual_names(pickles.values())
    try:
        if content.damage:
            raise ValueError(content.damage)
        return rebuild(content.value)
    except NotData as error:
        names = list(dict.fromkeys([error.name, *names]))
        raise needs_trust(file, f"its {name} is made by {error.name}", names) from error
    except ValueError as error:
        why = f"its {name} is not plain data ({error})"
        if names:
            raise needs_trust(file, why, names) from error
        raise _damaged(file, why) from error


def _read_numbers(
    pickles: Mapping[str, InertPickle], attributes: Collection[str]
) -> dict[str, Any]:
    """Return those of some attributes that are pickled numbers of numpy, such as an entropy."""
    numbers: dict[str, Any] = {}
    for name, content in pickles.items():
        if name not in attributes:
            continue
        with suppress(NotData, ValueError):  # then it is not a number
            value = rebuild(content.value)
            if isinstance(value, (np.generic, int, float)):
                numbers[name] = value
    return numbers


def _policy_arguments(saved: dict[str, Any]) -> dict[str, Any]:
    """Return a policy's arguments; Stable-Baselines3 saved layers as a list of a map before 1.8."""
    arguments = {name: value for name, value in saved.items() if name != "device"}
    layers = arguments.get("net_arch")
    if isinstance(layers, list) and layers and isinstance(layers[0], dict):
        arguments["net_arch"] = layers[0]
    return arguments


def _unusual_names(pickles: Iterable[InertPickle]) -> list[str]:
    names = dict.fromkeys(name for content in pickles for name in content.names)
    return [name for name in names if not is_usual(name)]


def _warn_of_unread_code(file: Path, pickles: Mapping[str, InertPickle]) -> None:
    """Warn of code in attributes that are not needed, which is unusual."""
    for name, content in pickles.items():
        if name in _NEEDED:
            continue
        names = _unusual_names([content])
        if names:
            _log.warning("%s: its %s would run %s: it is not read", file, name, listed(names))


def _damaged(file: Path, why: str) -> ConfigError:
    return ConfigError([Problem("policy", f"{file} cannot be loaded: {why}")])
