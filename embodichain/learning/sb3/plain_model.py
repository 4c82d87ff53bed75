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
from collections.abc import Mapping
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
        NeedsTrust: If a part of the model is no plain data, and no class of the register.
        ConfigError: If the file is damaged, or its parts do not fit.
    """
    data = _attributes(file)
    pickles = {name: _pickle_of(value) for name, value in data.items() if _is_pickled(value)}
    parts = {name: _part(file, name, data, pickles) for name in _NEEDED}
    _say_what_is_not_read(file, pickles)
    try:
        model = algorithm(
            policy=parts["policy_class"],
            env=None,
            device="cpu",
            _init_setup_model=False,  # type: ignore[call-arg]
        )
        own = vars(model)
        plain = {n: v for n, v in data.items() if n in own and not _is_pickled(v)}
        plain |= _numbers({n: found for n, found in pickles.items() if n in own})
        unused = {name: value for name, value in UNUSED.items() if name in own}
        own.update({**plain, **parts, **unused, "n_envs": 1})
        own["policy_kwargs"] = _arguments(parts["policy_kwargs"])
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
    pickles = [_pickle_of(value) for value in _attributes(file).values() if _is_pickled(value)]
    return _unusual({str(i): found for i, found in enumerate(pickles)})


def _attributes(file: Path) -> dict[str, Any]:
    """The attributes of a model, as the JSON in its zip has them."""
    try:
        with zipfile.ZipFile(file) as archive:
            data = json.loads(archive.read("data"))
    except (OSError, KeyError, ValueError, RecursionError, zipfile.BadZipFile) as error:
        raise _damaged(file, str(error)) from error
    if not isinstance(data, dict):
        raise _damaged(file, "its data is no map")
    return data


def _is_pickled(value: Any) -> bool:
    return isinstance(value, dict) and _PICKLED in value


def _pickle_of(value: Mapping[str, Any]) -> InertPickle:
    try:
        return read_inert(base64.b64decode(value[_PICKLED]))
    except (TypeError, ValueError, binascii.Error) as error:
        return InertPickle(damage=str(error))


def _part(
    file: Path, name: str, data: Mapping[str, Any], pickles: Mapping[str, InertPickle]
) -> Any:
    """One of the attributes that are needed."""
    if name not in data:
        raise _damaged(file, f"it has no {name}")
    if name not in pickles:
        return data[name]
    found = pickles[name]
    names = _unusual(pickles)
    try:
        if found.damage:
            raise ValueError(found.damage)
        return rebuild(found.value)
    except NotData as error:
        names = list(dict.fromkeys([error.name, *names]))
        raise needs_trust(file, f"its {name} is made by {error.name}", names) from error
    except ValueError as error:
        why = f"its {name} is no plain data ({error})"
        raise (needs_trust(file, why, names) if names else _damaged(file, why)) from error


def _numbers(pickles: Mapping[str, InertPickle]) -> dict[str, Any]:
    """Those of the attributes that are numbers of numpy, such as an entropy."""
    found = {}
    for name, content in pickles.items():
        with suppress(NotData, ValueError):  # then it is no number
            value = rebuild(content.value)
            if isinstance(value, (np.generic, int, float)):
                found[name] = value
    return found


def _arguments(kwargs: dict[str, Any]) -> dict[str, Any]:
    """Arguments of a policy; Stable-Baselines3 saved layers as a list of one map before 1.8."""
    found = {name: value for name, value in kwargs.items() if name != "device"}
    layers = found.get("net_arch")
    if isinstance(layers, list) and layers and isinstance(layers[0], dict):
        found["net_arch"] = layers[0]
    return found


def _unusual(pickles: Mapping[str, InertPickle]) -> list[str]:
    names = dict.fromkeys(name for found in pickles.values() for name in found.names)
    return [name for name in names if not is_usual(name)]


def _say_what_is_not_read(file: Path, pickles: Mapping[str, InertPickle]) -> None:
    """Warn of code in attributes that are not needed, which is unusual."""
    unneeded = {name: found for name, found in pickles.items() if name not in _NEEDED}
    for name, found in unneeded.items():
        names = _unusual({name: found})
        if names:
            _log.warning("%s: its %s would run %s: it is not read", file, name, listed(names))


def _damaged(file: Path, why: str) -> ConfigError:
    return ConfigError([Problem("policy", f"{file} cannot be loaded: {why}")])
