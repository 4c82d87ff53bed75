"""Handles of EmbodiChain's that do not exist here yet: the names, and what to do instead."""

from __future__ import annotations

from typing import Any

__all__ = [
    "ClothObject",
    "Gizmo",
    "RigidConstraint",
    "RigidObjectGroup",
    "SoftObject",
]


class _Unavailable:
    """Raises NotImplementedError when built."""

    why = "it is not available yet"

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        raise NotImplementedError(f"{type(self).__name__}: {self.why}")


class SoftObject(_Unavailable):
    """Not available: soft bodies come later."""

    why = "soft bodies are not available yet"


class ClothObject(_Unavailable):
    """Not available: cloth comes later."""

    why = "cloth is not available yet"


class RigidObjectGroup(_Unavailable):
    """Not available: groups come with their event terms."""

    why = "object groups are not available yet; add objects one by one"


class RigidConstraint(_Unavailable):
    """Not available: welds between objects come with their event terms."""

    why = "rigid constraints are not available yet"


class Gizmo(_Unavailable):
    """Not available: gizmos need the viewer they belong to."""

    why = "gizmos are not available"
