"""Kinds of noise of observations and actions, as pure data; `cfg` exports them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from embodichain.utils.configclass import configclass
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.fields.type_errors import member_from_dict, said_twice, unknown_key
from embodichain.utils.fields.value_checks import are_finite, require
from embodichain.utils.suggest import did_you_mean

__all__ = [
    "AnyNoiseCfg",
    "ConstantNoiseCfg",
    "GaussianNoiseCfg",
    "NoiseCfg",
    "UniformNoiseCfg",
]

_DEFAULT = "gaussian"


def _numbers_in(value: Any) -> NDArray[np.float64]:
    """(n,) the numbers of a number, a list or a map."""
    if isinstance(value, Mapping):
        value = list(value.values())
    return np.asarray(value, np.float64).reshape(-1)


Numbers = Annotated[
    float | list[float] | dict[str, float],
    require("must be finite", lambda value: are_finite(_numbers_in(value))),
]
"""One number, one for each column, or {joint or link regex: number}."""
Deviation = Annotated[
    Numbers, require("must not be negative, got {}", lambda value: (_numbers_in(value) >= 0).all())
]


@configclass
class NoiseCfg:
    """Base of the kinds of noise, drawn in every step; `type` names the concrete one.

    ``NoiseCfg(type="uniform", low=-1.0, high=1.0)`` makes a `UniformNoiseCfg`; without a type it
    makes a `GaussianNoiseCfg`.
    """

    type: str = _DEFAULT
    operation: Literal["add", "scale", "abs"] = "add"
    """The result is value + noise, value x noise, or the noise alone."""

    def __new__(cls, type: str = _DEFAULT, *args: Any, **values: Any) -> NoiseCfg:
        """Make a config of the kind that is named.

        Raises:
            ConfigError: If there is no such kind, or a key is not one of it.
        """
        kind = cls
        if cls is NoiseCfg:
            if type not in _KINDS:
                message = f"unknown type {type!r}; one of: {', '.join(_KINDS)}."
                raise ConfigError([Problem("type", message, did_you_mean(type, _KINDS).strip())])
            kind = _KINDS[type]
        allowed = [field.name for field in dataclasses.fields(kind)]
        unknown = [name for name in values if name not in allowed]
        # A subclass of a user may have a constructor of its own.
        if unknown and kind in _KINDS.values():
            raise ConfigError([Problem(name, *unknown_key(name, allowed)) for name in unknown])
        return object.__new__(kind)

    def check(self) -> list[Problem]:
        """Return the mistakes of values that do not go together, with paths below it."""
        return []

    @classmethod
    def from_dict(cls, init_dict: dict[str, Any]) -> NoiseCfg:
        """Build the noise that ``init_dict["type"]`` names, or gaussian noise.

        Raises:
            ConfigError: If the type or a key is unknown; lists what exists.
        """
        noise: NoiseCfg = member_from_dict(_KINDS, "type", {"type": _DEFAULT, **init_dict})
        return noise

    def _missing(self, key: str) -> Problem:
        return Problem(key, f"missing; noise of type {self.type!r} needs it")


@configclass
class GaussianNoiseCfg(NoiseCfg):
    """Normal noise; needs `std`."""

    type: Literal["gaussian"] = "gaussian"
    mean: Numbers | None = dataclasses.field(default=None, kw_only=True)
    """None is 0."""
    std: Deviation | None = dataclasses.field(default=None, kw_only=True)

    def check(self) -> list[Problem]:
        """Check that there is a deviation."""
        return [self._missing("std")] if self.std is None else []


@configclass
class UniformNoiseCfg(NoiseCfg):
    """Noise between two bounds; needs `low` and `high`."""

    type: Literal["uniform"] = "uniform"
    low: Numbers | None = dataclasses.field(default=None, kw_only=True)
    high: Numbers | None = dataclasses.field(default=None, kw_only=True)
    n_min: Numbers | None = dataclasses.field(default=None, kw_only=True)
    """Isaac Lab's name of `low`."""
    n_max: Numbers | None = dataclasses.field(default=None, kw_only=True)
    """Isaac Lab's name of `high`."""

    def check(self) -> list[Problem]:
        """Check that each bound is given once, and that they are in order."""
        problems: list[Problem] = []
        for key, alias in (("low", "n_min"), ("high", "n_max")):
            names = [name for name in (key, alias) if getattr(self, name) is not None]
            if len(names) == 2:
                problems.append(Problem(alias, said_twice(key)))
            elif not names:
                problems.append(self._missing(key))
        return problems or self._check_order()

    def _check_order(self) -> list[Problem]:
        low = self.n_min if self.low is None else self.low
        high = self.n_max if self.high is None else self.high
        if isinstance(low, Mapping) or isinstance(high, Mapping):
            return []  # compared when they are spread over columns
        lows = np.asarray(low, np.float64)
        highs = np.asarray(high, np.float64)
        if lows.ndim and highs.ndim and len(lows) != len(highs):
            return [Problem("", f"low has {len(lows)} values, high {len(highs)}")]
        if (lows > highs).any():
            return [Problem("", f"low {low} exceeds high {high}")]
        return []


@configclass
class ConstantNoiseCfg(NoiseCfg):
    """A constant, which is not drawn; needs `bias`."""

    type: Literal["constant"] = "constant"
    bias: Numbers | None = dataclasses.field(default=None, kw_only=True)

    def check(self) -> list[Problem]:
        """Check that there is a constant."""
        return [self._missing("bias")] if self.bias is None else []


_KINDS: dict[str, type[NoiseCfg]] = {
    "gaussian": GaussianNoiseCfg,
    "uniform": UniformNoiseCfg,
    "constant": ConstantNoiseCfg,
}


def _with_kind(value: Any) -> Any:
    """Values with the type that is meant, and without nulls of keys that only other kinds have.

    Tasks that wrote out all keys of all kinds have these.
    """
    if not isinstance(value, Mapping):
        return value
    values = {"type": _DEFAULT, **value}
    kind = _KINDS.get(str(values["type"]), NoiseCfg)
    keys = {field.name for field in dataclasses.fields(kind)}
    all_keys = {field.name for member in _KINDS.values() for field in dataclasses.fields(member)}
    return {
        key: item
        for key, item in values.items()
        if item is not None or key in keys or key not in all_keys
    }


AnyNoiseCfg = Annotated[
    Annotated[GaussianNoiseCfg | UniformNoiseCfg | ConstantNoiseCfg, Field(discriminator="type")],
    BeforeValidator(_with_kind),
]
"""The union that YAML is checked against; `type` selects the member, gaussian noise without it."""
