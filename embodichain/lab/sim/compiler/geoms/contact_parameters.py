"""`ContactParameters`: the fields of a geom that decide what touches it, and how.

A collider that does not move, such as the ground, lets what stands on it decide: its priority is
`FIXED_PRIORITY`, below the 0 of all others, unless its friction is given.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.configs.contact_cfg import ContactCfg
from embodichain.utils.errors import Problem

__all__ = [
    "FIXED_PRIORITY",
    "LEAST_RESTITUTION",
    "ContactParameters",
    "bouncing_solref",
    "check_fixed_contact",
    "fixed_contact",
    "given_parameters",
    "set_contact_parameters",
]

FIXED_PRIORITY = -1
"""Priority of a collider that does not move and was given no friction."""
LEAST_RESTITUTION = math.exp(-2.0)
"""That of a critically damped spring."""
_DECIDED = ("condim", "solref", "solimp", "solmix")
"""Parameters beside friction that act only with a priority that is not too low."""


@dataclass(frozen=True)
class ContactParameters:
    """Fields of a geom; None is not to be set.

    Attributes:
        friction: Sliding, torsional (m) and rolling (m) coefficient, or the first of these.
        condim: 1, 3, 4 or 6.
        solref: (2,) as in MuJoCo.
        solimp: (5,) as in MuJoCo, or the first of these.
        solmix: Weight in the mean of two solref and solimp.
        priority: The geom with the higher one decides.
        margin: Metres.
        gap: Metres.
        contype: Bits of what it is.
        conaffinity: Bits of what it touches.
    """

    friction: tuple[float, ...] | None = None
    condim: int | None = None
    solref: tuple[float, ...] | None = None
    solimp: tuple[float, ...] | None = None
    solmix: float | None = None
    priority: int | None = None
    margin: float | None = None
    gap: float | None = None
    contype: int | None = None
    conaffinity: int | None = None

    @classmethod
    def of_config(cls, cfg: ContactCfg | None) -> ContactParameters:
        """Return the parameters that a config gives."""
        if cfg is None:
            return cls()
        names = [field.name for field in dataclasses.fields(ContactCfg)]
        return cls(**{name: _plain(name, getattr(cfg, name)) for name in names})

    @classmethod
    def of_geom(cls, geom: mujoco.MjsGeom) -> ContactParameters:
        """Return all parameters of a geom."""
        names = [field.name for field in dataclasses.fields(cls)]
        return cls(**{name: _plain(name, getattr(geom, name)) for name in names})

    def over(self, other: ContactParameters) -> ContactParameters:
        """Return these parameters, with those of `other` where they are None."""
        return dataclasses.replace(other, **self.values())

    def values(self) -> dict[str, Any]:
        """Return the fields that are to be set, by name."""
        return {name: value for name, value in vars(self).items() if value is not None}


def _plain(name: str, value: Any) -> Any:
    """A number, or a tuple of numbers; one friction is a tuple of one."""
    if isinstance(value, (Sequence, np.ndarray)):
        return tuple(float(x) for x in value)
    if name == "friction" and value is not None:
        return (float(value),)
    return value


def set_contact_parameters(geoms: Sequence[mujoco.MjsGeom], parameters: ContactParameters) -> None:
    """Set fields of geoms. Of a list that is shorter than the field, the rest stays."""
    for geom in geoms:
        for name, value in parameters.values().items():
            current = getattr(geom, name)
            if isinstance(current, np.ndarray):
                current[: len(value)] = value
            else:
                setattr(geom, name, value)


def fixed_contact(cfg: ContactCfg | None) -> ContactParameters:
    """Return the parameters of a collider that does not move, of which its config gives some."""
    parameters = ContactParameters.of_config(cfg)
    priority = FIXED_PRIORITY if parameters.friction is None else 0
    return parameters.over(ContactParameters(priority=priority))


def given_parameters(cfg: ContactCfg) -> frozenset[str]:
    """Return the names of the parameters that a config of a collider that does not move decides."""
    names = set(ContactParameters.of_config(cfg).values())
    if "friction" in names:
        names.add("priority")
    return frozenset(names)


def bouncing_solref(restitution: float) -> tuple[float, float]:
    """Return a solref with which a body bounces back with about this share of its speed.

    The body leaves a damped spring when that would pull (Schwager and Poeschel 2007, "Coefficient
    of restitution and linear-dashpot model revisited", eq. 21). The frequency is that of MuJoCo's
    default solref, 1 / 0.02 s.

    Args:
        restitution: More than `LEAST_RESTITUTION` and less than 1.
    """
    low = 0.0
    high = 1.0
    for _ in range(60):  # bisection: a larger ratio bounces less
        ratio = 0.5 * (low + high)
        if _restitution(ratio) > restitution:
            low = ratio
        else:
            high = ratio
    return 0.02 / ratio, ratio


def _restitution(ratio: float) -> float:
    """The share of its speed that a body has after a spring with this damping ratio below 1."""
    root = math.sqrt(1.0 - ratio**2)
    angle = math.atan2(2.0 * ratio * root, 1.0 - 2.0 * ratio**2)
    return math.exp(-ratio / root * (math.pi - angle))


# ------------------------------------------------------------------------------------------- checks


def check_fixed_contact(cfg: ContactCfg) -> list[Problem]:
    """Return the contact parameters of a collider that does not move which have no effect."""
    if cfg.friction is not None or cfg.priority is not None:
        return []
    problems: list[Problem] = []
    for name in _DECIDED:
        if getattr(cfg, name) is not None:
            message = (
                "has no effect: it does not move and has no friction, so that what touches it "
                "decides; give friction, or priority: 1"
            )
            problems.append(Problem(name, message))
    return problems
