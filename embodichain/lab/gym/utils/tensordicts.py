"""Building and reading TensorDicts whose entries are known to fit, without checking them again.

Checked construction takes three times as long, and at one environment that is a tenth of a step.
What is used for it is not public in tensordict; each use falls back on the public way.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDict

__all__ = ["alike", "branches_copied", "entries", "put", "replace", "unchecked"]


def unchecked(source: dict[str, Any], batch: torch.Size, device: torch.device | None) -> TensorDict:
    """Return a TensorDict of tensors and TensorDicts that all have this batch size and device.

    Args:
        source: The entries; the dict itself is not kept.
        batch: Their batch size.
        device: Where they live.
    """
    result: TensorDict = _construct(source, batch_size=batch, device=device)
    return result


def alike(model: TensorDict, source: dict[str, Any]) -> TensorDict:
    """Return a TensorDict with the batch size and device of one of this package's making.

    Args:
        model: Neither locked nor shared.
        source: The entries, which fit; the dict is kept.
    """
    own: dict[str, Any] = model.__dict__
    if type(own.get("_tensordict")) is not dict:
        return unchecked(source, model.batch_size, model.device)
    result = TensorDict.__new__(TensorDict)
    result.__dict__.update(own, _tensordict=source)
    return result


def entries(source: TensorDict) -> Mapping[str, Any]:
    """Return the entries of a TensorDict: its own dict where it has one. Do not write."""
    own = getattr(source, "_tensordict", None)
    return own if type(own) is dict else source


def put(target: TensorDict, path: tuple[str, ...], value: torch.Tensor) -> None:
    """Set an entry that is known to fit.

    Args:
        target: A TensorDict of this package's making.
        path: Where: (name,) or (group, name); longer ones go the checked way.
        value: (N, ...) on the target's device.
    """
    own = getattr(target, "_tensordict", None)
    if type(own) is not dict or len(path) > 2:
        target.set(path, value)
    elif len(path) == 1:
        own[path[0]] = value
    elif path[0] in own:
        target.set(path, value)
    else:
        own[path[0]] = alike(target, {path[1]: value})


def branches_copied(source: TensorDict) -> TensorDict:
    """Return a TensorDict of the same tensors: entries can be replaced, at any depth."""
    own = getattr(source, "_tensordict", None)
    if type(own) is not dict:
        return source.clone(recurse=False)
    found = {k: branches_copied(v) if isinstance(v, TensorDict) else v for k, v in own.items()}
    return unchecked(found, source.batch_size, source.device)


def replace(target: TensorDict, path: tuple[str, ...], value: torch.Tensor) -> None:
    """Replace an entry by one of the same shape, type and device."""
    own: Any = target
    for key in path[:-1]:
        own = entries(own)[key]
    entry = getattr(own, "_tensordict", None)
    if type(entry) is dict:
        entry[path[-1]] = value
    else:
        own.set(path[-1], value)


# Not public, but what tensordict builds its own results with; the checked way does the same.
_construct: Any = getattr(TensorDict, "_new_unsafe", TensorDict)
