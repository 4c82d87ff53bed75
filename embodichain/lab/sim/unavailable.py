"""Names of EmbodiChain's that exist here and raise NotImplementedError with the reason.

Objects and their configs raise when they are built, methods when they are called.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NoReturn

__all__ = [
    "ClothObject",
    "ClothObjectCfg",
    "Gizmo",
    "GizmoCfg",
    "RigidConstraint",
    "RigidConstraintCfg",
    "RigidObjectGroup",
    "RigidObjectGroupCfg",
    "SoftObject",
    "SoftObjectCfg",
    "not_available",
]


def not_available(what: str, why: str) -> Callable[..., NoReturn]:
    """Return a method that raises NotImplementedError."""

    def method(self: object, *args: Any, **kwargs: Any) -> NoReturn:
        raise NotImplementedError(f"{type(self).__name__}.{what} is not available: {why}")

    method.__name__ = what
    method.__doc__ = f"Not available: {why}; raises NotImplementedError."
    return method


class _Unavailable:
    """Raises NotImplementedError when built."""

    why = ""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        raise NotImplementedError(f"{type(self).__name__}: {self.why}")


class SoftObject(_Unavailable):
    """Not available."""

    why = "soft bodies are not available yet"


class ClothObject(_Unavailable):
    """Not available."""

    why = "cloth is not available yet"


class RigidObjectGroup(_Unavailable):
    """Not available."""

    why = "object groups are not available yet; add objects one by one"


class RigidConstraint(_Unavailable):
    """Not available."""

    why = "rigid constraints are not available yet"


class Gizmo(_Unavailable):
    """Not available."""

    why = "gizmos are not available yet"


class SoftObjectCfg(SoftObject):
    """Not available."""


class ClothObjectCfg(ClothObject):
    """Not available."""


class RigidObjectGroupCfg(RigidObjectGroup):
    """Not available."""


class RigidConstraintCfg(RigidConstraint):
    """Not available."""


class GizmoCfg(Gizmo):
    """Not available."""
