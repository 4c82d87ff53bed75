"""`ContactCfg`: how a collider touches others, with the names of MuJoCo's geoms. Pure data.

MuJoCo makes one contact's parameters from two geoms. If their priorities differ, `friction`,
`condim`, `solref` and `solimp` are those of the higher priority. If they are equal, friction and
condim are the larger ones, solref and solimp a mean. Margins and gaps are added in both cases.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from embodichain.utils.configclass import configclass
from embodichain.utils.fields.value_checks import refuse

__all__ = ["Coefficient", "ContactCfg", "Friction", "Solimp", "Solref"]

Coefficient = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_LARGEST_IMPEDANCE = 0.9999
"""MuJoCo's `mjMAXIMP`."""
_LEAST_IMPEDANCE = 1.0 - _LARGEST_IMPEDANCE
_Number = Annotated[float, Field(allow_inf_nan=False)]
Friction = Coefficient | Annotated[Sequence[Coefficient], Field(min_length=1, max_length=3)]
"""Sliding friction; or a list: sliding, torsional (m), rolling (m)."""


def _find_solref_mistake(solref: Sequence[float]) -> str | None:
    """MuJoCo would replace a solref with mixed signs by its default."""
    if all(x > 0 for x in solref) or all(x <= 0 for x in solref):
        return None
    return (
        "must be [time constant, damping ratio], both positive, or [-stiffness, -damping], "
        "neither positive; got {}"
    )


def _find_solimp_mistake(solimp: Sequence[float]) -> str | None:
    """MuJoCo would clamp values out of range."""
    limits = (
        ("dmin", _LEAST_IMPEDANCE, _LARGEST_IMPEDANCE),
        ("dmax", _LEAST_IMPEDANCE, _LARGEST_IMPEDANCE),
        ("width", 0.0, math.inf),
        ("midpoint", _LEAST_IMPEDANCE, _LARGEST_IMPEDANCE),
        ("power", 1.0, math.inf),
    )
    mistakes: list[str] = []
    for (name, low, high), value in zip(limits, solimp, strict=False):
        if not low - 1e-12 <= value <= high:
            allowed = f"at least {low:.4g}" if high == math.inf else f"{low:.4g} to {high:.4g}"
            mistakes.append(f"{name} must be {allowed}, got {value:g}")
    return "; ".join(mistakes) or None


Solref = Annotated[
    Sequence[_Number], Field(min_length=2, max_length=2), refuse(_find_solref_mistake)
]
"""[time constant (s), damping ratio], both positive; or [-stiffness, -damping], none positive."""
Solimp = Annotated[
    Sequence[_Number], Field(min_length=1, max_length=5), refuse(_find_solimp_mistake)
]
"""[dmin, dmax, width (m), midpoint, power], or the first of these."""


@configclass(kw_only=True)
class ContactCfg:
    """Contact parameters of colliders; None keeps what they have."""

    friction: Friction | None = None
    """Sliding friction, or a list: sliding, torsional (m), rolling (m). Torsional friction acts
    where a contact's condim is 4 or 6, rolling friction where it is 6."""
    condim: Literal[1, 3, 4, 6] | None = None
    """1: frictionless; 3: sliding; 4: and torsional; 6: and rolling friction."""
    solref: Solref | None = None
    """Spring and damper of the contact: [time constant (s), damping ratio], both positive; or
    [-stiffness, -damping], neither positive: it bounces with little damping."""
    solimp: Solimp | None = None
    """Impedance: [dmin, dmax, width (m), midpoint, power], or the first of these."""
    solmix: Coefficient | None = None
    """Weight in the mean of two solref and solimp."""
    priority: Annotated[int, Field(ge=-(2**31), lt=2**31)] | None = None
    """The collider with the higher priority decides about friction, condim, solref and solimp."""
    margin: Coefficient | None = None
    """Metres of distance from which contact forces act."""
    gap: Coefficient | None = None
    """Metres beyond the margin in which contacts are detected, without force."""
