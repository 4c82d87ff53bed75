"""Configs of EmbodiChain's that exist by name only: building one says what is not here yet."""

from __future__ import annotations

from typing import Any

__all__ = [
    "ClothObjectCfg",
    "GizmoCfg",
    "RigidConstraintCfg",
    "RigidObjectGroupCfg",
    "SoftObjectCfg",
]


class _UnavailableCfg:
    """Raises NotImplementedError when built."""

    what = "this"

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        raise NotImplementedError(f"{type(self).__name__}: {self.what} not available yet")


class SoftObjectCfg(_UnavailableCfg):
    """Not available: soft bodies come later."""

    what = "soft bodies are"


class ClothObjectCfg(_UnavailableCfg):
    """Not available: cloth comes later."""

    what = "cloth is"


class RigidObjectGroupCfg(_UnavailableCfg):
    """Not available: add objects one by one."""

    what = "object groups are"


class RigidConstraintCfg(_UnavailableCfg):
    """Not available: welds come with their event terms."""

    what = "rigid constraints are"


class GizmoCfg(_UnavailableCfg):
    """Not available: gizmos need the viewer they belong to."""

    what = "gizmos are"
