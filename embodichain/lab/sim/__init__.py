"""Scenes: configs, the compiler, the simulation and handles of its entities."""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import SimulationManagerCfg
    from embodichain.lab.sim.objects.entity import BatchEntity
    from embodichain.lab.sim.shapes import VisualMaterialCfg
    from embodichain.lab.sim.sim_manager import SimulationManager

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "cfg": ["SimulationManagerCfg"],
        "objects.entity": ["BatchEntity"],
        "shapes": ["VisualMaterialCfg"],
        "sim_manager": ["SimulationManager"],
    },
)

__all__ = ["BatchEntity", "SimulationManager", "SimulationManagerCfg", "VisualMaterialCfg"]
