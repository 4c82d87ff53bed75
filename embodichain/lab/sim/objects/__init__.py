"""Handles: each is a Python object for one entity in all environments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import lazy_loader

from embodichain.utils.plugins import missing_class

if TYPE_CHECKING:
    from embodichain.lab.sim.objects.articulation import Articulation
    from embodichain.lab.sim.objects.articulation_data import ArticulationData
    from embodichain.lab.sim.objects.entity import BatchEntity
    from embodichain.lab.sim.objects.light import Light
    from embodichain.lab.sim.objects.rigid_body_data import RigidBodyData
    from embodichain.lab.sim.objects.rigid_object import RigidObject
    from embodichain.lab.sim.objects.robot import Robot

_lazy, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "articulation": ["Articulation"],
        "articulation_data": ["ArticulationData"],
        "entity": ["BatchEntity"],
        "light": ["Light"],
        "rigid_body_data": ["RigidBodyData"],
        "rigid_object": ["RigidObject"],
        "robot": ["Robot"],
    },
)

__all__ = [
    "Articulation",
    "ArticulationData",
    "BatchEntity",
    "ClothObject",
    "Gizmo",
    "Light",
    "RigidBodyData",
    "RigidConstraint",
    "RigidObject",
    "RigidObjectGroup",
    "Robot",
    "SoftObject",
]


def __getattr__(name: str) -> Any:
    """Return a handle, or a class of EmbodiChain that raises the reason why it is missing."""
    return missing_class(name) or _lazy(name)
